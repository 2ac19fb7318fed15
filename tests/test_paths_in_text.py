"""Paths in pages, docstrings and comments: each names an existing file of the repository."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = re.compile(
    r"(?<![\w/.{\-])((?:koordgen|targets|tests|runtime|benchmarks|tools|docs)(?:/[\w\-]+)+\.(?:py|c|h|j2|md))\b"
)
TEXTS = {".md", ".py", ".c", ".h", ".toml", ".j2", ".lark", ".js"}
WRITTEN_THEN = ("docs/adr/", "CHANGELOG.md")  # of the layout of their day
# A pattern, and files of folders that tests make.
INVENTED = {"benchmarks/NAME.py", "koordgen/runtime/x.py"}


def tracked() -> list[str]:
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_paths_lead_to_files() -> None:
    files = set(tracked())
    stale = []
    for name in sorted(files):
        if Path(name).suffix not in TEXTS or name.startswith((*WRITTEN_THEN, "tests/golden/")):
            continue
        for path in FILE.findall((ROOT / name).read_text(encoding="utf-8")):
            if path not in INVENTED and not {path, f"koordgen/{path}"} & files and "_data" not in path:
                stale.append(f"{name}: {path}")
    assert not stale, "\n".join(stale)
