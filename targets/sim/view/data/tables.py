"""Export of a trace as CSV for spreadsheets and pandas.

A file for each kind of record, with `COLUMNS`. With several applications, `rounds` has a row for each application of a
robot, with its name in a further column `application`.

t is in seconds since the start of round 1, positions in metres (local ENU), yaw in radians; values of the program are
JSON. A file without records has only the column names."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import (
    Cause,
    End,
    Header,
    InitRecord,
    LogLine,
    MetricsRecord,
    Monitor,
    Phase,
    PoseRecord,
    Round,
    StreamLine,
    TraceRecord,
    Verdict,
    Violation,
)
from targets.sim.trace.beliefs import Beliefs

COLUMNS: dict[str, tuple[str, ...]] = {
    "poses": ("t", "robot", "x", "y", "z", "yaw"),
    "rounds": ("t", "robot", "round", "event", "skipped", "fault", "late"),
    "values": ("t", "robot", "round", "of", "name", "value"),
    "beliefs": ("t", "robot", "round", "of", "name", "slot", "value"),
    "phases": ("t", "robot", "phase", "detail"),
    "logs": ("t", "robot", "level", "text"),
    "links": ("t", "robot", "peer", "loss", "delay_p50_ms", "delay_p99_ms", "silent_ms", "repeats"),
    "monitors": ("t", "robot", "round", "of", "name", "line", "outcome", "age", "why", "action"),
    "marks": ("t", "kind", "what", "robots", "name", "line", "detail"),
}
Row = tuple[Any, ...]


def write(folder: Path, header: Header, records: Iterable[TraceRecord]) -> None:
    """Write all tables into `folder`, reading the records once. Raises BadTrace, OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {robot.pid: robot.name for robot in header.robots}
    composed = not isinstance(header.composition, msgspec.UnsetType)
    with ExitStack() as stack:
        tables = {}
        for table, columns in COLUMNS.items():
            file = stack.enter_context((folder / f"{table}.csv").open("w", newline="", encoding="utf-8"))
            tables[table] = csv.writer(file)
            tables[table].writerow((*columns, "application") if composed and table == "rounds" else columns)
        beliefs = Beliefs(header)
        for record in records:
            for table, row in (*_rows(record, names), *_believed(record, beliefs, names)):
                more = (getattr(record, "application", ""),) if composed and table == "rounds" else ()
                tables[table].writerow((*row, *more))


def _believed(record: TraceRecord, beliefs: Beliefs, names: dict[int, str]) -> Iterator[tuple[str, Row]]:
    """Yield rows for new values that a robot knows: its locals, and shared variables in its own copy."""
    for change in beliefs.apply(record):
        if change.of in ("local", "shared") and isinstance(record, (InitRecord, Round)):
            robot, slot = names[record.pid], "" if change.slot is None else names.get(change.slot, str(change.slot))
            value = msgspec.json.encode(change.value).decode()
            yield "beliefs", (record.t, robot, getattr(record, "round", 0), change.of, change.name, slot, value)


def _rows(record: TraceRecord, names: dict[int, str]) -> Iterator[tuple[str, Row]]:
    t = record.t if not isinstance(record, Header) else 0.0
    match record:
        case Violation(what=what, robots=robots, detail=detail, name=name, line=line):
            yield "marks", (t, "violation", what, " ".join(robots), name, line, detail)
        case Verdict(of=of, name=name, line=line, outcome=outcome, robots=robots, detail=detail):
            yield "marks", (t, f"verdict on {of}", outcome, " ".join(robots), name, line, detail)
        case Cause(what=what, robots=robots, detail=detail, lasts=lasts):
            for_so_long = "" if lasts is None else f"for {lasts:g} s"
            told = " ".join(filter(None, (detail, for_so_long)))
            yield "marks", (t, "cause", what, " ".join(robots), "", "", told)
        case End(why=why):
            yield "marks", (t, "end", why, "", "", "", "")
        case PoseRecord() | InitRecord() | Round() | Phase() | LogLine() | StreamLine() | Monitor() | MetricsRecord():
            yield from _of_robot(record, t, names.get(record.pid, f"robot {record.pid}"))
        case _:
            pass


def _of_robot(
    record: PoseRecord | InitRecord | Round | Phase | LogLine | StreamLine | Monitor | MetricsRecord,
    t: float,
    robot: str,
) -> Iterator[tuple[str, Row]]:
    match record:
        case PoseRecord(position=(x, y, z), yaw=yaw):
            yield "poses", (t, robot, x, y, z, yaw)
        case Phase(phase=phase, detail=detail):
            yield "phases", (t, robot, phase, detail)
        case LogLine(level=level, message=message):
            yield "logs", (t, robot, level, message)
        case StreamLine(port=port, text=text):
            yield "logs", (t, robot, port, text)
        case Monitor(of=of, name=name, line=line, outcome=outcome, age=age, why=why, action=action):
            yield "monitors", (t, robot, record.round, of, name, line, outcome, age, why, action)
        case MetricsRecord(peers=peers):
            for peer, found in peers.items():
                delay = found.get("delay_ms") or {}
                figures = (found.get("loss"), delay.get("p50"), delay.get("p99"), found.get("silent_ms"))
                yield "links", (t, robot, peer, *figures, found.get("repeats"))
        case InitRecord():
            yield from _values(record, t, robot, 0)
        case Round(round=number, event=event, skipped=skipped, fault=fault, late=late):
            told = "" if fault is None else str(fault)
            yield "rounds", (t, robot, number, event or "", skipped or "", told, late)
            yield from _values(record, t, robot, number)


def _values(record: InitRecord | Round, t: float, robot: str, number: int) -> Iterator[tuple[str, Row]]:
    groups = {"sensor": record.sensors, "local": record.locals, "shared": record.shared, "actuator": record.actuators}
    for of, values in groups.items():
        for name, raw in values.items():
            yield "values", (t, robot, number, of, name, bytes(raw).decode())
