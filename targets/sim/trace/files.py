"""Files of a run: growing traces of agents, poses, and the merged trace, read and written.

The records are defined in `koordgen/runtime/trace/schema.py`. In an agent's file `time` is the run's clock: that of the
host in real time, simulated time from 0 in lockstep."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple

import msgspec

from koordgen.runtime.trace.schema import (
    HEADER,
    LEFT_OUT,
    NO_HEADER,
    OF_EVENTS,
    BadTrace,
    Header,
    InitRecord,
    Mark,
    MemberPose,
    PoseRecord,
    RobotHeader,
    Round,
    TraceRecord,
    Upgrade,
    Verdict,
    Violation,
    decoded,
    decoded_header,
    encoded,
    format_of,
)
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.fleets import SQUAD
from targets.sim.trace.hosted import replaced_from
from targets.sim.trace.store_names import StoreNames

LATE = 0.5  # share of delta: a round decided later than this is late
MOST_AT_ONCE = 1 << 20  # bytes of one file per call


class _TimeField(msgspec.Struct):
    """Time field of a record of any kind in a robot's own trace."""

    time: float | None = None


_time = msgspec.json.Decoder(_TimeField)
_raw = msgspec.json.Decoder(dict[str, msgspec.Raw])


def was_late(record: Round, delta: float) -> bool:
    """Return whether a round was decided late.

    A round that waits for peers until the deadline does not count."""
    waited = (record.skipped or "").startswith(("not current", "not confirmed"))
    return record.late > LATE * delta and not waited


class Tail:
    """Incremental reader of a file that an agent is writing. Malformed lines are counted and skipped."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._incomplete = b""
        self.malformed = 0

    def read(self) -> list[TraceRecord]:
        """Return the records written since the last call."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._offset)
                data = file.read(MOST_AT_ONCE)
        except FileNotFoundError:
            return []
        self._offset += len(data)
        *lines, self._incomplete = (self._incomplete + data).split(b"\n")
        found, malformed = records_in(lines)
        self.malformed += malformed
        return found


def records_in(lines: Sequence[bytes]) -> tuple[list[TraceRecord], int]:
    """Return the records in complete lines of a robot's own trace, and the number of malformed lines."""
    found: list[TraceRecord] = []
    malformed = 0
    for line in lines:
        try:
            # An agent's own header differs from that of the merged trace.
            if not line.startswith(HEADER) and (record := decoded(line)) is not None:
                found.append(record)
        except msgspec.DecodeError:
            malformed += 1
    return found, malformed


class Poses:
    """Writer of poses to a file of their own during the run, with times of the run's clock."""

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] = path.open("wb")

    def write(
        self, time: float, states: Sequence[BodyState], members: Sequence[tuple[int, str, BodyState]] = ()
    ) -> None:
        """Write the poses of all robots by pid, and of the members of squads: pid of the squad, name, state."""
        for pid, state in enumerate(states):
            record = PoseRecord(pid, _rounded(state), round(state.yaw, 5), time, LEFT_OUT)
            self._file.write(encoded(record) + b"\n")
        for pid, name, state in members:
            member = MemberPose(pid, name, _rounded(state), round(state.yaw, 5), time, LEFT_OUT)
            self._file.write(encoded(member) + b"\n")

    def close(self) -> None:
        self._file.close()


def _rounded(state: BodyState) -> Vector:
    x, y, z = (round(c, 5) for c in state.position)
    return x, y, z


def merge(path: Path, header: Header, zero: float, poses: Path, agents: list[Path], marks: list[Mark]) -> None:
    """Write the merged trace: all records ordered by time.

    `zero` is the time of t = 0. `agents` are the agents' files in the order of pids. Raises OSError."""
    streams = [
        _mark_records(marks, header.app),
        _pose_records(poses, zero),
        *(_agent_records(file, zero, pid, header.robots[pid].target == SQUAD) for pid, file in enumerate(agents)),
    ]
    with path.open("wb") as out:
        out.write(encoded(header) + b"\n")
        for _, line in heapq.merge(*streams, key=lambda pair: pair[0]):
            out.write(line + b"\n")


def at(line: bytes, t: float, pid: int) -> bytes:
    """Convert a record of a robot's own trace to the merged form; a negative pid leaves the record's own.

    Raises msgspec.DecodeError."""
    record = _raw.decode(line)
    own = {"kind": record.pop("kind"), "t": t, **({} if pid < 0 else {"pid": pid})}
    record.pop("time", None)
    return encoded({**own, **record})


