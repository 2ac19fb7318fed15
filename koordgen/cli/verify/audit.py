"""`koordgen audit`: options, output and exit status."""

from __future__ import annotations

import json
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from koordgen.cli.base.alarm import alarm
from koordgen.cli.base.console import HOLDS, INCONCLUSIVE, SURROUNDINGS, USAGE, VIOLATED, WRONG, Failure, install
from koordgen.cli.base.terminal import ProgressLine, coloured_verdicts
from koordgen.cli.base.traced import TracedFleet, fleet_of
from koordgen.cli.verify.squads import compared_squads
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.runtime.trace.schema import BadTrace
from koordgen.verify.audit import blame, clocks, faults, monitors
from koordgen.verify.audit.blame import Blame
from koordgen.verify.audit.history import FleetMission, mission, of_application
from koordgen.verify.audit.judge import PropertyJudge
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.audit.result import PropertyResult
from koordgen.verify.audit.shared_store import AuditedFleet
from koordgen.verify.audit.show import Audit, document, fleet_document, note_lines, report
from koordgen.verify.audit.trace_files import read_trace_file, trace_files
from koordgen.verify.prove.report.composition import question_of
from koordgen.verify.prove.report.verdict import Question
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
        fleet = fleet_of(options, whole.log.path, whole.log.header)
        audits = _audited(options, fleet, whole)
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
    merged = whole.log.path if not whole.log.own and len(paths) == 1 else None
    squads = [] if merged is None else compared_squads(merged, fleet.system.applications[0].program, whole)
    violated, doubtful = any(each.violated for each in audits), any(each.doubtful for each in audits)
    violated |= any(squad.differences for squad in squads)
    status = VIOLATED if violated else INCONCLUSIVE if doubtful else HOLDS
    notes = _notes_of_traces(whole) if fleet.is_composed else []
    if options.format == "json":
        made = fleet_document(audits, notes, status) if fleet.is_composed else document(audits[0], status)
        made |= {"squads": [squad.document for squad in squads]} if squads else {}
        print(json.dumps(made, indent=2), flush=True)
    else:
        parts = [*map(report, audits), *(["\n".join(note_lines(notes)) + "\n"] if notes else [])]
        if squads:
            parts.append(
                "".join([f"{line}\n" for squad in squads for line in (*squad.difference_lines, squad.summary)])
            )
        text = "\n".join(parts)
        sys.stdout.write(coloured_verdicts(text, sys.stdout))
        sys.stdout.flush()
    if options.plot:
        _draw(audits, Path(options.plot))
    return status


def _audited(options: Namespace, fleet: TracedFleet, whole: FleetMission) -> list[Audit]:
    """Return the audit of each application."""
    system = fleet.system
    missions = [of_application(whole, each) for each in system.applications] if fleet.is_composed else [whole]
    audited, left = AuditedFleet(system, tuple(missions)), _left(options.seconds)
    proofs: list[dict[str, str]] | None = None
    found = []
    for index, (application, mission_) in enumerate(zip(fleet.programs.applications, missions, strict=False)):
        judged, ended = _judged(fleet, audited, index, options.seconds, left())
        question = _question(fleet.programs, index)
        blames = [] if ended else blame.blames(question, judged)
        if options.prove and blames and proofs is None:
            proofs = _proofs(fleet.programs)
        notes = [*([ended] if ended else []), *_notes(judged, mission_, fleet.is_composed)]
        name = application.name if fleet.is_composed else ""
        proved = _proved(proofs[index], blames) if proofs is not None and blames else None
        found.append(Audit(application.program.path, mission_, judged, blames, notes, proved, bool(ended), name))
    return found


def _left(seconds: float | None) -> Callable[[], float | None]:
    """Return a function that returns the rest of a time limit in seconds; None if there is no limit."""
    began = time.monotonic()
    return lambda: None if seconds is None else max(1e-3, seconds - (time.monotonic() - began))


def _judged(
    fleet: TracedFleet, audited: AuditedFleet, index: int, limit: float | None, left: float | None
) -> tuple[list[PropertyResult], str]:
    """Return the results of an application's properties, and the reason why the audit ended early; empty if not.

    `limit`: time limit of the command in seconds. `left`: the rest of it. If the time runs out within a round, this
    round counts only as the round of a violation."""
    program, whole = fleet.system.applications[index].program, audited.missions[index]
    judge = PropertyJudge(GeneratedProperties(program, fleet.functions[index]), audited, index)
    line, reached, ended = ProgressLine(sys.stderr), 0, ""

    def progress(round_: int, last: int) -> None:
        nonlocal reached
        reached = round_
        if round_ % 50 == 0:
            line.show(f"round {round_} of {last}")

    try:
        with alarm(left):
            judge.run(progress)
    except OutOfTime:
        ended = (
            f"ended by --seconds {limit:g} after {reached} of {whole.last} rounds: "
            "the properties in later rounds are not decided"
        )
    finally:
        line.end()
    return [*judge.results, *faults.loops(program, whole), *faults.contracts(program, whole)], ended


def _notes(judged: Sequence[PropertyResult], whole: FleetMission, is_part: bool) -> list[str]:
    """Return the notes about an application. `is_part`: notes about the traces are for the fleet, not for each part."""
    late = faults.late(whole)
    overran = [f"{late} event{'s' * (late != 1)} were discarded because they took too long"] if late else []
    return [*([] if is_part else _notes_of_traces(whole)), *overran, *monitors.compare_monitors(judged, whole)]


def _notes_of_traces(whole: FleetMission) -> list[str]:
    return [*whole.notes, *clocks.notes(whole)]


def _question(system: System, index: int) -> Question:
    """Return the prover's question about an application, for the mission's params and any number of robots."""
    given = {a.name: {p.name: p.default for p in a.program.params} for a in system.applications}
    for imported in system.applications[index].program.imports:
        given[system.applications[index].name].pop(imported.size)
    return question_of(system, index, given)


def _proofs(system: System) -> list[dict[str, str]]:
    """Return the prover's verdicts on each application's invariants, for the mission's params and any fleet size."""
    from koordgen.verify.prove.report.composition import prove_system
    from koordgen.verify.prove.report.verdict import prove
    from koordgen.verify.prove.smt.solve import Limits, SolverMissing, solver_of

    try:
        with solver_of("z3", Limits(query=QUERY, total=ALL_QUERIES)) as solver:
            if len(system.applications) == 1:
                return [{v.invariant: v.verdict for v in prove(_question(system, 0), solver)}]
            params = {a.name: _question(system, i).params or {} for i, a in enumerate(system.applications)}
            found = prove_system(system, solver, params)
    except SolverMissing as error:
        raise Failure(SURROUNDINGS, str(error), install("koordgen[prove]")) from None
    return [{v.invariant: v.verdict for v in part.verdicts} for part in found.applications]


def _proved(verdicts: Mapping[str, str], blames: Sequence[Blame]) -> dict[str, str]:
    """Return the verdicts on violated invariants."""
    names = {each.invariant.name for each in blames}
    return {name: verdict for name, verdict in verdicts.items() if name in names}


def _draw(made: Sequence[Audit], path: Path) -> None:
    from koordgen.verify.audit.plot import draw

    try:
        draw(made, path)
    except OSError as error:
        raise Failure(SURROUNDINGS, f"{path}: {error.strerror or error}") from None
