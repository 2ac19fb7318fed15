"""The published Tables 1 to 4 with our times beside them: `python benchmarks/proof_tables.py [--quick] [--json FILE]`.

Published are, for each number of robots, seconds of K's symbolic execution and of Z3. Ours are the making of all
obligations of the invariant (`make`) and the solvers' answers (`z3`, `cvc5`), for that number of robots and, once, for
every number; base, events, environment and consistency are all in them. The solver is one process for a row, started
before the clock.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from koordgen.ir.decl import Program
from koordgen.pipeline import check_file
from koordgen.prove.generate import obligations
from koordgen.prove.solve import Limits, Solver
from koordgen.prove.verdict import Question, prove

ROOT = Path(__file__).resolve().parents[1]
# (robots, dimensions) -> published seconds of K and of Z3
LINEFORM = {
    (3, 1): (4.90, 9.09), (3, 2): (4.19, 10.13), (4, 1): (4.79, 12.21), (4, 2): (5.28, 12.49), (4, 3): (5.06, 12.77),
    (5, 1): (4.91, 18.46), (5, 2): (5.60, 18.91), (5, 3): (5.42, 20.30), (10, 1): (10.92, 32.34),
    (10, 2): (10.96, 32.42), (10, 3): (11.34, 33.61), (15, 1): (12.23, 53.89),
}  # fmt: skip
TASK = {3: (9.90, 10.6), 4: (9.79, 11.78), 5: (9.91, 14.92), 10: (12.92, 18.34)}
MAPPING = {3: (9.23, 14.53), 4: (9.33, 19.25), 5: (9.19, 24.30), 10: (9.31, 59.81)}
WEAKER = {"E, I": (13.06, 23.03), "E, WI": (9.92, 18.26), "E, A, WI": (11.24, 32.64)}  # 15 robots, 2-D, all "Unknown"
ASSUME = "  assume position' in Rect(position, target)\n"
PROGRAM = """\
param Point lo = Point(0, 0, 0)
param Point hi = Point(9, 9, 3)

using Motion:
  sensors: Point position
  actuators: Point target
{assume}
allread: Point x[N_SYS]

init: x[pid] = Motion.position

TargetUpdate:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    Motion.target = (x[pid + 1] + x[pid - 1]) / 2
    x[pid] = Motion.position

initially: forall i in ID: {start}

invariant Geofence: forall i in ID: {bounds}
"""


class Row(NamedTuple):
    """Seconds; verdict of the row's invariant."""

    table: str
    case: str
    robots: str
    published: tuple[float, float] | None
    verdict: str
    make: float
    z3: float
    cvc5: float | None
    note: str


def lineform(dimensions: int, variables: tuple[str, ...], assume: str = ASSUME) -> str:
    """The program with bounds on these variables, in the first coordinates."""

    def bounded(variable: str) -> str:
        return " and ".join(f"lo.{c} <= {variable}[i].{c} <= hi.{c}" for c in "xyz"[:dimensions])

    return PROGRAM.format(
        assume=assume, start=bounded("Motion.position"), bounds=" and ".join(bounded(v) for v in variables)
    )


def program_of(text: str, folder: Path) -> Program:
    path = folder / "lineform.koord"
    path.write_text(text)
    return check_file(str(path)).program


def measured(table: str, case: str, program: Program, robots: int | None, published: tuple[float, float] | None,
             second: bool) -> Row:  # fmt: skip
    began = time.perf_counter()
    made = obligations(program, robots)
    make = time.perf_counter() - began
    times, said = {}, {}
    for name in ("z3", "cvc5") if second else ("z3",):
        with Solver(name, Limits(query=60.0, total=600.0)) as solver:
            solver.ask(made[0])  # a process that has answered once has loaded everything
            solver.spent = 0.0
            answers = [solver.ask(o) for o in made]
        times[name] = sum(a.seconds for a in answers)
        said[name] = all(a.result == o.expected for a, o in zip(answers, made, strict=True))
    verdict = "PROVED" if said["z3"] else "not proved"
    note = "" if len(set(said.values())) == 1 else "z3 and cvc5 differ"
    return Row(table, case, _robots(robots), published, verdict, make, times["z3"], times.get("cvc5"), note)


def _robots(robots: int | None) -> str:
    return "any" if robots is None else str(robots)


