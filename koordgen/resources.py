"""Where the compiler's own files are: inside an installed wheel, or in a checkout beside the package."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent


def _data(folder: str) -> Path:
    installed = _PACKAGE / "_data" / folder
    return installed if installed.is_dir() else _PACKAGE.parent / folder


def templates() -> Path:
    """The Jinja templates as written."""
    return _data("templates")


def generated_templates() -> Path:
    """The same, compiled to Python modules by `make generated`."""
    return _PACKAGE / "_generated" / "templates"


def targets() -> Path:
    """One folder a target: its manifest and the Python files copied into its bundles."""
    return _data("targets")


def package() -> Path:
    """The `koordgen` package, whose `runtime` is copied into bundles."""
    return _PACKAGE
