"""Merged trace of a real fleet.

Joins the robots' own traces, each on its own clock, into the trace of one run.

Rounds are the fleet's time: round r begins at t = (r - 1) * delta on every robot. So each record of a round gives the
offset of the robot's clock to the fleet's; records between two rounds use the offset of the round before. There is no
ground truth: poses are those that the robots measured."""

from __future__ import annotations

import heapq
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from koordgen.runtime.trace.schema import (
    LEFT_OUT,
    End,
    Header,
    InitRecord,
    PoseRecord,
    Round,
    Values,
    Vector,
    decoded,
    encoded,
    upgraded,
)
from targets.sim.trace.files import at, time_of

_place_and_yaw = msgspec.json.Decoder(tuple[Vector, float])
_position = msgspec.json.Decoder(Vector)
_AGAIN = (b'{"kind":"phase"', b'{"kind":"view"')  # kinds of records that each part of a trace repeats


class _Place(NamedTuple):
    """Position of a record: time on the robot's clock (s), number of its file, offset in bytes."""

    time: float
    file: int
    offset: int


class _Clock:
    """Clock of one start of an agent: the time of t = 0 on it, as each of its rounds gives it."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._zeros: list[float] = []

    def __bool__(self) -> bool:
        return bool(self._times)

    def round(self, record: Round, delta: float) -> None:
        """Add a round. Rounds come in order of time, except for some that use the offset of their neighbours."""
        if not self._times or record.time > self._times[-1]:
            self._times.append(record.time)
            self._zeros.append(record.time - record.late - (record.round - 1) * delta)

    def t(self, time: float) -> float:
        """Return fleet time since the start of round 1, in seconds."""
        return round(time - self._zeros[max(0, bisect_right(self._times, time) - 1)], 6)


def merge(path: Path, header: Mapping[str, Any], traces: Sequence[Sequence[Path]], end: float) -> None:
    """Write the merged trace.

    `header`: plain values. `traces`: each robot's files in the order of pids, oldest first, all of one mission. `end`:
    the mission's end (s since round 1). Invalid lines are left out. Raises OSError."""
    head = msgspec.convert(header, Header)
    streams = [_records(files, pid, head.delta, head.app) for pid, files in enumerate(traces)]
    with path.open("wb") as out:
        out.write(encoded(head) + b"\n")
        ended = iter([(end, encoded(End(end, "collected")))])
        for _, line in heapq.merge(*streams, ended, key=lambda pair: pair[0]):
            out.write(line + b"\n")


def _records(files: Sequence[Path], pid: int, delta: float, application: str) -> Iterator[tuple[float, bytes]]:
    """Yield one robot's records by fleet time, in the robot's order for equal times.

    Before each round comes the pose that the robot measured at its start, once for all its applications."""
    last = -math.inf
    places, clocks = _index_records(files, delta)
    ordered = sorted((clocks[place.file].t(place.time), place) for place in places if clocks[place.file])
    opened = [path.open("rb") for path in files]
    try:
        for t, place in ordered:
            opened[place.file].seek(place.offset)
            line = upgraded(opened[place.file].readline(), application)
            record = decoded(line)
            if isinstance(record, InitRecord | Round) and t > last and (pose := _pose(record.sensors)) is not None:
                last = t
                yield t, encoded(PoseRecord(pid, *pose, LEFT_OUT, t))
            yield t, at(line, t, pid)
    finally:
        for file in opened:
            file.close()


def _index_records(files: Sequence[Path], delta: float) -> tuple[list[_Place], list[_Clock]]:
    """Return the place of each record and each file's clock.

    A part without rounds uses the clock of the part before."""
    places: list[_Place] = []
    clocks: list[_Clock] = []
    seen: set[bytes] = set()
    for number, path in enumerate(files):
        clock, after = _Clock(), 0
        with path.open("rb") as file:
            for line in file:
                offset, after = after, after + len(line)
                time = time_of(line)
                if time is None or (line.startswith(_AGAIN) and line in seen):
                    continue
                if line.startswith(_AGAIN):
                    seen.add(line)
                record = decoded(line)
                if isinstance(record, InitRecord) and places and places[-1].file == number:
                    time = max(time, places[-1].time)  # its time is that of its sensors, before the phases before it
                places.append(_Place(time, number, offset))
                if isinstance(record, Round):
                    clock.round(record, delta)
        clocks.append(clock or (clocks[-1] if clocks else clock))
    return places, clocks


def _pose(sensors: Values) -> tuple[Vector, float] | None:
    """Return position (m, local ENU) and yaw (rad) from a motion module's `pose` or `position`."""
    with suppress(msgspec.ValidationError):  # null for a value that was not finite
        for port, value in sensors.items():
            if port.endswith(".pose"):
                return _place_and_yaw.decode(value)
        for port, value in sensors.items():
            if port.endswith(".position"):
                return _position.decode(value), 0.0
    return None
