"""Rows of a trace for the pages: one format for the report and for the live view.

The report embeds the rows, the live view streams them. `page/model.js` reads them. Numbers are rounded to what is
visible.

| table | rows |
|---|---|
| poses | pid, t, x, y, z, yaw |
| members | pid of a squad, t, name of one of its robots, x, y, z, yaw |
| rounds | pid, first t, last t, number of equal rounds, outcome (0 event, 1 skipped, 2 fault), event or reason |
| phases | pid, t, phase, detail |
| logs | pid, t, level, text |
| shared | name, writer's pid, t, round, value as JSON |
| locals | pid, t, round, name, value as JSON |
| paths | pid, t, points |
| scans | pid, t, position of the lidar, hits of its rays: cm east and north of there, alternating |
| late | pid, t of a second, longest lateness in it (s), rounds, late rounds |
| links | pid, t, [[peer, loss, delay p50, p99 (ms), silent (ms), repeats]], datagrams rejected |
| near | t, distance of the closest pair (m), their pids; of a robot of a squad its name |
| marks | t, kind, what, robots' names, detail; for a cause with a duration also that (s) |
| obstacles | t, number, the obstacle at its new position |
| markers | t, number, state (0 to do, 1 taken, 2 done); in the first row of a listed marker: name, position, radius |
"""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET

from koordgen.runtime.trace.schema import (
    Cause,
    End,
    Header,
    InitRecord,
    LogLine,
    MemberPose,
    MetricsRecord,
    Monitor,
    Moved,
    Phase,
    PoseRecord,
    Round,
    StreamLine,
    TraceRecord,
    Verdict,
    Violation,
)
from koordgen.runtime.values.points import Point, Scan
from targets.sim.base.bodies import Vector
from targets.sim.base.fleets import SQUAD
from targets.sim.trace.files import was_late
from targets.sim.trace.monitor_reports import DisplayFilter, status_text
from targets.sim.view.data.markers import Markers

EVENT, SKIPPED, FAULT = 0, 1, 2
Chunk = dict[str, list[list[Any]]]
SCAN_EVERY = 1.0  # seconds between two displayed scans of one robot
_decoder = msgspec.json.Decoder()
_scan_decoder = msgspec.json.Decoder(list[tuple[Point, Scan]])


