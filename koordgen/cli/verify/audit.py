"""`koordgen audit`: what is asked, what is printed, and the exit status."""

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
from koordgen.verify.audit.finding import Finding
from koordgen.verify.audit.judge import Judge
from koordgen.verify.audit.meaning import Meaning
from koordgen.verify.audit.reading import found, opened
from koordgen.verify.audit.show import Audit, document, report
from koordgen.verify.audit.story import Mission, mission
from koordgen.verify.replay.functions import CannotCall

PICTURES = (".png", ".svg", ".pdf")
QUERY, ALL_QUERIES = 10.0, 60.0  # seconds that a solver has


def audit(options: Namespace) -> int:
    """The whole command."""
    if options.plot and Path(options.plot).suffix not in PICTURES:
        raise Failure(USAGE, f"--plot {options.plot}: a name that ends in {', '.join(PICTURES)} is expected")
    try:
        paths = list(dict.fromkeys(path for given in options.traces for path in found(Path(given))))
        logs = [opened(path) for path in paths]
        whole = mission(logs)
        program, functions = program_of(options, whole.log.path, whole.log.program_hash)
        judged, ended = _judged(program, functions, whole, options.seconds)
    except BadTrace as error:
        raise Failure(WRONG, str(error), "traces of one mission of one fleet are expected") from None
    except CannotCall as error:
        raise Failure(WRONG, str(error), "name it with --functions") from None
    except RecursionError:
        raise Failure(
            WRONG, "values in these traces are nested too deeply", "no robot of koordgen's writes such"
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
    program: Program, functions: Path | None, whole: Mission, seconds: float | None
) -> tuple[list[Finding], str]:
    """The findings, and why they are not of the whole mission; empty where they are. Of the last round that was begun
    nothing is counted, but a violation is."""
    line, judge, reached, ended = ProgressLine(sys.stderr), Judge(Meaning(program, functions), whole), 0, ""

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
            f"ended by --seconds {seconds:g} after {reached} of {whole.last} rounds: the properties in later rounds "
        )
        ended += "are not decided"
    finally:
        line.end()
    return [*judge.findings, *faults.loops(program, whole), *faults.contracts(program, whole)], ended


def _notes(judged: Sequence[Finding], whole: Mission) -> list[str]:
    late = faults.late(whole)
    overran = [f"{late} event{'s' * (late != 1)} were discarded because they took too long"] if late else []
    return [*whole.notes, *clocks.notes(whole), *overran, *monitors.compared(judged, whole)]


def _proved(program: Program, violated: Sequence[Finding]) -> dict[str, str]:
    """What the prover says of the program as it was flown, of any number of robots."""
    from koordgen.verify.prove.report.verdict import Question, prove
    from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

    question = Question(program, params={p.name: p.default for p in program.params})
    try:
        with solver_of("z3", Limits(query=QUERY, total=ALL_QUERIES)) as solver:
            verdicts = prove(question, solver)
    except SolverMissing as error:
        raise Failure(SURROUNDINGS, str(error), install("koordgen[prove]")) from None
    names = {finding.name for finding in violated}
    return {verdict.invariant: verdict.verdict for verdict in verdicts if verdict.invariant in names}


def _draw(made: Audit, path: Path) -> None:
    from koordgen.verify.audit.plot import draw

    try:
        draw(made, path)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}") from None
