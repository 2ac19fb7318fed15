"""Messages of a run for Foxglove, with the schemas of schemas.py.

They go into files (recording.py) and streams (stream.py). Both have the same topics, so one layout fits both.

| topic | schema |
|---|---|
| /scene | foxglove.SceneUpdate: obstacles, arena, geofence, robots, their paths, markers |
| /tf, /poses/ROBOT | foxglove.FrameTransform, foxglove.PoseInFrame |
| /log | foxglove.Log |
| /maps/VARIABLE | foxglove.Grid |
| /rounds/ROBOT, /shared/VARIABLE, /phases, /metrics/ROBOT, /verdicts, /causes, /separation | koord.* |

Times of messages are nanoseconds since a time that the caller chooses. In koord.* messages `t` is in seconds since
round 1.
"""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import (
    Cause,
    Header,
    LogLine,
    MetricsRecord,
    Moved,
    OfRobot,
    Phase,
    PoseRecord,
    Round,
    StreamLine,
    TraceRecord,
    Verdict,
    Violation,
)
from koordgen.runtime.values.obstacles import Obstacle
from targets.sim.view.data.rows import EVENT, FAULT, SKIPPED, Chunk, Rows
from targets.sim.view.foxglove import scene

LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
UINT8 = 1
Message = tuple[str, str, dict[str, Any]]  # topic, schema, content