def table_1(folder: Path, quick: bool) -> list[Row]:
    """LineForm: the invariant with the bound on targets."""
    rows = []
    for dimensions in (2,) if quick else (1, 2, 3):
        program = program_of(lineform(dimensions, ("Motion.position", "x", "Motion.target")), folder)
        wanted = [n for n, d in LINEFORM if d == dimensions and (not quick or n in (3, 10))]
        for robots in [None, *wanted, 15] if 15 not in wanted else [None, *wanted]:
            published = LINEFORM.get((robots, dimensions)) if robots is not None else None
            rows.append(
                measured("1", f"LineForm {dimensions}-D", program, robots, published, not quick or robots is None)
            )
    return rows


def table_2(folder: Path) -> list[Row]:
    """What is too weak: with a counterexample that was replayed, and what is lacking."""
    rows = []
    strong, weak = ("Motion.position", "x"), ("Motion.position",)
    for case, variables, assume in (("E, I", strong, ""), ("E, WI", weak, ""), ("E, A, WI", weak, ASSUME)):
        program = program_of(lineform(2, variables, assume), folder)
        for robots in (None, 15):
            with Solver("z3", Limits()) as solver:
                solver.start()
                began = time.perf_counter()
                found = next(v for v in prove(Question(program, robots), solver) if v.invariant == "Geofence")
                seconds = time.perf_counter() - began
            told = found.explanation
            lacking = " and ".join(told.lacking) if told else ""
            event_only = all(o.holds for o in found.outcomes if o.obligation.kind == "event")
            note = f"event alone: {'valid' if event_only else 'not valid'}; lacking: {lacking or 'an assumption'}"
            rows.append(Row("2", case, _robots(robots), WEAKER[case], found.verdict, seconds, 0.0, None, note))
    return rows


def study(table: str, name: str, published: dict[int, tuple[float, float]], quick: bool) -> list[Row]:
    program = check_file(str(ROOT / f"examples/{name}/{name}.koord")).program
    wanted = [3] if quick else list(published)
    robots: list[int | None] = [None, *wanted]
    return [measured(table, name, program, n, published.get(n) if n is not None else None, not quick) for n in robots]


def command_line(quick: bool) -> dict[str, float]:
    """Wall seconds that `prove` takes beyond `check` on the three case studies, the least of some runs of each."""
    found = {}
    for name in ("lineform", "task", "mapping"):
        path = str(ROOT / f"examples/{name}/{name}.koord")
        least = {}
        for command in ("check", "prove"):
            runs = []
            for _ in range(3 if quick else 9):
                began = time.perf_counter()
                subprocess.run([sys.executable, "-m", "koordgen", command, path], cwd=ROOT, capture_output=True)
                runs.append(time.perf_counter() - began)
            least[command] = min(runs)
        found[name] = least["prove"] - least["check"]
    return found


def show(row: Row) -> str:
    published = f"{row.published[0]:6.2f} {row.published[1]:6.2f}" if row.published else "     -      -"
    cvc5 = f"{1000 * row.cvc5:7.0f}" if row.cvc5 is not None else "      -"
    ours = f"{1000 * row.make:7.0f} {1000 * row.z3:7.0f} {cvc5}"
    return f"{row.table:>5}  {row.case:<13} {row.robots:>6}  {published}  {ours}  {row.verdict:<14} {row.note}".rstrip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="few rows, under a minute")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    print("                                published (s)        ours (ms)")
    print("table  case          robots       K     Z3     make      z3    cvc5  verdict")
    rows: list[Row] = []

    def told(more: list[Row]) -> None:
        rows.extend(more)
        print("\n".join(map(show, more)), flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        told(table_1(folder, options.quick))
        if not options.quick:
            strong = program_of(lineform(2, ("Motion.position", "x", "Motion.target")), folder)
            told([measured("1", "LineForm 2-D", strong, 100, None, False)])
        told(table_2(folder))
    told(study("3", "task", TASK, options.quick))
    told(study("4", "mapping", MAPPING, options.quick))
    beyond = command_line(options.quick)
    print(f"\n`prove` beyond `check`, any N: {', '.join(f'{n} {1000 * s:.0f} ms' for n, s in beyond.items())}; "
          f"together {1000 * sum(beyond.values()):.0f} ms")  # fmt: skip
    ratio = _ratio(rows)
    if ratio:
        print(f"z3 for 15 robots takes {ratio:.1f} times what it takes for any number (LineForm 2-D)")
    if options.json:
        found: dict[str, Any] = {"rows": [row._asdict() for row in rows], "beyond_check": beyond, "ratio": ratio}
        Path(options.json).write_text(json.dumps(found, indent=2) + "\n")


def _ratio(rows: list[Row]) -> float | None:
    times = {row.robots: row.z3 for row in rows if row.case == "LineForm 2-D"}
    return times["15"] / times["any"] if "15" in times and "any" in times else None


if __name__ == "__main__":
    main()
