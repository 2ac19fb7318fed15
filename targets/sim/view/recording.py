"""A trace as MCAP with JSON messages, which Foxglove opens: poses, transforms, a scene, logs, maps, and the program's
rounds, shared variables, verdicts and metrics.

A message's time counts from the trace's first moment, because MCAP knows none below 0; the file's metadata record
`koord` says when round 1 begins, and koord.* messages have `t` since then. The same trace gives the same bytes.
"""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec
from mcap.writer import Writer

from targets.sim.trace import (
    Cause,
    Header,
    Log,
    Metrics,
    Phase,
    Pose,
    Record,
    Round,
    Stream,
    Verdict,
    Violation,
    fault_text,
)
from targets.sim.view import scene
from targets.sim.view.rows import Rows
from targets.sim.view.schemas import schema

LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
UINT8 = 1
Message = tuple[str, str, dict[str, Any]]  # topic, schema, what


def write(path: Path, header: Header, records: Iterable[Record]) -> None:
    """Write the file, reading the records once. Raises BadTrace, OSError."""
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("", "koordgen")
        out = _Channels(writer)
        messages = _Messages(header)
        begun = False
        for record in records:
            if isinstance(record, Header):
                continue
            if not begun:
                begun = True
                out.zero = math.floor(min(0.0, record.t))
                facts = {"app": header.app, "program_hash": header.program_hash, "seed": str(header.seed)}
                writer.add_metadata("koord", {**facts, "delta": str(header.delta), "round_1_at": str(-out.zero)})
                out.put(record.t, messages.standing(out.nanoseconds(record.t)))
            out.put(record.t, messages.of(record, out.nanoseconds(record.t)))
        writer.finish()


class _Channels:
    """Writes messages, each topic a channel, each schema once. `zero` is the t of time 0 in the file."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._encoder = msgspec.json.Encoder()
        self.zero = 0

    def nanoseconds(self, t: float) -> int:
        return max(0, round((t - self.zero) * 1e9))

    def put(self, t: float, messages: Iterable[Message]) -> None:
        at = self.nanoseconds(t)
        for topic, kind, what in messages:
            if kind not in self._schemas:
                data = self._encoder.encode(schema(kind))
                self._schemas[kind] = self._writer.register_schema(kind, "jsonschema", data)
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[kind])
            self._counts[topic] = self._counts.get(topic, 0) + 1
            data = self._encoder.encode(what)
            self._writer.add_message(self._channels[topic], at, data, at, self._counts[topic])


class _Messages:
    """What is said of each record. What must be worked out of several comes as rows, as for the pages."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._names = [robot.name for robot in header.robots]
        self._maps = {v.name for v in header.shared if v.type == "GridMap"}
        self._rows = Rows(header)
        self._markers: list[tuple[Any, float]] = [(m.position, m.radius) for m in header.world.markers]

    def standing(self, at: int) -> Iterator[Message]:
        markers = [scene.marker(at, k, place, radius, 0) for k, (place, radius) in enumerate(self._markers)]
        yield "/scene", "foxglove.SceneUpdate", _scene(scene.standing(self._header, at) + markers)

    def of(self, record: Record, at: int) -> Iterator[Message]:
        pid = getattr(record, "pid", -1)
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
            case Pose(position=position, yaw=yaw) if name:
                yield from _pose(at, name, position, yaw)
            case Phase(phase=phase, detail=detail) if name:
                yield "/phases", "koord.Phase", {"t": record.t, "robot": name, "phase": phase, "detail": detail}
            case Log(level=level, message=message) if name:
                yield "/log", "foxglove.Log", _log(at, LEVELS.get(level, 0), message, name)
            case Stream(port=port, text=text) if name:
                yield "/log", "foxglove.Log", _log(at, 2, f"{port}: {text}", name)
            case Round() if name:
                yield f"/rounds/{name}", "koord.Round", _round(record, name)
            case Metrics(late_ms=late, rejected=rejected, peers=peers) if name:
                told = {"t": record.t, "robot": name, "late_ms": late, "rejected": rejected, "peers": peers}
                yield f"/metrics/{name}", "koord.Metrics", told
        self._rows.take(record, record.t)
        yield from self._worked_out(at)

    def _worked_out(self, at: int) -> Iterator[Message]:
        rows = self._rows.taken()
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
        for t, distance, a, b in rows.get("near", ()):
            told = {"t": t, "distance": distance, "robots": [self._names[a], self._names[b]]}
            yield "/separation", "koord.Separation", told


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
    fault = None if record.fault is None else fault_text(record.fault)
    told = {"t": record.t, "robot": name, "round": record.round, "event": record.event, "skipped": record.skipped}
    return told | {"fault": fault, "late": record.late}


def _grid(at: int, value: Any) -> dict[str, Any] | None:
    """A GridMap: a byte a cell, 0 unknown, 1 free, 3 occupied; None for what is none, or has no cells."""
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
