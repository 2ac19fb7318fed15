"""`koordgen prove`: what is asked, what is printed, and the exit status."""

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

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping
    from pathlib import Path

    from koordgen.lang.analyze.params import Value
    from koordgen.lang.ir.decl import Program
    from koordgen.lang.ir.expr import Expr
    from koordgen.lang.source import Source
    from koordgen.verify.prove.report.show import Attacks
    from koordgen.verify.prove.report.verdict import Verdict
    from koordgen.verify.prove.smt.solve import Both, Solver

ALL_QUERIES = 60.0  # seconds, at least


def run(options: Namespace) -> int:
    """The whole command."""
    from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

    if options.attack_from is not None:
        from koordgen.cli.verify.attack import again

        return again(options)
    limits = Limits(query=options.timeout, total=_total(options))
    try:
        with solver_of(options.solver, limits) as solver:
            solver.start()  # it loads while the compiler does, and the program is checked
            return proved(options, solver)
    except SolverMissing as error:
        raise Failure(SURROUNDINGS, str(error), install("koordgen[prove]")) from None


def _total(options: Namespace) -> float:
    """Seconds for the command: all queries, and what is made for them."""
    return max(ALL_QUERIES, 10 * float(options.timeout))


def proved(options: Namespace, solver: Solver | Both) -> int:
    """Checks, writes and tells what was asked for. Raises SolverMissing."""
    from koordgen.build.pipeline import check_file, fleet_params
    from koordgen.cli.verify.attack import attacked

    checked = check_file(options.program)
    if options.format == "text":
        print_diagnostics([(checked.source, d) for d in checked.diagnostics], options)
    given = {**fleet_params(options.fleet, checked, options.program), **params(options.param)}
    question = fixed(checked.program, given)
    found = asked(checked.program, question, options.robots, solver, _total(options))
    attacks = attacked(checked.program, question, found, solver, options)
    solver.stop()  # what it holds is freed while we tell
    tell_verdicts(options, found, attacks)
    if options.emit is not None:
        emit(options.emit, files(checked.source, checked.program, question, options.robots, found))
    if options.trace is not None:
        made = trace_of(checked.program, options.program, given, found)
        if made:
            save(options.trace, made)
        else:
            notify(f"note: there is no counterexample, and so no trace: {options.trace} was not written")
    return status(found)


def asked(
    program: Program, params: Mapping[str, Expr], robots: list[int | None], solver: Solver | Both, seconds: float
) -> list[list[Verdict]]:
    """The verdicts for each number of robots, within so many seconds in all. Raises SolverMissing."""
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
            reason = f"the command's {seconds:g} s are over: a longer --timeout makes them more"
            found.append(undecided(program, n, reason))
    return found


def undecided(program: Program, robots: int | None, reason: str) -> list[Verdict]:
    """UNKNOWN of every invariant: the proof as a whole was given up."""
    from koordgen.verify.prove.report.verdict import Verdict

    names = [p.name for p in program.properties if p.kind == "invariant"]
    return [Verdict(name, "UNKNOWN", robots, (), reason, None, (), ()) for name in names]


def fixed(program: Program, given: Mapping[str, Value]) -> dict[str, Expr]:
    """The params that have a value, as constants; the others may have any. Raises Failure."""
    if not given:
        return {}
    from koordgen.lang.analyze.params import BadParam, with_params

    try:
        return {p.name: p.default for p in with_params(program, given).params if p.name in given}
    except BadParam as error:
        raise Failure(USAGE, str(error)) from None


def status(found: list[list[Verdict]]) -> int:
    """The worst of all verdicts: a violation before what is not known."""
    said = {verdict.verdict for verdicts in found for verdict in verdicts}
    if "UNSOUND" in said:
        return INTERNAL
    if said & {"FALSIFIED", "NOT INDUCTIVE"}:
        return VIOLATED
    return INCONCLUSIVE if said & {"UNKNOWN", "VACUOUS"} else HOLDS


def tell_verdicts(options: Namespace, found: list[list[Verdict]], attacks: list[Attacks]) -> None:
    from koordgen.cli.base.terminal import coloured_verdicts
    from koordgen.verify.prove.report.show import document, report

    if options.format == "json":
        import json

        print(json.dumps(document(zip(found, attacks, strict=True)), indent=2), flush=True)
        return
    for verdicts, made in zip(found, attacks, strict=True):
        sys.stdout.write(coloured_verdicts(report(verdicts, options.program, made), sys.stdout))


def files(
    source: Source, program: Program, params: Mapping[str, Expr], robots: list[int | None], found: list[list[Verdict]]
) -> dict[str, bytes]:
    """What `--emit` writes, for all numbers of robots that were asked for: each obligation as it was asked last, with
    the names of all cells."""
    from koordgen.lang.node import replace
    from koordgen.verify.prove.obligations.generate import obligations
    from koordgen.verify.prove.smt.emit import folder

    made = []
    for number, verdicts in zip(robots, found, strict=True):
        asked = {o.obligation.name: o.obligation for verdict in verdicts for o in verdict.outcomes}
        wanted = [o for o in obligations(program, number, params) if o.at is None or o.name in asked]
        made += [replace(asked.get(o.name, o), cells=o.cells) for o in wanted]
    return folder(made, lambda _, line: source.line(line))


def trace_of(program: Program, path: str, given: Mapping[str, Value], found: list[list[Verdict]]) -> str:
    """The first counterexample as a trace, one that is a run if there is any; empty where there is none."""
    from koordgen.lang.analyze.params import BadParam, as_given, with_params
    from koordgen.verify.follow.exact import nearest
    from koordgen.verify.prove.report.model import plain_value
    from koordgen.verify.prove.report.trace import About, trace
    from koordgen.verify.replay.values import BadValue, plain, taken

    told = [v.explanation for verdicts in found for v in verdicts if v.explanation and v.explanation.counterexample]
    if not told:
        return ""
    first = next((t for t in told if t.run is not None), told[0])
    assert first.counterexample is not None
    state = first.run.moments[0].state if first.run is not None else first.counterexample.before
    values = {}
    try:
        for p in program.params:
            near = taken(plain_value(state.params[p.name]), p.type, nearest)  # as robots have it
            values[p.name] = as_given(plain(near), p.type)
        hashed, _ = hash_of(with_params(program, {**values, **given}), path, None)
    except (BadParam, BadValue):  # numbers that robots do not have
        hashed = ""
    return trace(program, first, About(hashed, tuple(p.name for p in program.params)))


def hash_of(program: Program, path: str, functions: str | None) -> tuple[str, Path | None]:
    """The hash of a program in a file, as its bundles have it, and the file of its extern functions."""
    from pathlib import Path

    from koordgen.build.bundle.functions import functions_file
    from koordgen.build.emit.program import program_hash

    file = functions_file(program, Path(path).parent, functions)
    return program_hash(program, file.read_bytes() if file and file.is_file() else b""), file


def emit(folder: str, files: dict[str, bytes]) -> None:
    """Writes the folder, whole or not at all; what is not koordgen's stays."""
    from pathlib import Path

    from koordgen.build.bundle.write import SUMS, CannotWrite, sums, write

    place = Path(folder).absolute()
    try:
        write({place.name: {**files, SUMS: sums(files)}}, place.parent)
    except CannotWrite as error:
        raise Failure(SURROUNDINGS, str(error), "choose another folder with --emit, or make room") from None


def save(path: str, text: str) -> None:
    """A file that was asked for by name. Raises Failure."""
    try:
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}") from None
