"""The first commands of a newcomer: `make demo`, and the README's own commands in a checkout."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from koordgen.cli.commands import parsed

ROOT = Path(__file__).parents[1]


def test_the_demo_runs_in_lockstep_and_names_the_command_to_watch_it_in_real_time() -> None:
    # Its environment counts as made, whichever times a checkout gave its files: only what it does then is looked at.
    command = ["make", "--dry-run", "--no-print-directory", "--old-file=.venv/.ready", "demo"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    done = subprocess.run(command, cwd=ROOT, env=alone, capture_output=True, text=True, check=True)
    words = [shlex.split(line.removeprefix("echo ")) for line in done.stdout.splitlines()]
    run = parsed(words[0][words[0].index("koordgen") + 1 :])
    assert run.command == "sim" and run.lockstep and run.live is None
    watched = parsed(shlex.split(words[-1][-1])[1:])
    assert watched.command == "sim" and not watched.lockstep and watched.live == 0
    assert (watched.program, watched.fleet, watched.seed) == (run.program, run.fleet, run.seed)
    assert words[1][1].endswith("verdict.py") and words[1][2] == run.out


def written(words: list[str]) -> Iterator[str]:
    """Return the paths, relative to the working directory, that a command of the README writes."""
    options = dict(pairwise(words))
    yield from (options[name] for name in ("--out", "-o", "--trace", "--plot") if name in options)
    match words[1:]:
        case ["key", "new", file, *_]:
            yield file
        case ["new", folder, *_]:
            yield folder
        case ["sim" | "campaign" | "validate" as command, program, *_] if "--out" not in options:
            yield f"{'run' if command == 'sim' else command}-{Path(program).stem}"
        case ["build", *_] if "-o" not in options:
            yield "build"


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
def test_the_readmes_commands_leave_nothing_untracked_in_a_checkout() -> None:
    found: set[str] = set()
    for block in re.findall(r"^```[a-z]*\n(.*?)^```", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            if line.startswith("koordgen ") and "..." not in line:
                found.update(written(shlex.split(line, comments=True)))
    assert {"run", "fleet.key"} < found
    for path in sorted(found):
        ignored = subprocess.run(["git", "check-ignore", "--quiet", f"{path}/" if "." not in path else path], cwd=ROOT)
        assert ignored.returncode == 0, f"git does not ignore {path}"
