"""Audit results for contracts of extern functions, for discarded events and for loop invariants.

The results come from checks that robots made and recorded in their traces. No formula is evaluated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.tree import walk
from koordgen.runtime.program.program import Fault
from koordgen.verify.audit.history import FleetMission, RobotHistory
from koordgen.verify.audit.result import AFTER, AuditViolation, ObservationTime, Outcome, PropertyResult
from koordgen.verify.prove.report.koord_text import to_koord
from koordgen.verify.replay.robot import OVERRAN

# text in a record of a discarded event; koordgen/runtime/program/extern.py writes it
_CONTRACT = re.compile(r"(?:precondition|postcondition|requires|ensures) \(line (\d{1,9})\)")


def contracts(program: decl.Program, mission: FleetMission) -> list[PropertyResult]:
    """Return a result for each line of a contract, and as the last one the result `well-defined`.

    `well-defined` is violated if an event was discarded because of a fault of the program, except a broken contract.
    The results count events, since robots do not record single calls of extern functions."""
    found = {
        formula.span.line: PropertyResult("contract", f"{extern.name} {word} {to_koord(formula)}", formula.span.line)
        for extern in program.externs
        for word, formulas in (("requires", extern.requires), ("ensures", extern.ensures))
        for formula in formulas
    }
    general = PropertyResult("well-defined", "", 0)
    _miss([*found.values(), general], mission)
    for round_ in range(max(1, mission.first), mission.last + 1):
        told: dict[int, list[tuple[Outcome, str]]] = {line: [] for line in (0, *found)}
        for history in mission.histories:
            record = _record(history, round_)
            if round_ < history.since:
                for outcomes in told.values():
                    outcomes.append(("unknown", history.silent(round_)))
            if record.get("event") is None and record.get("fault") is None:
                continue
            broken = _line(record, found)
            for line, outcomes in told.items():
                outcomes.append(("violated" if line == broken else "held", ""))
            result = general if broken == 0 else found.get(broken)
            if result is not None and result.first is None:
                result.first = _violation(history, round_, record)
        for result in (general, *found.values()):
            result.close(round_, told[result.line], of_each=True)
    return [*found.values(), general]


def loops(program: decl.Program, mission: FleetMission) -> list[PropertyResult]:
    """Return a result for each loop invariant of a program.

    The results count all events and `init`s that ran, also events that do not contain the loop."""
    parts = (program.functions, program.init, program.events)
    invariants = {n.span.line: n for n in walk(parts) if isinstance(n, stmt.LoopInvariant)}
    found = {line: PropertyResult("loop invariant", f"line {line}", line) for line in sorted(invariants)}
    _miss(list(found.values()), mission)
    for round_ in range(mission.first, mission.last + 1):
        ran: list[tuple[RobotHistory, Mapping[str, Any]]] = []
        for history in mission.histories:
            record = (history.init or {}) if round_ == 0 else _record(history, round_)
            if record.get("kind") == "init" or (record.get("event") is not None and record.get("fault") is None):
                ran.append((history, record))
        for line, result in found.items():
            told: list[tuple[Outcome, str]] = [
                ("unknown", history.silent(round_)) for history in mission.histories if round_ < history.since
            ]
            for history, record in ran:
                broken = line in record.get("violated", ())
                told.append(("violated" if broken else "held", ""))
                if broken and result.first is None:
                    read = (f"in {record.get('event') or 'init'}: {to_koord(invariants[line].formula)}",)
                    result.first = AuditViolation(
                        ObservationTime(round_, False), AFTER, (history.name,), (), read, "", ()
                    )
            result.close(round_, told, of_each=True)
    return list(found.values())


def _miss(results: list[PropertyResult], mission: FleetMission) -> None:
    """Add the rounds before the first recorded round to the unknown rounds of each result, once for each robot."""
    if mission.first:
        for result in results:
            result.miss(mission.first, len(mission.histories))


def _record(history: RobotHistory, round_: int) -> Mapping[str, Any]:
    return history.rounds[round_].record if round_ in history.rounds else {}


def late(mission: FleetMission) -> int:
    """Return the number of events that were discarded because they finished after the publish deadline."""
    faults = [line.record.get("fault") for history in mission.histories for line in history.rounds.values()]
    return sum(fault is not None and fault["reason"] == OVERRAN for fault in faults)


def _line(record: Mapping[str, Any], contracts: Mapping[int, PropertyResult]) -> int:
    """Return the line of the broken contract that the record of a round names.

    Returns 0 if an event was discarded because of another fault of the program. Returns -1 if no event was discarded,
    or if an event was discarded because it was too late."""
    fault = record.get("fault")
    if fault is None or fault["reason"] == OVERRAN:
        return -1
    told = _CONTRACT.search(fault["reason"])
    return int(told[1]) if told and int(told[1]) in contracts else 0


def _violation(history: RobotHistory, round_: int, record: Mapping[str, Any]) -> AuditViolation:
    fault = record["fault"]
    why = Fault(fault.get("file", ""), fault.get("line", 0), fault["reason"])
    read = (f"{record.get('event') or 'a guard'} was discarded, {why}",)
    return AuditViolation(ObservationTime(round_, False), AFTER, (history.name,), (), read, "", ())
