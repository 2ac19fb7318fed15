"""The first commands of a newcomer: `make demo`, and the README's own commands in a checkout."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

from koordgen.cli.options import parsed

ROOT = Path(__file__).parents[1]


def test_the_demo_runs_in_lockstep_and_names_the_command_to_watch_it_in_real_time() -> None:
    # Its environment counts as made: only what it does then is looked at.
    command = ["make", "--dry-run", "STAMP=Makefile", "demo"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    words = [shlex.split(line.removeprefix("echo ")) for line in done.stdout.splitlines()]
    run = parsed(words[0][words[0].index("koordgen") + 1 :])
    assert run.command == "sim" and run.lockstep and run.live is None
    watched = parsed(shlex.split(words[-1][-1])[1:])
    assert watched.command == "sim" and not watched.lockstep and watched.live == 0
    assert (watched.program, watched.fleet, watched.seed) == (run.program, run.fleet, run.seed)
    assert words[1][1].endswith("verdict.py") and words[1][2] == run.out