class Messages:
    """Converter of records (`of`) or rows (`of_rows`) to messages.

    Messages that depend on several records are built from rows, as for the pages."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._names = [robot.name for robot in header.robots]
        self._maps = {v.name for v in header.shared if v.type == "GridMap"}
        self._rows = Rows(header)
        self._markers: list[tuple[Any, float]] = [(m.position, m.radius) for m in header.world.markers]

    def standing(self, at: int) -> Iterator[Message]:
        markers = [scene.marker(at, k, place, radius, 0) for k, (place, radius) in enumerate(self._markers)]
        yield "/scene", "foxglove.SceneUpdate", _scene(scene.standing(self._header, at) + markers)

    def of(self, record: TraceRecord, at: int) -> Iterator[Message]:
        pid = record.pid if isinstance(record, OfRobot) else -1
        name = self._names[pid] if 0 <= pid < len(self._names) else ""
        match record:
            case Header():
                return
            case Violation(what=what, robots=robots, name=own, line=line, detail=detail):
                yield "/verdicts", "koord.Verdict", _verdict(record.t, "violation", what, robots, own, line, detail)
                yield "/log", "foxglove.Log", _log(at, 4, f"{what}: {detail}", " and ".join(robots))
            case Cause(what=what, robots=robots, detail=detail):
                yield "/causes", "koord.Verdict", _verdict(record.t, "cause", what, robots, "", "", detail)
                yield "/log", "foxglove.Log", _log(at, 3, f"cause: {what} {detail}", " and ".join(robots))
            case Verdict(of=of, outcome=outcome, robots=robots, name=own, line=line, detail=detail):
                yield "/verdicts", "koord.Verdict", _verdict(record.t, of, outcome, robots, own, line, detail)
            case PoseRecord(position=position, yaw=yaw) if name:
                yield from _pose(at, name, position, yaw)
            case Phase(phase=phase, detail=detail) if name:
                yield "/phases", "koord.Phase", {"t": record.t, "robot": name, "phase": phase, "detail": detail}
            case LogLine(level=level, message=message) if name:
                yield "/log", "foxglove.Log", _log(at, LEVELS.get(level, 0), message, name)
            case StreamLine(port=port, text=text) if name:
                yield "/log", "foxglove.Log", _log(at, 2, f"{port}: {text}", name)
            case Round() if name:
                yield f"/rounds/{name}", "koord.Round", _round(record, name)
            case MetricsRecord(late_ms=late, rejected=rejected, peers=peers) if name:
                told = {"t": record.t, "robot": name, "late_ms": late, "rejected": rejected, "peers": peers}
                yield f"/metrics/{name}", "koord.Metrics", told
            case Moved(number=number, obstacle=obstacle):
                yield "/scene", "foxglove.SceneUpdate", _scene([scene.obstacle(obstacle, at, number)])
        self._rows.add(record, record.t)
        yield from self._worked_out(self._rows.taken(), at)

    def of_rows(self, rows: Chunk, nanoseconds: Callable[[float], int]) -> Iterator[tuple[int, Message]]:
        """Yield the messages of rows (rows.py) with their times; `nanoseconds` converts t.

        A row of rounds becomes one message, for its last round."""
        for pid, t, x, y, z, yaw in rows.get("poses", ()):
            yield from _at(nanoseconds(t), _pose(nanoseconds(t), self._names[pid], (x, y, z), yaw))
        for pid, t, phase, detail in rows.get("phases", ()):
            told = {"t": t, "robot": self._names[pid], "phase": phase, "detail": detail}
            yield nanoseconds(t), ("/phases", "koord.Phase", told)
        for pid, t, level, text in rows.get("logs", ()):
            message = text if level in LEVELS else f"{level}: {text}"
            said = _log(nanoseconds(t), LEVELS.get(level, 2), message, self._names[pid])
            yield nanoseconds(t), ("/log", "foxglove.Log", said)
        for row in rows.get("rounds", ()):
            yield nanoseconds(row[2]), self._round_of_row(*row)
        for t, kind, what, robots, detail, *_ in rows.get("marks", ()):
            topic = "/causes" if kind == "cause" else "/verdicts"
            told = _verdict(t, kind, what, tuple(robots), "", "", detail)
            yield nanoseconds(t), (topic, "koord.Verdict", told)
            level, name = LEVELS["error" if kind == "violation" else "warning"], " and ".join(robots)
            yield nanoseconds(t), ("/log", "foxglove.Log", _log(nanoseconds(t), level, f"{what}: {detail}", name))
        for t, number, obstacle in rows.get("obstacles", ()):
            at, moved = nanoseconds(t), msgspec.convert(obstacle, Obstacle)
            yield at, ("/scene", "foxglove.SceneUpdate", _scene([scene.obstacle(moved, at, number)]))
        for table, column in (("shared", 2), ("paths", 1), ("markers", 0), ("near", 0)):
            for row in rows.get(table, ()):
                at = nanoseconds(row[column])
                yield from _at(at, self._worked_out({table: [row]}, at))

    def _round_of_row(self, pid: int, first: float, last: float, many: int, outcome: int, what: str) -> Message:
        number = math.floor(last / self._header.delta + 0.25) + 1  # an event is decided within half a round
        told = {"t": last, "robot": self._names[pid], "round": max(0, number)}
        for key, code in (("event", EVENT), ("skipped", SKIPPED), ("fault", FAULT)):
            told[key] = what if outcome == code else None
        late = max(0.0, round(last - (number - 1) * self._header.delta, 3))
        return f"/rounds/{self._names[pid]}", "koord.Round", {**told, "late": late}

    def _worked_out(self, rows: Chunk, at: int) -> Iterator[Message]:
        for variable, pid, t, number, value in rows.get("shared", ()):
            name = self._names[pid] if 0 <= pid < len(self._names) else ""
            told = {"t": t, "robot": name, "round": number, "name": variable, "value": value}
            yield f"/shared/{variable}", "koord.Shared", told
            if variable in self._maps and (grid := _grid(at, value)) is not None:
                yield f"/maps/{variable}", "foxglove.Grid", grid
        changed = [scene.path(at, self._names[pid], pid, points) for pid, _, points in rows.get("paths", ())]
        for _, number, state, *more in rows.get("markers", ()):
            if more and number == len(self._markers):
                self._markers.append((more[0]["position"], more[0]["radius"]))
            changed.append(scene.marker(at, number, *self._markers[number], state))
        if changed:
            yield "/scene", "foxglove.SceneUpdate", _scene(changed)
        for t, distance, *pair in rows.get("near", ()):
            named = [who if isinstance(who, str) else self._names[who] for who in pair]
            told = {"t": t, "distance": distance, "robots": named}
            yield "/separation", "koord.Separation", told


def _at(at: int, messages: Iterator[Message]) -> Iterator[tuple[int, Message]]:
    return ((at, message) for message in messages)


def _scene(entities: list[scene.Entity]) -> dict[str, Any]:
    return {"deletions": [], "entities": entities}


def _pose(at: int, name: str, position: tuple[float, float, float], yaw: float) -> Iterator[Message]:
    there, stamp = scene.pose(position, yaw), scene.stamp(at)
    yield f"/poses/{name}", "foxglove.PoseInFrame", {"timestamp": stamp, "frame_id": scene.FRAME, "pose": there}
    told = {"timestamp": stamp, "parent_frame_id": scene.FRAME, "child_frame_id": name}
    turned = {"translation": there["position"], "rotation": there["orientation"]}
    yield "/tf", "foxglove.FrameTransform", told | turned


def _log(at: int, level: int, message: str, name: str) -> dict[str, Any]:
    return {"timestamp": scene.stamp(at), "level": level, "message": message, "name": name, "file": "", "line": 0}


def _verdict(
    t: float, kind: str, what: str, robots: tuple[str, ...], name: str, line: str, detail: str
) -> dict[str, Any]:
    told = {"t": t, "kind": kind, "what": what, "robots": list(robots)}
    return told | {"name": name, "line": line, "detail": detail}


def _round(record: Round, name: str) -> dict[str, Any]:
    fault = None if record.fault is None else str(record.fault)
    told = {"t": record.t, "robot": name, "round": record.round, "event": record.event, "skipped": record.skipped}
    return told | {"fault": fault, "late": record.late}


def _grid(at: int, value: Any) -> dict[str, Any] | None:
    """Convert a GridMap.

    One byte per cell, 0 unknown, 1 free, 3 occupied; None for an invalid or empty one."""
    try:
        size, x, y, width, height, packed = value
        raw = b64decode(packed)
        cells = bytes((raw[k >> 2] >> (2 * (k & 3))) & 3 for k in range(width * height))
        corner = (x * size, y * size, 0.0)
    except (TypeError, ValueError, IndexError):
        return None
    if not cells:
        return None
    return {
        "timestamp": scene.stamp(at), "frame_id": scene.FRAME, "pose": scene.pose(corner), "column_count": width,
        "cell_size": {"x": size, "y": size}, "row_stride": width, "cell_stride": 1,
        "fields": [{"name": "known", "offset": 0, "type": UINT8}], "data": b64encode(cells).decode(),
    }  # fmt: skip
