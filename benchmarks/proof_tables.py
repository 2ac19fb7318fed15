"""The published Tables 1 to 4 beside our times: `python benchmarks/proof_tables.py [--quick] [--json FILE]`.

The published figures are seconds of K's symbolic execution and of Z3, for each number of robots. Ours are the time to
make all obligations of the invariant (`make`) and the time of the solvers (`z3`, `cvc5`), for that number of robots
and, once, for any number. Base case, events, environment and consistency are included, in the order of the command.
Seconds are CPU time without the solver's start, so other load on the machine counts little. Queries of a few
milliseconds are repeated many times in one process, and each number is the median of several measurements, as are
ratios of 15 robots to any number. `how` is the form of the obligations: `any` (N_SYS is a symbol), `written out` (one
term for each robot) or `instances` (N_SYS is a number, otherwise as for any; used for more than 20 robots, or more than
4 if formulas have pairs of robots). In Table 2 `make` includes all of the command but the solver, and 15 robots are
first tried like any number.

Then the commands are measured, in wall-clock time and CPU time with the solver: the time of `prove` beyond `check`
(that alone with `--beyond`), the case studies for 15 and 100 robots, and Table 2.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.verify.prove.obligations.generate import obligation_groups
from koordgen.verify.prove.obligations.part_encoder import ProofProblem
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.solve import Limits, Solver

ROOT = Path(__file__).resolve().parents[1]
# (robots, dimensions) -> published seconds of K and of Z3
LINEFORM = {
    (3, 1): (4.90, 9.09), (3, 2): (4.19, 10.13), (4, 1): (4.79, 12.21), (4, 2): (5.28, 12.49), (4, 3): (5.06, 12.77),
    (5, 1): (4.91, 18.46), (5, 2): (5.60, 18.91), (5, 3): (5.42, 20.30), (10, 1): (10.92, 32.34),
    (10, 2): (10.96, 32.42), (10, 3): (11.34, 33.61), (15, 1): (12.23, 53.89),
}  # fmt: skip
TASK = {3: (9.90, 10.6), 4: (9.79, 11.78), 5: (9.91, 14.92), 10: (12.92, 18.34)}
MAPPING = {3: (9.23, 14.53), 4: (9.33, 19.25), 5: (9.19, 24.30), 10: (9.31, 59.81)}
STUDIES = {"LineForm": "lineform/geofence", "Task": "task/separation", "Mapping": "mapping/mapping"}
WEAKER = {"E, I": (13.06, 23.03), "E, WI": (9.92, 18.26), "E, A, WI": (11.24, 32.64)}  # 15 robots, 2-D, all "Unknown"
ASKED = 0.1  # least CPU seconds of a solver in one measurement
LARGE = (15, 100)  # numbers of robots of the measured commands
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


Taken = tuple[float, float]  # wall-clock and CPU seconds


class Row(NamedTuple):
    """One row of a table: seconds, and the verdict of its invariant."""

    table: str
    case: str
    robots: str
    how: str
    published: tuple[float, float] | None
    verdict: str
    make: float
    z3: float
    cvc5: float | None
    note: str


def lineform(dimensions: int, variables: tuple[str, ...], assume: str = ASSUME) -> str:
    """Return LineForm with bounds on these variables, for the first coordinates."""

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
    began = time.process_time()
    made = list(obligation_groups(program, robots, detail="little"))
    make = time.process_time() - began
    found = {name: _solving(name, made) for name in (("z3", "cvc5") if second else ("z3",))}
    verdict = "PROVED" if found["z3"][1] else "not proved"
    note = "" if len({proved for _, proved in found.values()}) == 1 else "z3 and cvc5 differ"
    unrolled = ProofProblem(program, robots, None, "little").unrolled
    how = "any" if robots is None else "written out" if unrolled else "instances"
    times = {name: seconds for name, (seconds, _) in found.items()}
    return Row(table, case, _robots(robots), how, published, verdict, make, times["z3"], times.get("cvc5"), note)


def _solving(name: str, made: list[list[Obligation]]) -> tuple[float, bool]:
    """Return CPU seconds of a solver for all these queries, and whether it gives the answers that the proof needs.

    The time is the difference between two processes, one of which solves the queries several times more often.
    """
    once, proved = _answered(name, made, 1)
    more = min(20, max(1, round(ASKED / max(once, 0.001))))
    spent = [_answered(name, made, 1 + more)[0] - _answered(name, made, 1)[0] for _ in range(3)]
    return max(0.0, statistics.median(spent)) / more, proved


def _answered(name: str, made: list[list[Obligation]], times: int) -> tuple[float, bool]:
    """Return CPU seconds of a solver's process, with its start."""
    before = _of_children()
    with Solver(name, Limits(query=60.0, total=600.0)) as solver:
        answers = solver.ask_all([room for _ in range(times) for room in made])
    return _of_children() - before, all(answer.result == o.expected for o, answer in answers)


