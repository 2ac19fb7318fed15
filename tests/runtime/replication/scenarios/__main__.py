"""Run the scenarios; `--rewrite` writes the output of `show` into the scripts as it is now."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.runtime.replication.scenarios.runner import ScriptError, run_text, scripts


def main(arguments: list[str]) -> int:
    rewrite = "--rewrite" in arguments
    named = [Path(a) for a in arguments if not a.startswith("-")]
    failed = 0
    for path in named or scripts():
        before = path.read_text()
        try:
            after = run_text(before, str(path), rewrite)
        except ScriptError as error:
            print(error)
            failed += 1
            continue
        if rewrite and after != before:
            path.write_text(after)
            print(f"{path}: rewritten")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
