"""`koordgen prove`: options, output and exit status."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from koordgen.cli.base.building import params
from koordgen.cli.base.console import (
    HOLDS,
    INCONCLUSIVE,
    INTERNAL,
    SURROUNDINGS,
    USAGE,
    VIOLATED,
    Failure,
    install,
    notify,
    print_diagnostics,
)
from koordgen.cli.base.values import is_fleet

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from koordgen.lang.analyze.params import Value
    from koordgen.lang.ir.decl import Program
    from koordgen.lang.ir.expr import Expr
    from koordgen.lang.source import Source
    from koordgen.verify.prove.report.levels import LevelVerdicts
    from koordgen.verify.prove.report.show import Attacks
    from koordgen.verify.prove.report.verdict import InvariantVerdict
    from koordgen.verify.prove.smt.solve import CrossCheck, Solver

ALL_QUERIES = 60.0  # least time limit of the command in seconds


def run(options: Namespace) -> int:
    """Run `koordgen prove`, and return the exit status."""
    from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

    if options.attack_from is not None:
        if is_fleet(options.program):
            raise Failure(USAGE, f"--attack-from is for a single program, not for the fleet file {options.program}", "")
        from koordgen.cli.verify.attack import attack_from_file

        return attack_from_file(options)
    limits = Limits(query=options.timeout, total=_total(options))
    try:
        with solver_of(options.solver, limits) as solver:
            solver.start()  # the solver loads while this process imports the compiler and checks the program
            if is_fleet(options.program):
                from koordgen.cli.verify.composition import prove_fleet

                found, files = prove_fleet(options, solver, _total(options))
                if options.emit is not None:
                    emit(options.emit, files)
                return status(found)
            return prove_program(options, solver)
    except SolverMissing as error:
        raise Failure(SURROUNDINGS, str(error), install("koordgen[prove]")) from None


def _total(options: Namespace) -> float:
    """Return the time limit of the command in seconds, for all queries and their preparation."""
    return max(ALL_QUERIES, 10 * float(options.timeout))


def prove_program(options: Namespace, solver: Solver | CrossCheck) -> int:
    """Check a program, prove its invariants, and print or write the results. Raises SolverMissing."""
    from koordgen.build.pipeline import check_file
    from koordgen.cli.verify.attack import attack_verdicts
    from koordgen.cli.verify.levels import prove_inner, read_outer, with_validation_of
    from koordgen.verify.prove.report.levels import with_levels

    checked = check_file(options.program)
    if options.format == "text":
        print_diagnostics([(checked.source, d) for d in checked.diagnostics], options)
    outer = read_outer(options, checked.program)
    given = {**outer.params, **params(options.param)}
    question = fixed_params(checked.program, given)
    found = verdicts_by_robots(checked.program, question, options.robots, solver, _total(options))
    attacks = attack_verdicts(checked.program, question, found, solver, options)
    levels = prove_inner(options, outer, checked.program, question, solver, _total(options))
    levels = with_validation_of(options, outer, levels, _hash_with(checked.program, options.program, given))
    found = [with_levels(verdicts, levels) for verdicts in found]
    solver.stop()  # the operating system frees the solver's memory while this process prints
    print_verdicts(options, found, attacks, levels, outer.targeted)
    if options.emit is not None:
        emit(options.emit, files(checked.source, checked.program, question, options.robots, found))
    if options.trace is not None:
        made = trace_of(checked.program, options.program, given, found)
        if made:
            save(options.trace, made)
        else:
            notify(f"note: no counterexample was found, so no trace was written to {options.trace}")
    worst = status(found)
    return worst if worst != HOLDS or all(each.is_proved for each in levels) else INCONCLUSIVE


def verdicts_by_robots(
    program: Program, params: Mapping[str, Expr], robots: list[int | None], solver: Solver | CrossCheck, seconds: float
) -> list[list[InvariantVerdict]]:
    """Prove the invariants for each number of robots, in at most `seconds` in total.

    Raises SolverMissing."""
    from koordgen.cli.base.alarm import alarm
    from koordgen.lang.semantics.deadline import OutOfTime
    from koordgen.verify.prove.report.verdict import Question, prove

    until = time.monotonic() + seconds
    found = []
    for n in robots:
        try:
            with alarm(max(0.0, until - time.monotonic())):
                found.append(prove(Question(program, n, params), solver))
        except OutOfTime:
            reason = f"the time limit of {seconds:g} s for the whole command is over; try a longer --timeout"
            found.append(undecided(program, n, reason))
    return found


def undecided(program: Program, robots: int | None, reason: str) -> list[InvariantVerdict]:
    """Return the verdict UNKNOWN for every invariant, because the proof of the program was given up."""
    from koordgen.verify.prove.report.verdict import InvariantVerdict

    names = [p.name for p in program.properties if p.kind == "invariant"]
    return [InvariantVerdict(name, "UNKNOWN", robots, (), reason, None, (), ()) for name in names]


def fixed_params(program: Program, given: Mapping[str, Value]) -> dict[str, Expr]:
    """Return the given params as constants; a proof treats all other params as arbitrary. Raises Failure."""
    if not given:
        return {}
    from koordgen.lang.analyze.params import BadParam, with_params

    try:
        return {p.name: p.default for p in with_params(program, given).params if p.name in given}
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None


def status(found: list[list[InvariantVerdict]]) -> int:
    """Return the exit status for the worst verdict. A violation is worse than an unknown result."""
    said = {verdict.verdict for verdicts in found for verdict in verdicts}
    if "UNSOUND" in said:
        return INTERNAL
    if said & {"FALSIFIED", "NOT INDUCTIVE"}:
        return VIOLATED
    return INCONCLUSIVE if said & {"UNKNOWN", "VACUOUS"} else HOLDS


def print_verdicts(
    options: Namespace, found: list[list[InvariantVerdict]], attacks: list[Attacks],
    levels: Sequence[LevelVerdicts] = (), targeted: Sequence[str] = (),
) -> None:  # fmt: skip
    """Print the verdicts about the program, then those about inner programs.

    `targeted`: the robots of a fleet with squads that have a target."""
    from koordgen.cli.base.terminal import coloured_verdicts
    from koordgen.verify.prove.report.show import document, report

    if options.format == "json":
        import json

        made_of_all = document(zip(found, attacks, strict=True))
        if levels:
            from koordgen.verify.prove.report.levels import levels_document

            made_of_all["levels"] = [levels_document(each) for each in levels]
        print(json.dumps(made_of_all, indent=2), flush=True)
        return
    for verdicts, made in zip(found, attacks, strict=True):
        sys.stdout.write(coloured_verdicts(report(verdicts, options.program, made), sys.stdout))
    if levels:
        from koordgen.verify.prove.report.levels import levels_text

        for each in levels:
            sys.stdout.write(coloured_verdicts(f"\n{levels_text(each)}", sys.stdout))
        if targeted and any(each.provided for each in levels):
            print(f"\nnot proved of robots with a target, which no program describes: {', '.join(targeted)}")


def files(
    source: Source,
    program: Program,
    params: Mapping[str, Expr],
    robots: list[int | None],
    found: list[list[InvariantVerdict]],
) -> dict[str, bytes]:
    """Return the files that `--emit` writes, for all requested numbers of robots: name -> content.

    Each obligation has the form of its last query to the solver, with the names of all cells."""
    from koordgen.lang.node import replace
    from koordgen.verify.prove.obligations.generate import obligations
    from koordgen.verify.prove.smt.emit import folder

    made = []
    for number, verdicts in zip(robots, found, strict=True):
        last = {o.obligation.name: o.obligation for verdict in verdicts for o in verdict.outcomes}
        wanted = [o for o in obligations(program, number, params) if o.at is None or o.name in last]
        made += [replace(last.get(o.name, o), cells=o.cells) for o in wanted]
    return folder(made, lambda _, line: source.line(line))


def trace_of(program: Program, path: str, given: Mapping[str, Value], found: list[list[InvariantVerdict]]) -> str:
    """Return the trace of a counterexample, preferably of a whole run; empty without counterexamples."""
    from koordgen.lang.analyze.params import BadParam, as_given, with_params
    from koordgen.verify.follow.exact import nearest
    from koordgen.verify.prove.report.model import plain_value
    from koordgen.verify.prove.report.trace import RunOrigin, trace
    from koordgen.verify.replay.values import BadValue, from_trace, plain

    told = [v.explanation for verdicts in found for v in verdicts if v.explanation and v.explanation.counterexample]
    if not told:
        return ""
    first = next((t for t in told if t.run is not None), told[0])
    assert first.counterexample is not None
    state = first.run.run_states[0].state if first.run is not None else first.counterexample.before
    values = {}
    try:
        for p in program.params:
            # numbers are rounded to the nearest float that robots can represent
            near = from_trace(plain_value(state.params[p.name]), p.type, nearest)
            values[p.name] = as_given(plain(near), p.type)
        hashed, _ = hash_of(with_params(program, {**values, **given}), path, None)
    except (BadParam, BadValue):  # the counterexample contains numbers that no robot can represent
        hashed = ""
    return trace(program, first, RunOrigin(hashed, tuple(p.name for p in program.params)))


def _hash_with(program: Program, path: str, given: Mapping[str, Value]) -> str:
    """Return the hash that the bundles of a program with these params have."""
    from koordgen.lang.analyze.params import with_params

    return hash_of(with_params(program, given), path, None)[0]


def hash_of(program: Program, path: str, functions: str | None) -> tuple[str, Path | None]:
    """Return the hash that the program's bundles have, and the path of its file of extern functions."""
    from pathlib import Path

    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.program import program_hash

    file = functions_file(program, Path(path).parent, functions)
    return program_hash(program, file.read_bytes() if file and file.is_file() else b""), file


def emit(folder: str, files: dict[str, bytes]) -> None:
    """Write files to a folder, all or none of them. Files that koordgen did not write are kept."""
    from pathlib import Path

    from koordgen.build.bundle.write import SUMS, CannotWrite, sums, write

    place = Path(folder).absolute()
    try:
        write({place.name: {**files, SUMS: sums(files)}}, place.parent)
    except CannotWrite as error:
        raise Failure(SURROUNDINGS, str(error), "give --emit another folder, or free space on the disk") from None


def save(path: str, text: str) -> None:
    """Write a text to a file that the user named. Raises Failure if the file cannot be written."""
    try:
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}") from None