def time_of(line: bytes) -> float | None:
    """Return the time of a record on its robot's clock (s); None for a header and for an invalid line."""
    if not line.endswith(b"\n") or line.startswith(HEADER):
        return None
    with suppress(ValueError, RecursionError):
        decoded(line)
        _raw.decode(line)
        return _time.decode(line).time
    return None


def _mark_records(marks: list[Mark], application: str) -> Iterator[tuple[float, bytes]]:
    for mark in sorted(marks, key=lambda m: m.t):
        if isinstance(mark, Verdict) or (isinstance(mark, Violation) and mark.what in OF_EVENTS):
            mark = msgspec.structs.replace(mark, application=mark.application or application)
        yield mark.t, encoded(mark)


def _pose_records(path: Path, zero: float) -> Iterator[tuple[float, bytes]]:
    """Yield the run's own poses, which are in order. An invalid line raises."""
    if path.exists():
        with path.open("rb") as file:
            for line in file:
                if line.endswith(b"\n"):
                    t = round((_time.decode(line).time or 0.0) - zero, 6)
                    yield t, at(line, t, -1)


def _agent_records(path: Path, zero: float, pid: int, hosted: bool) -> Iterator[tuple[float, bytes]]:
    """Yield an agent's records by time, in the order of the file for equal times.

    hosted: the agent is that of a squad, and each part of the file is from one host.
    The agent writes a round when it is committed, after later records of other kinds; how much later depends on its
    peers. So the file is read twice: for the times, then in order."""
    if not path.exists():
        return
    with path.open("rb") as file:
        places = list(_places(file))
        if hosted:
            places = _without_replaced_rounds(file, places)
        for time, offset, _ in sorted(places):
            file.seek(offset)
            t = round(time - zero, 6)
            yield t, at(file.readline(), t, pid)


class _Place(NamedTuple):
    """Place of a record in a trace: time on the run's clock (s), offset in bytes, number of headers before it."""

    time: float
    offset: int
    part: int


def _places(file: IO[bytes]) -> Iterator[_Place]:
    """Yield the places of a file's valid records."""
    offset = part = 0
    for line in file:
        part += line.startswith(HEADER)
        time = time_of(line)
        if time is not None:
            yield _Place(time, offset, part)
        offset += len(line)


def _without_replaced_rounds(file: IO[bytes], places: Sequence[_Place]) -> list[_Place]:
    """Return the places without the rounds of former hosts that a later host has recorded; see `replaced_from`."""
    rounds: dict[_Place, int] = {}
    for place in places:
        file.seek(place.offset)
        record = decoded(file.readline())
        if isinstance(record, InitRecord | Round):
            rounds[place] = record.round if isinstance(record, Round) else 0
    parts: dict[int, list[int]] = {}
    for place, round_ in rounds.items():
        parts.setdefault(place.part, []).append(round_)
    ends = replaced_from([(min(each), max(each)) for each in parts.values()])
    until = dict(zip(parts, ends, strict=True))
    return [place for place in places if place not in rounds or rounds[place] < until[place.part]]


def read(path: Path) -> tuple[Header, Iterator[TraceRecord]]:
    """Return a merged trace's header, and its other records in order, without unknown kinds.

    Records of several applications have the names of the store; see StoreNames. Raises BadTrace, also during
    iteration."""
    found = lines(path)
    _, _, header = next(found)
    if not isinstance(header, Header):
        raise BadTrace(f"{path}: the header is that of a robot's own trace, not of a run's")
    names = StoreNames(header)
    kept = (record for _, _, record in found if record is not None and not isinstance(record, RobotHeader))
    return header, (names.of(record) for record in kept)


def lines(path: Path) -> Iterator[tuple[int, bytes, TraceRecord | RobotHeader | None]]:
    """Yield each line of a trace in the present format, with its number and record.

    None for an unknown kind.

    The first record is a header. Raises BadTrace."""
    upgrade, number, line = Upgrade(), 0, b""
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                line = upgrade.line(line)
                record = decoded_header(line) if format_of(line) else decoded(line)
                if number == 1 and not isinstance(record, Header | RobotHeader):
                    raise BadTrace(f"{path}: {NO_HEADER}")
                yield number, line, record
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        cut = "" if line.endswith(b"\n") else "; the file is cut off there"
        raise BadTrace(f"{path}:{number}: {error}{cut}") from None
    if not number:
        raise BadTrace(f"{path}: {NO_HEADER}; the file is empty")


def upgrade(path: Path, made: Path) -> str:
    """Write a trace in the present format to `made`. Return its old format. Raises BadTrace, OSError."""
    with path.open("rb") as file:
        first = file.readline()
    with made.open("wb") as out:
        for _, line, _ in lines(path):
            out.write(line)
    return format_of(first)
