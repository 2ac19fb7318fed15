"""Merged trace of a fleet that flew: what each robot wrote by itself, on its own clock, as the trace of one run.

Rounds are the fleet's time: round r begins at t = (r - 1) * delta on every robot. So each of a robot's records of a
round says how its clock stands to the fleet's, and records between two rounds are placed by the round before them.
Nobody saw the truth: poses are those that the robots measured.
"""

from __future__ import annotations

import heapq
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
    Init,
    Pose,
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
_AGAIN = (b'{"kind":"phase"', b'{"kind":"view"')  # a later part of a trace repeats these


class _Place(NamedTuple):
    """A record's time on the robot's clock (s), and where it is: file by number, offset in bytes."""

    time: float
    file: int
    offset: int


class _Clock:
    """One start of a robot's agent: the time of t = 0 on its clock, as each of its rounds says it."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._zeros: list[float] = []

    def __bool__(self) -> bool:
        return bool(self._times)

    def round(self, record: Round, delta: float) -> None:
        """Note a round; records come in ascending order of time, but for some that are placed by their neighbours."""
        if not self._times or record.time > self._times[-1]:
            self._times.append(record.time)
            self._zeros.append(record.time - record.late - (record.round - 1) * delta)

    def t(self, time: float) -> float:
        """Return fleet time since the start of round 1, in seconds."""
        return round(time - self._zeros[max(0, bisect_right(self._times, time) - 1)], 6)


def merge(path: Path, header: Mapping[str, Any], traces: Sequence[Sequence[Path]], end: float) -> None:
    """Write the merged trace: `header` as plain values, `traces` are each robot's files in the order of pids, oldest
    first, all of one mission; `end` is the mission's end (s since round 1). Lines that are no records are left out.
    Raises OSError."""
    head = msgspec.convert(header, Header)
    streams = [_records(files, pid, head.delta, head.app) for pid, files in enumerate(traces)]
    with path.open("wb") as out:
        out.write(encoded(head) + b"\n")
        ended = iter([(end, encoded(End(end, "collected")))])
        for _, line in heapq.merge(*streams, ended, key=lambda pair: pair[0]):
            out.write(line + b"\n")


def _records(files: Sequence[Path], pid: int, delta: float, application: str) -> Iterator[tuple[float, bytes]]:
    """One robot's records by fleet time, those of one time as the robot wrote them; before each round the pose that
    the robot measured at its start."""
    places, clocks = _looked_through(files, delta)
    ordered = sorted((clocks[place.file].t(place.time), place) for place in places if clocks[place.file])
    opened = [path.open("rb") for path in files]
    try:
        for t, place in ordered:
            opened[place.file].seek(place.offset)
            line = upgraded(opened[place.file].readline(), application)
            record = decoded(line)
            if isinstance(record, Init | Round) and (pose := _pose(record.sensors)) is not None:
                yield t, encoded(Pose(pid, *pose, LEFT_OUT, t))
            yield t, at(line, t, pid)
    finally:
        for file in opened:
            file.close()


def _looked_through(files: Sequence[Path], delta: float) -> tuple[list[_Place], list[_Clock]]:
    """Return where each record is, and each file's clock; a part without rounds has the clock of the part before."""
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
                places.append(_Place(time, number, offset))
                record = decoded(line)
                if isinstance(record, Round):
                    clock.round(record, delta)
        clocks.append(clock or (clocks[-1] if clocks else clock))
    return places, clocks


def _pose(sensors: Values) -> tuple[Vector, float] | None:
    """Return position (m, local ENU) and yaw (rad) by the sensors of a motion module: `pose`, else `position`."""
    with suppress(msgspec.ValidationError):  # null where it was not finite
        for port, value in sensors.items():
            if port.endswith(".pose"):
                return _place_and_yaw.decode(value)
        for port, value in sensors.items():
            if port.endswith(".position"):
                return _position.decode(value), 0.0
    return None