def _of_children() -> float:
    """Return CPU seconds of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _robots(robots: int | None) -> str:
    return "any" if robots is None else str(robots)


def table_1(folder: Path, quick: bool) -> list[Row]:
    """Measure Table 1: LineForm, the invariant with the bound on targets."""
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


def weaker() -> dict[str, str]:
    """Return the programs of Table 2.

    Its first two rows assume nothing of the environment, so a robot may be anywhere after a round. That is a run from
    an initial state, not only a step from an unreachable one, so the verdict is FALSIFIED.
    """
    strong, weak = ("Motion.position", "x"), ("Motion.position",)
    cases = {"E, I": (strong, ""), "E, WI": (weak, ""), "E, A, WI": (weak, ASSUME)}
    return {case: lineform(2, variables, assume) for case, (variables, assume) in cases.items()}


def table_2(folder: Path) -> list[Row]:
    """Measure Table 2: invariants that are too weak, with a replayed counterexample and the missing assumption."""
    rows = []
    for case, text in weaker().items():
        program = program_of(text, folder)
        for robots in (None, 15):
            before, began = _of_children(), time.process_time()
            with Solver("z3", Limits()) as solver:
                found = next(v for v in prove(Question(program, robots), solver) if v.invariant == "Geofence")
            seconds, asking = time.process_time() - began, _of_children() - before
            told = found.explanation
            lacking = " and ".join((*told.supposed, *told.lacking)) if told else ""
            event_only = all(o.holds for o in found.outcomes if o.obligation.kind == "event")
            shown = "a run from the beginning" if told and told.run else "a step"
            note = f"{shown}; event alone: {'valid' if event_only else 'not valid'}; lacking: {lacking}"
            how = "any" if robots is None else "written out"
            rows.append(Row("2", case, _robots(robots), how, WEAKER[case], found.verdict, seconds, asking, None, note))
    return rows


def study(table: str, case: str, published: dict[int, tuple[float, float]], quick: bool) -> list[Row]:
    program = check_file(str(ROOT / f"examples/{STUDIES[case]}.koord")).program
    robots: list[int | None] = [None, 15] if quick else [None, *published, 15, 100]
    return [
        measured(table, case, program, n, published.get(n) if n is not None else None, not quick and n is None)
        for n in robots
    ]


def _run(arguments: tuple[str, ...], environment: dict[str, str], status: int = 0) -> Taken:
    """Return wall-clock and CPU seconds of a command and its children."""
    before, began = _of_children(), time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "koordgen", *arguments], cwd=ROOT, env=environment,
                          capture_output=True)  # fmt: skip
    wall, cpu = time.perf_counter() - began, _of_children() - before
    if done.returncode != status:
        sys.exit(f"koordgen {' '.join(arguments)}: status {done.returncode}")
    return wall, cpu


def _medians(taken: list[Taken]) -> Taken:
    return statistics.median(wall for wall, _ in taken), statistics.median(cpu for _, cpu in taken)


def beyond_check(repeats: int, environment: dict[str, str]) -> dict[str, Taken]:
    """Return wall-clock and CPU seconds of `prove` beyond `check` on the case studies: medians of runs in turn."""
    found = {}
    for case, name in STUDIES.items():
        runs: dict[str, list[Taken]] = {"check": [], "prove": []}
        for turn in range(repeats + 1):
            for command, taken in runs.items():
                one = _run((command, f"examples/{name}.koord"), environment)
                taken += [one] * (turn > 0)  # the first run compiles
        (wall, cpu), (less, idle) = _medians(runs["prove"]), _medians(runs["check"])
        found[case] = wall - less, cpu - idle
    return found


def together(repeats: int, environment: dict[str, str]) -> Taken:
    """Return the time of the case studies in one process, beyond the start of Python and the front end (median)."""
    names = [f"examples/{name}.koord" for name in STUDIES.values()]
    taken = []
    for _ in range(repeats + 1):
        command = [sys.executable, "benchmarks/proof_together.py", *names]
        done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        wall, cpu = map(float, done.stdout.split())
        taken.append((wall, cpu))
    return _medians(taken[1:])  # the first run compiles


def large(repeats: int, environment: dict[str, str]) -> dict[str, Taken]:
    """Return wall-clock and CPU seconds of whole commands: the case studies for a number of robots, and Table 2."""
    found = {}
    for case, name in STUDIES.items():
        for robots in LARGE:
            arguments = "prove", f"examples/{name}.koord", "--robots", str(robots)
            found[f"{case}, {robots} robots"] = _medians([_run(arguments, environment) for _ in range(repeats)])
    with tempfile.TemporaryDirectory() as folder:
        for case, text in weaker().items():
            path = Path(folder) / "weaker.koord"
            path.write_text(text)
            taken = [_run(("prove", str(path)), environment, status=3) for _ in range(repeats)]
            found[f"Table 2, {case}"] = _medians(taken)
    return found


def show(row: Row) -> str:
    published = f"{row.published[0]:6.2f} {row.published[1]:6.2f}" if row.published else "     -      -"
    cvc5 = f"{1000 * row.cvc5:7.0f}" if row.cvc5 is not None else "      -"
    ours = f"{1000 * row.make:7.0f} {1000 * row.z3:7.0f} {cvc5}"
    case = f"{row.case:<13} {row.robots:>6} {row.how:<11}"
    return f"{row.table:>5}  {case}  {published}  {ours}  {row.verdict:<14} {row.note}".rstrip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="few rows, under a minute")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--beyond", action="store_true", help="only the command: `prove` beyond `check`")
    options = parser.parse_args()
    gc.disable()  # as the command does
    rows = [] if options.beyond else tables(options.quick)
    ratios = _ratios(rows)
    for case, ratio in ratios.items():
        print(f"{case}: z3 for 15 robots takes {ratio:.1f} times what it takes for any number")
    with tempfile.TemporaryDirectory() as folder:
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = folder  # keep byte code, as in an installed koordgen
        beyond = beyond_check(3 if options.quick else 9, environment)
        one = together(3 if options.quick else 9, environment)
        told = {**beyond, "the three commands": _sum(beyond), "the three in one process": one}
        _tell("`prove` beyond `check`, any N (ms):", told)
        commands = {} if options.beyond else large(1 if options.quick else 3, environment)
    if commands:
        _tell("`prove`, all of the command (ms):", commands)
    if options.json:
        found = {
            "rows": [row._asdict() for row in rows],
            "beyond_check": beyond,
            "in_one_process": one,
            "commands": commands,
            "ratios": ratios,
        }
        Path(options.json).write_text(json.dumps(found, indent=2) + "\n")


def _tell(title: str, found: dict[str, Taken]) -> None:
    print(f"\n{title:<36} wall    CPU")
    for case, (wall, cpu) in found.items():
        print(f"{case:>34}  {1000 * wall:6.0f} {1000 * cpu:6.0f}")


def tables(quick: bool) -> list[Row]:
    print("                                            published (s)        ours (ms)")
    print("table  case          robots               K     Z3     make      z3    cvc5  verdict")
    rows: list[Row] = []

    def told(more: list[Row]) -> None:
        rows.extend(more)
        print("\n".join(map(show, more)), flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        told(table_1(folder, quick))
        if not quick:
            strong = program_of(lineform(2, ("Motion.position", "x", "Motion.target")), folder)
            told([measured("1", "LineForm 2-D", strong, 100, None, False)])
        told(table_2(folder))
    told(study("3", "Task", TASK, quick))
    told(study("4", "Mapping", MAPPING, quick))
    return rows


def _sum(beyond: dict[str, Taken]) -> Taken:
    return sum(wall for wall, _ in beyond.values()), sum(cpu for _, cpu in beyond.values())


def _ratios(rows: list[Row]) -> dict[str, float]:
    """Return the ratios of the solver's time for 15 robots, written out, to that for any number."""
    times = {(row.case, row.how, row.robots): row.z3 for row in rows if row.table != "2"}
    return {
        case: seconds / times[case, "any", "any"]
        for (case, how, robots), seconds in times.items()
        if (how, robots) == ("written out", "15")
    }


if __name__ == "__main__":
    main()
