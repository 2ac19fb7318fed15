"""Exploration beside Spin: `python benchmarks/explore.py [--quick] [--json FILE]`.

Leader election is explored completely for 2 to 7 robots, beside two equivalent Promela models (`fixtures/spin.py` has
their differences; tests/verify/explore/test_spin.py compares the states at ends of rounds): `plain`, the
straightforward model, and `tight`, the fastest for Spin that we know. Seconds are CPU time, the least of a few runs.
`search` is the search alone (for Spin, the process of the compiled verifier; for us, Search on an existing machine),
`whole` includes all work before it (Spin's generator and gcc; for us, reading and compiling the program). Spin's
verifiers: gcc -O2 -DSAFETY, partial order reduction on, states not collapsed. `bare` is our explorer without any
reduction. Other examples follow, with our explorer alone, in their environments.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fixtures import spin
from koordgen.build.pipeline import check_file, read_source
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import Environment, EnvironmentSteps, possible_answers
from koordgen.verify.explore.environment_file import environment
from koordgen.verify.explore.machine import Machine
from koordgen.verify.explore.search import Search

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ELECTION = EXAMPLES / "election/election.koord"
SALT = 7
BARE = {"symmetry": False, "independence": False, "forgetting": False}  # every reduction off
OTHERS = ("atomicsum/atomicsum", "patrol/patrol", "task/task", "mapping/mapping")
BOUND = 120.0  # seconds: limit of one exploration


class Row(NamedTuple):
    """One exploration: CPU seconds; steps are transitions of Spin's."""

    what: str
    robots: int
    how: str
    states: int
    steps: int
    search: float
    whole: float
    note: str = ""


def ours(path: Path, robots: int, how: str, repeats: int, **switches: bool) -> Row:
    rows = []
    for _ in range(repeats):
        gc.collect()
        began = time.process_time()
        program, around = _surrounded(path, robots)
        functions = path.with_name(f"{path.stem}_functions.py")
        machine = Machine(program, robots, possible_answers(around, program, robots), functions)
        search = Search(
            machine,
            EnvironmentSteps(machine, around),
            ExplorationBounds(seconds=BOUND),
            time.process_time,
            lambda _: None,
            **switches,
        )
        before = time.process_time()
        result = search.run()
        ended = time.process_time()
        note = result.violation.name if result.violation else result.stopped
        progress = result.progress
        rows.append(Row(path.stem, robots, how, progress.states, progress.steps, ended - before, ended - began, note))
    return min(rows, key=lambda row: row.search)


def _surrounded(path: Path, robots: int) -> tuple[Program, Environment]:
    """Return a program with the params of the environment in its folder."""
    program, file = check_file(str(path)).program, path.with_name("explore.yaml")
    around = environment(program, robots, read_source(str(file)), lambda *_: None)
    assert around is not None, f"{file} has a mistake"
    return with_params(program, around.params), around


def of_spin(robots: int, tight: bool, repeats: int) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        ran = spin.ran(spin.election(robots, SALT, tight), Path(folder), repeats=repeats)
    how = "Spin, tight" if tight else "Spin, plain"
    return Row("election", robots, how, ran.states, ran.transitions, ran.search, ran.search + ran.making)


def show(row: Row) -> None:
    rate = row.states / row.search if row.search else 0.0
    figures = f"{row.states:>9,} {row.steps:>11,} {row.search:>9.4f} {rate:>11,.0f} {row.whole:>8.2f}"
    print(f"{row.what:<10} {row.robots:>6}  {row.how:<17} {figures}  {row.note}".rstrip(), flush=True)


def election(quick: bool) -> list[Row]:
    rows = []
    for robots in (2, 4, 6) if quick else (2, 3, 4, 5, 6, 7):
        rows.append(ours(ELECTION, robots, "koordgen", 5))
        rows.append(ours(ELECTION, robots, "koordgen, bare", 1, **BARE))
        if spin.installed():
            rows += [of_spin(robots, tight, 5) for tight in (False, True)]
        for row in rows[-4 if spin.installed() else -2 :]:
            show(row)
    return rows


def ratios(rows: list[Row]) -> dict[str, dict[str, float]]:
    """Return Spin's figures divided by ours, for equal numbers of robots."""
    mine = {row.robots: row for row in rows if row.how == "koordgen"}
    return {
        f"{row.how}, {row.robots} robots": {
            "states": row.states / mine[row.robots].states,
            "search": row.search / mine[row.robots].search,
            "whole": row.whole / mine[row.robots].whole,
        }
        for row in rows
        if row.how.startswith("Spin")
    }


def others(quick: bool) -> list[Row]:
    """Explore other examples in their environments."""
    rows = []
    for name in OTHERS[:2] if quick else OTHERS:
        path = EXAMPLES / f"{name}.koord"
        for robots in (3, 4):
            rows.append(ours(path, robots, "koordgen", 1))
            show(rows[-1])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="few rows, under a minute")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    print(f"peer: {spin.version()}" if spin.installed() else spin.MISSING)
    print(
        f"{'program':<10} {'robots':>6}  {'':<17} {'states':>9} {'steps':>11} {'search s':>9} {'states/s':>11} whole s"
    )
    rows = election(options.quick)
    by = ratios(rows)
    if by:
        print("\nSpin by koordgen                states   search    whole")
    for name, ratio in by.items():
        print(f"{name:<28} {ratio['states']:>9.1f} {ratio['search']:>8.2f} {ratio['whole']:>8.1f}")
    print()
    rows += others(options.quick)
    if options.json:
        found: dict[str, Any] = {"rows": [row._asdict() for row in rows], "ratios": by}
        Path(options.json).write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
