"""Compiles the templates ahead: `python -m koordgen.emit.generate`, with `--check` only telling whether that is due."""

from __future__ import annotations

import sys
from pathlib import Path

from koordgen import resources
from koordgen.emit.render import environment, module_name


def compiled() -> dict[Path, str]:
    """Every template as a Python module, by the path it belongs at."""
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
    """Write what has changed; with --check write nothing and say by the status whether something had to be."""
    wanted = compiled()
    stale = [p for p, text in wanted.items() if not p.is_file() or p.read_text(encoding="utf-8") != text]
    gone = sorted(set(resources.generated_templates().glob("*.py")) - set(wanted))
    if arguments == ["--check"]:
        for path in (*stale, *gone):
            print(f"{path}: stale; run `make generated`", file=sys.stderr)
        return 1 if stale or gone else 0
    for path in gone:
        path.unlink()
    for path in stale:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(wanted[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
