"""`koordgen audit`: options, output and exit status."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from koordgen.cli.base.alarm import alarm
from koordgen.cli.base.console import HOLDS, INCONCLUSIVE, SURROUNDINGS, USAGE, VIOLATED, WRONG, Failure, install
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.base.traced import program_of
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit import blame, clocks, faults, monitors
from koordgen.verify.audit.history import FleetMission, mission
from koordgen.verify.audit.judge import PropertyJudge
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.audit.result import PropertyResult
from koordgen.verify.audit.show import Audit, document, report
from koordgen.verify.audit.trace_files import read_trace_file, trace_files
from koordgen.verify.replay.functions import CannotCall

PICTURES = (".png", ".svg", ".pdf")
QUERY, ALL_QUERIES = 10.0, 60.0  # seconds for one query of the solver, and for all queries


def audit(options: Namespace) -> int:
    """Run `koordgen audit`, and return the exit status."""
    if options.plot and Path(options.plot).suffix not in PICTURES:
        raise Failure(USAGE, f"--plot {options.plot}: the name of the picture must end in {', '.join(PICTURES)}")
    try:
        paths = list(dict.fromkeys(path for given in options.traces for path in trace_files(Path(given))))
        logs = [read_trace_file(path) for path in paths]
        whole = mission(logs)
        program, functions = program_of(options, whole.log.path, whole.log.program_hash)
        judged, ended = _judged(program, functions, whole, options.seconds)
    except BadTrace as error:
        raise Failure(WRONG, str(error), "give traces of one mission of one fleet") from None
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name the file of the extern functions with --functions") from None
    except RecursionError:
        raise Failure(
            WRONG,
            "values in these traces are nested too deeply",
            "use traces that robots wrote; they never nest values so deeply",
        ) from None
    blames = [] if ended else blame.blames(program, judged)
    proved = _proved(program, [each.invariant for each in blames]) if options.prove and blames else None
    notes = [*([ended] if ended else []), *_notes(judged, whole)]
    made = Audit(program.path, whole, judged, blames, notes, proved, bool(ended))
    status = VIOLATED if made.violated else INCONCLUSIVE if made.doubtful else HOLDS
    if options.format == "json":
        print(json.dumps(document(made, status), indent=2), flush=True)
    else:
        sys.stdout.write(coloured_verdicts(report(made), sys.stdout))
        sys.stdout.flush()
    if options.plot:
        _draw(made, Path(options.plot))
    return status


def _judged(
    program: Program, functions: Path | None, whole: FleetMission, seconds: float | None
) -> tuple[list[PropertyResult], str]:
    """Return the results of all properties, and the reason why the audit ended early; empty if it did not.

    `seconds`: time limit. If the time runs out within a round, this round counts only as the round of a violation."""
    line, judge, reached, ended = (
        ProgressLine(sys.stderr),
        PropertyJudge(GeneratedProperties(program, functions), whole),
        0,
        "",
    )

    def progress(round_: int, last: int) -> None:
        nonlocal reached
        reached = round_
        if round_ % 50 == 0:
            line.show(f"round {round_} of {last}")

    try:
        with alarm(seconds):
            judge.run(progress)
    except OutOfTime:
        ended = (
            f"ended by --seconds {seconds:g} after {reached} of {whole.last} rounds: "
            "the properties in later rounds are not decided"
        )
    finally:
        line.end()
    return [*judge.results, *faults.loops(program, whole), *faults.contracts(program, whole)], ended


def _notes(judged: Sequence[PropertyResult], whole: FleetMission) -> list[str]:
    late = faults.late(whole)
    overran = [f"{late} event{'s' * (late != 1)} were discarded because they took too long"] if late else []
    return [*whole.notes, *clocks.notes(whole), *overran, *monitors.compare_monitors(judged, whole)]


def _proved(program: Program, violated: Sequence[PropertyResult]) -> dict[str, str]:
    """Return the prover's verdicts on violated invariants, for the mission's params and any fleet size."""
    from koordgen.verify.prove.report.verdict import Question, prove
    from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

    question = Question(program, params={p.name: p.default for p in program.params})
    try:
        with solver_of("z3", Limits(query=QUERY, total=ALL_QUERIES)) as solver:
            verdicts = prove(question, solver)
    except SolverMissing as error:
        raise Failure(SURROUNDINGS, str(error), install("koordgen[prove]")) from None
    names = {result.name for result in violated}
    return {verdict.invariant: verdict.verdict for verdict in verdicts if verdict.invariant in names}


def _draw(made: Audit, path: Path) -> None:
    from koordgen.verify.audit.plot import draw

    try:
        draw(made, path)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}") from None