class Rows:
    """Converter of records to rows; `taken` returns the rows since the last call."""

    def __init__(self, header: Header) -> None:
        self._count = len(header.robots)
        self._names = [robot.name for robot in sorted(header.robots, key=lambda robot: robot.pid)]
        self._notable = DisplayFilter()
        self._delta = header.delta
        self._chunk: Chunk = {}
        self._second: dict[int, list[Any]] = {}
        self._squads = {robot.pid for robot in header.robots if robot.target == SQUAD}
        self._near: _Nearest | _NearestOfAll = _NearestOfAll() if self._squads else _Nearest(self._count)
        self._paths: dict[int, bytes] = {}
        self._scanned: dict[int, float] = {}  # time of each robot's last row of `scans`
        self._markers = Markers(header)
        self._slots = {v.name for v in header.shared if v.kind == "allread"}
        self._begun: set[str] = set()  # variables whose first value is known
        self._composed = header.composition is not UNSET

    def taken(self) -> Chunk:
        """Return the rows since the last call, by table."""
        if self._markers.rows:
            self._chunk["markers"], self._markers.rows = self._markers.rows, []
        chunk, self._chunk = self._chunk, {}
        return chunk

    def add(self, record: TraceRecord, t: float) -> None:
        """Convert one record; `t` overrides its own time."""
        t = round(t, 3)
        match record:
            case Violation(what=what, robots=robots):
                detail = " ".join(filter(None, (record.name, record.line, record.detail, record.host)))
                self._add("marks", [t, "violation", what, list(robots), detail])
            case End(why=why):
                self._add("marks", [t, "end", why, [], ""])
            case Cause(what=what, robots=robots, detail=detail, lasts=lasts):
                self._add("marks", [t, "cause", what, list(robots), detail, *(() if lasts is None else (lasts,))])
            case Moved(number=number, obstacle=obstacle):
                self._add("obstacles", [t, number, msgspec.to_builtins(obstacle)])
            case Verdict():
                what = f"{f'{record.of} {record.name}'.strip()}: {record.outcome}"
                detail = ", ".join(filter(None, (record.line, record.detail)))
                self._add("marks", [t, "verdict", what, list(record.robots), detail])
            case Monitor() if 0 <= record.pid < self._count and self._notable.add(record):
                detail = ": ".join(filter(None, (record.line, record.why)))
                self._add("marks", [t, "monitor", status_text(record), [self._names[record.pid]], detail])
            case MemberPose(pid=pid, member=member, position=position) if 0 <= pid < self._count:
                self._add("members", [pid, t, member, *(_small(c) for c in position), round(record.yaw, 3)])
                if (near := self._near.add(f"{self._names[pid]}.{member}", t, position)) is not None:
                    self._add("near", near)
            case PoseRecord() | Phase() | InitRecord() | Round() | LogLine() | StreamLine() | MetricsRecord() if (
                0 <= record.pid < self._count
            ):
                self._of_robot(record, t)
            case _:
                pass

    def _of_robot(
        self, record: PoseRecord | Phase | InitRecord | Round | LogLine | StreamLine | MetricsRecord, t: float
    ) -> None:
        pid = record.pid
        match record:
            case PoseRecord(position=position, yaw=yaw):
                self._add("poses", [pid, t, *(_small(c) for c in position), round(yaw, 3)])
                self._markers.pose(position, t)
                if pid not in self._squads and (near := self._near.add(pid, t, position)) is not None:
                    self._add("near", near)
            case Phase(phase=phase, detail=detail):
                self._add("phases", [pid, t, phase, detail])
            case LogLine(level=level, message=message):
                self._add("logs", [pid, t, level, message])
            case StreamLine(port=port, text=text):
                self._add("logs", [pid, t, port, text])
            case MetricsRecord():
                self._add("links", [pid, t, _links(record), sum(record.rejected.values())])
            case InitRecord():
                self._writes(record, 0, t)
            case Round():
                self._first_values(record, t)
                self._round(record, t)
                self._scan(record, t)

    def _add(self, table: str, row: list[Any]) -> None:
        self._chunk.setdefault(table, []).append(row)

    def _round(self, record: Round, t: float) -> None:
        if record.fault is not None:
            outcome, what = FAULT, str(record.fault)
        elif record.skipped is not None:
            outcome, what = SKIPPED, record.skipped
        else:
            outcome, what = EVENT, record.event or ""
        row, before = [record.pid, t, t, 1, outcome, what], self._same_round(record.pid, t)
        if before is None:
            self._add("rounds", row)
        else:
            before[4:] = _together(before, row)
        if record.restored is not None:
            for name, raw in record.restored.locals.items():
                self._add("locals", [record.pid, t, record.restored.round, name, _decoder.decode(raw)])
        self._writes(record, record.round, t)
        if before is None:
            self._lateness(record, t)

    def _same_round(self, pid: int, t: float) -> list[Any] | None:
        """Return the row of another application of the robot for the same round, or None."""
        rows = self._chunk.get("rounds") if self._composed else None
        return rows[-1] if rows and rows[-1][0] == pid and rows[-1][1] == t else None

    def _first_values(self, record: Round, t: float) -> None:
        """Add rows for values that nobody has written yet, from the first recorded copy of the store."""
        for name, raw in record.copy.items():
            if name in self._begun:
                continue
            self._begun.add(name)
            value = _decoder.decode(raw)
            if name in self._slots and isinstance(value, dict):
                for pid, each in value.items():
                    if pid.isdigit():
                        self._add("shared", [name, int(pid), t, 0, each])
            else:
                self._add("shared", [name, record.pid, t, 0, value])
                self._markers.value(name, value, t)

    def _writes(self, record: InitRecord | Round, number: int, t: float) -> None:
        """Add rows for written locals and shared variables, and for the commanded path or target."""
        for name, raw in record.locals.items():
            self._add("locals", [record.pid, t, number, name, _decoder.decode(raw)])
        for name, raw in record.shared.items():
            value = _decoder.decode(raw)
            self._add("shared", [name, record.pid, t, number, value])
            self._markers.value(name, value, t)
        for port, raw in record.actuators.items():
            if not port.endswith((".target", ".path")) or bytes(raw) == self._paths.get(record.pid):
                continue
            self._paths[record.pid] = bytes(raw)
            value = _decoder.decode(raw)
            points = [value] if port.endswith(".target") else value
            if isinstance(points, list) and all(map(_is_point, points)):
                self._add("paths", [record.pid, t, [[_small(c) for c in point] for point in points]])

    def _scan(self, record: Round, t: float) -> None:
        """Add a row for the round's newest lidar scan, at most one per SCAN_EVERY seconds."""
        if t < self._scanned.get(record.pid, -math.inf) + SCAN_EVERY:
            return
        for port, raw in record.sensors.items():
            if not port.endswith(".pscan"):
                continue
            with suppress(msgspec.DecodeError):
                if scans := _scan_decoder.decode(raw):
                    place, scan = scans[-1]
                    hits: list[int] = []
                    for angle, reach in zip(scan.angles, scan.ranges, strict=False):
                        if reach < scan.max_range:
                            hits += round(100 * reach * math.cos(angle)), round(100 * reach * math.sin(angle))
                    self._add("scans", [record.pid, t, [_small(c) for c in (place.x, place.y, place.z)], hits])
                    self._scanned[record.pid] = t

    def _lateness(self, record: Round, t: float) -> None:
        second = math.floor(t)
        row = self._second.get(record.pid)
        if row is None or row[1] != second:
            if row is not None:
                self._add("late", row)
            row = self._second[record.pid] = [record.pid, second, 0.0, 0, 0]
        row[2] = max(row[2], round(record.late, 4))
        row[3] += 1
        row[4] += was_late(record, self._delta)

    def end(self) -> None:
        """Add the rows that were still collected at the trace's end."""
        for row in self._second.values():
            self._add("late", row)
        self._second.clear()


