"""Compiler of the templates: `python -m koordgen.build.emit.generate`. `--check` only reports stale files."""

from __future__ import annotations

import sys
from pathlib import Path

from koordgen.build.emit.render import environment, module_name
from koordgen.lang import resources


def compiled() -> dict[Path, str]:
    """Return every template as the text of a Python module, by the path of that module."""
    env = environment()
    folder = resources.generated_templates()
    files = {folder / "__init__.py": '"""Made by `make generated` from templates/; not written by hand."""\n'}
    for path in sorted(resources.templates().glob("*.j2")):
        source = path.read_text(encoding="utf-8")
        files[folder / f"{module_name(path.stem)}.py"] = env.compile(
            source, path.stem, path.name, raw=True, defer_init=True
        )
    return files


def main(arguments: list[str]) -> int:
    there = sorted(resources.generated_templates().glob("*.py"))
    return resources.freshen({**dict.fromkeys(there), **compiled()}, arguments)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
