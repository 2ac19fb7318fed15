"""Where the compiler's own files are: inside an installed wheel, or in a checkout beside the package. And keeping those
of them fresh that are made from others."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def _data(folder: str) -> Path:
    installed = _PACKAGE / "_data" / folder
    return installed if installed.is_dir() else _PACKAGE.parent / folder


def templates() -> Path:
    """The Jinja templates as written."""
    return _data("templates")


def generated_templates() -> Path:
    """The same, compiled to Python modules by `make generated`."""
    return _PACKAGE / "build" / "emit" / "_generated" / "templates"


def targets() -> Path:
    """One folder a target: its manifest and the Python files copied into its bundles."""
    return _data("targets")


def examples() -> Path:
    """One folder an example: programs, fleet files, and a page README.md."""
    return _data("examples")


def docs() -> Path:
    """The documentation's pages; README.md, which is read first, is beside this folder."""
    return _data("docs")


def package() -> Path:
    """The `koordgen` package, whose `runtime` is copied into bundles."""
    return _PACKAGE


def freshen(wanted: Mapping[Path, str | None], arguments: Sequence[str]) -> int:
    """Write the generated files that differ from what is wanted, remove those of which None is. With the argument
    --check only name them, and say by the status whether there are any."""
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