class _Nearest:
    """Distance of the closest pair at each time at which all robots' poses are known."""

    def __init__(self, count: int) -> None:
        self._places = np.full((count, 3), np.nan)
        self._left, self._right = np.triu_indices(count, 1)
        self._last = count - 1

    def add(self, pid: Any, t: float, position: Vector) -> list[Any] | None:
        self._places[pid] = position
        if pid != self._last or pid == 0:
            return None
        apart = np.linalg.norm(self._places[self._left] - self._places[self._right], axis=1)
        k = int(np.argmin(apart))  # argmin returns a NaN first: a robot has no pose yet
        if math.isnan(apart[k]):
            return None
        return [t, _small(float(apart[k])), int(self._left[k]), int(self._right[k])]


class _NearestOfAll:
    """Distance of the closest pair at each time, of any robots: those of squads, by their names, and others by pid."""

    def __init__(self) -> None:
        self._t = -math.inf
        self._places: dict[int | str, Vector] = {}

    def add(self, who: int | str, t: float, position: Vector) -> list[Any] | None:
        """Add a pose. Return the row of the time before, if the pose is the first one of a time."""
        row = None
        if t != self._t:
            row, self._t, self._places = self._row(), t, {}
        self._places[who] = position
        return row

    def _row(self) -> list[Any] | None:
        if len(self._places) < 2:
            return None
        distance, one, other = min(
            (math.dist(a, b), i, j) for (i, a), (j, b) in itertools.combinations(self._places.items(), 2)
        )
        return [self._t, _small(distance), one, other]


def _together(a: list[Any], b: list[Any]) -> list[Any]:
    """Return outcome and text of a round in which two applications of a robot have these rows of `rounds`.

    A fault counts more than an event, and an event more than a skip."""
    if a[4] == b[4]:
        return [a[4], a[5] if b[5] in a[5].split(", ") else f"{a[5]}, {b[5]}"]
    return (a if (a[4] == FAULT or b[4] == SKIPPED) else b)[4:]


def _small(metres: float) -> float:
    return round(metres, 3) + 0.0  # no -0.0


def _is_point(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(type(c) in (int, float) for c in value)


def _links(record: MetricsRecord) -> list[list[Any]]:
    rows = []
    for peer, found in record.peers.items():
        delay = found.get("delay_ms") or {}
        if peer.isdigit() and isinstance(delay, dict):
            figures = (
                found.get("loss"),
                delay.get("p50"),
                delay.get("p99"),
                found.get("silent_ms"),
                found.get("repeats"),
            )
            rows.append([int(peer), *figures])
    return rows
