"""Comparison of the monitors on robots with the audit of the whole fleet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from koordgen.verify.audit.history import FOREVER, FleetMission, RobotHistory
from koordgen.verify.audit.result import PropertyResult

SLACK = 2  # number of rounds by which a monitor may report a violation late
_BAD = ("violated", "no value")


def compare_monitors(results: Sequence[PropertyResult], mission: FleetMission) -> list[str]:
    """Return notes about contradictions between the monitors on robots and the audit.

    A contradiction is a violation that a monitor reported but the audit does not find, or a violation that the audit
    finds but no monitor reported.
    """
    notes: list[str] = []
    for result in results:
        said = {history.pid: _reports(result, history) for history in mission.histories}
        records = {pid: spans for pid, spans in said.items() if spans}
        if result.spans and records:
            notes += [
                note for pid, spans in records.items() for note in _false_alarms(result, mission.histories[pid], spans)
            ][:3]
            notes += _missed_violation(result, records, mission)
    return notes


def _reports(result: PropertyResult, history: RobotHistory) -> list[tuple[int, int, Mapping[str, Any]]]:
    """Return the reports about a property by the monitor of a robot, in the order of rounds.

    Each report is a triple: the round of the report, the round of the robot's next report, and the record."""
    mine = [r for r in history.monitors if _of(r) == result.of and _line(r) == result.line]
    mine.sort(key=lambda r: int(r["round"]))
    ends = [*[int(r["round"]) for r in mine[1:]], FOREVER]
    return [(int(r["round"]), end, r) for r, end in zip(mine, ends, strict=False)]


def _of(record: Mapping[str, Any]) -> str:
    of = str(record.get("of", ""))
    return "contract" if of in ("requires", "ensures") else of


def _line(record: Mapping[str, Any]) -> int:
    text = str(record.get("line", "")).rpartition(":")[2]
    return int(text) if text.isdecimal() and len(text) < 10 else -1


def _false_alarms(
    result: PropertyResult, history: RobotHistory, spans: list[tuple[int, int, Mapping[str, Any]]]
) -> Iterator[str]:
    """Yield a note for each violation that a monitor reported while the property held in the whole fleet."""
    for since, until, record in spans:
        if record.get("outcome") not in _BAD:
            continue
        first = max(0, since - 1 - int(record.get("age", 0)))
        last = min(until, result.spans[-1].until)
        if all(result.at(round_) == "held" for round_ in range(first, max(first, last) + 1)):
            yield (
                f"{history.name} reported in round {since} that {result.title} (line {result.line}) is "
                f"{record['outcome']}, by values of {record.get('age', 0)} rounds before; over the whole fleet, the "
                "property held"
            )


def _missed_violation(
    result: PropertyResult, records: Mapping[int, list[tuple[int, int, Mapping[str, Any]]]], mission: FleetMission
) -> Iterator[str]:
    """Yield a note about a violation that the audit finds but no monitor reported."""
    bad = next((span for span in result.spans if span.outcome in _BAD), None)
    if bad is None:
        return
    window = range(bad.since - 1, bad.until + SLACK + 1)
    here = [
        (pid, record)
        for pid, spans in records.items()
        for since, until, record in spans
        if since <= window[-1] and until > window[0]
    ]
    if any(record.get("outcome") in _BAD for _, record in here):
        return
    rounds = f"rounds {bad.since} to {bad.until}"
    for pid, record in here:
        if record.get("outcome") == "held":
            yield (
                f"{mission.histories[pid].name} reported that {result.title} (line {result.line}) held in {rounds}; "
                "over the whole fleet, the property was violated"
            )
            return
    yield f"no monitor reported that {result.title} (line {result.line}) was violated in {rounds}"
