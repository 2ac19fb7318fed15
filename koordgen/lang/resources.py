"""Locations of the compiler's own files, in a wheel or a checkout, and updates of generated files."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def _data(folder: str) -> Path:
    installed = _PACKAGE / "_data" / folder
    return installed if installed.is_dir() else _PACKAGE.parent / folder


def templates() -> Path:
    """Return the folder of the Jinja templates."""
    return _data("templates")


def generated_templates() -> Path:
    """Return the folder of the templates that `make generated` compiled to Python modules."""
    return _PACKAGE / "build" / "emit" / "_generated" / "templates"


def targets() -> Path:
    """Return the folder with one folder for each target: its manifest, and Python files for its bundles."""
    return _data("targets")


def examples() -> Path:
    """Return the folder with one folder for each example: programs, fleet files, and a page README.md."""
    return _data("examples")


def docs() -> Path:
    """Return the folder of the documentation. README.md, the first page to read, is beside this folder."""
    return _data("docs")


def package() -> Path:
    """Return the folder of the `koordgen` package, whose `runtime` is copied into bundles."""
    return _PACKAGE


def freshen(wanted: Mapping[Path, str | None], arguments: Sequence[str]) -> int:
    """Write the generated files that are out of date; a file whose wanted text is None is removed.

    With the argument --check only print their names. Returns the exit status: 1 if --check found such files.
    """
    stale = [path for path, text in wanted.items() if _text(path) != text]
    if list(arguments) == ["--check"]:
        for path in stale:
            print(f"{path}: stale; run `make generated`", file=sys.stderr)
        return 1 if stale else 0
    for path in stale:
        text = wanted[path]
        if text is None:
            path.unlink()
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return 0


def _text(path: Path) -> str | None:
    return path.read_text(encoding="utf-8") if path.is_file() else None
