"""The run's trace, format koord-trace/1: its records, following the agents' own files, and the one merged file.

In an agent's file `time` is the run's clock (in real time the host's, in lockstep from 0); in the merged one records
have `t`, seconds since the start of round 1 (negative before), agents' ones a `pid`. Points: [x, y, z], m, local ENU.
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Literal

import msgspec

from koordgen.runtime.program.program import Fault
from koordgen.runtime.values.obstacles import Obstacle
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.scenario import Shared, World

FORMAT = "koord-trace/1"
LATE = 0.5  # of delta: a round decided later than this is late
MOST_AT_ONCE = 1 << 20  # bytes of one file in one look


class RobotName(msgspec.Struct, frozen=True):
    name: str
    pid: int
    target: str


class Header(msgspec.Struct, frozen=True, tag_field="kind", tag="header"):
    """The merged file's first record. `started`: whether there was a round 1; without one, t counts from the launch.
    `geofence` are the two corners; `world`, `shared`, `records` as in the scenario; `followed`: a counterexample."""

    format: str
    app: str
    program_hash: str
    delta: float
    seed: int
    robots: tuple[RobotName, ...]
    duration: float = 0.0  # asked for, seconds
    started: bool = True
    min_separation: float = 0.0  # asked for, metres
    geofence: tuple[Vector, Vector] | None = None
    obstacles: tuple[Obstacle, ...] = ()
    world: World = World()
    shared: tuple[Shared, ...] = ()
    records: dict[str, tuple[tuple[str, str], ...]] = {}
    followed: str = ""  # chose the events: a "run", or a "step", which says also how all began


class Pose(msgspec.Struct, frozen=True, tag_field="kind", tag="pose"):
    """The truth about a robot, `pose_rate` times a second; yaw in radians."""

    pid: int
    position: Vector
    yaw: float
    time: float = 0.0
    t: float = 0.0


class Phase(msgspec.Struct, frozen=True, tag_field="kind", tag="phase"):
    phase: str
    detail: str = ""
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


Values = dict[str, msgspec.Raw]  # by name, as JSON: their types are the program's


class Init(msgspec.Struct, frozen=True, tag_field="kind", tag="init"):
    """An agent's `init`: what it saw and wrote of the shared store, all own variables after it."""

    sensors: Values = {}
    locals: Values = {}
    shared: Values = {}
    actuators: Values = {}
    violated: tuple[int, ...] = ()  # as of Round
    stopped: bool = False
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Restored(msgspec.Struct, frozen=True):
    """What a robot that came back went on with: its own variables after its event of `round`."""

    round: int
    locals: Values = {}
    actuators: Values = {}
    stopped: bool = False


class Round(msgspec.Struct, frozen=True, tag_field="kind", tag="round"):
    """An agent's round; of its fields those that are looked at here. `late` is seconds after the tick. Of locals, the
    shared store and actuators it has what the event wrote; `copy` is what had changed before in the robot's copy of the
    shared store, of an allread variable by pid; `calls` of callable ports: port, arguments, answer; `violated` are the
    lines of the loop invariants that were false in its event."""

    round: int
    event: str | None = None
    skipped: str | None = None
    fault: Any = None
    late: float = 0.0
    sensors: Values = {}
    locals: Values = {}
    shared: Values = {}
    actuators: Values = {}
    copy: Values = {}
    calls: tuple[tuple[str, tuple[msgspec.Raw, ...], msgspec.Raw], ...] = ()
    violated: tuple[int, ...] = ()
    stopped: bool = False
    restored: Restored | None = None
    time: float = 0.0
    t: float = 0.0
    pid: int = -1

    def was_late(self, delta: float) -> bool:
        """Whether it was decided later than it should be: one that waits for others is, at the deadline."""
        waited = (self.skipped or "").startswith(("not current", "not confirmed"))
        return self.late > LATE * delta and not waited


class Log(msgspec.Struct, frozen=True, tag_field="kind", tag="log"):
    level: str = "info"
    message: str = ""
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Stall(msgspec.Struct, frozen=True, tag_field="kind", tag="stall"):
    """A robot has had no way to what was commanded for `lasted` seconds, or has one again; `why` says what is wanted
    and what is in the way (koordgen/runtime/vehicle/stall.py). A `log` record has the same in words."""

    state: Literal["begins", "goes on", "ends"]
    why: str
    lasted: float
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Stream(msgspec.Struct, frozen=True, tag_field="kind", tag="stream"):
    """A line that the program put out; round 0 is `init`."""

    port: str
    text: str
    round: int = 0
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Monitor(msgspec.Struct, frozen=True, tag_field="kind", tag="monitor"):
    """A property has come to another outcome, as far as this robot can tell (runtime/trace/watched.py, Change)."""

    of: str
    name: str
    line: str
    outcome: str
    age: int = 0
    why: str = ""
    action: str = "log"
    round: int = 0
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Metrics(msgspec.Struct, frozen=True, tag_field="kind", tag="metrics"):
    """How well a robot hears its peers and keeps its rounds, as its runtime's metrics say; `peers` by pid."""

    late_ms: dict[str, float] = {}
    rejected: dict[str, int] = {}
    peers: dict[str, dict[str, Any]] = {}
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class View(msgspec.Struct, frozen=True, tag_field="kind", tag="view"):
    """An agent has heard who counts from round `since` on: each robot's incarnation, -1 of one that does not."""

    number: int
    since: int
    members: tuple[int, ...]
    time: float = 0.0
    t: float = 0.0
    pid: int = -1


class Violation(msgspec.Struct, frozen=True, tag_field="kind", tag="violation"):
    """What must not happen and did: `what` is separation, collision, ended, fault, unrest, property or idle. Of a
    property `name` and `line` ("app.koord:12") say which. `host` says how the host caused it, if it did."""

    t: float
    what: str
    robots: tuple[str, ...]
    detail: str
    name: str = ""
    line: str = ""
    host: str = ""


Found = Literal["held", "violated", "no value", "unchecked", "out of model"]


class Verdict(msgspec.Struct, frozen=True, tag_field="kind", tag="verdict"):
    """What a run has shown of one property, told at the mission's end: `of` is invariant, initially, assume, axiom or
    loop invariant; of loop invariants only those that were false are told. `since` is when it was first violated, had
    no value, or was about a robot that was out of the model. `moments`: at how many it was evaluated."""

    t: float
    of: str
    name: str
    line: str
    outcome: Found
    since: float | None = None
    robots: tuple[str, ...] = ()
    detail: str = ""
    moments: int = 0


class Cause(msgspec.Struct, frozen=True, tag_field="kind", tag="cause"):
    """A fault that was brought about on purpose: `what` is network, link, or a kind of event of the scenario file;
    `lasts` seconds (None: for good, or no time at all)."""

    t: float
    what: str
    robots: tuple[str, ...]
    detail: str = ""
    lasts: float | None = None


class Moved(msgspec.Struct, frozen=True, tag_field="kind", tag="moved"):
    """An obstacle was moved, as a fault: its number in the header, and itself at its new place."""

    t: float
    number: int
    obstacle: Obstacle


class End(msgspec.Struct, frozen=True, tag_field="kind", tag="end"):
    """The mission's end: the agents were told to come to rest."""

    t: float
    why: str


class _Kind(msgspec.Struct):
    kind: str
    time: float | None = None


Mark = Violation | Verdict | Cause | Moved | End
Record = Header | Pose | Phase | Init | Round | View | Log | Stall | Stream | Monitor | Metrics | Mark
_KINDS = {kind.__struct_config__.tag for kind in Record.__args__}
_decoder = msgspec.json.Decoder(Record)
_kind_decoder = msgspec.json.Decoder(_Kind)
_encoder = msgspec.json.Encoder()


class BadTrace(Exception):
    """A trace that cannot be used; the message names the file."""


def decoded(line: bytes) -> Record | None:
    """A line of a trace; None when its kind is not known here. Raises msgspec.DecodeError."""
    try:
        record: Record = _decoder.decode(line)
    except msgspec.ValidationError:
        if _kind_decoder.decode(line).kind in _KINDS:
            raise
        return None
    return record


def fault_text(fault: Any) -> str:
    """A round's fault in words."""
    if isinstance(fault, dict):
        return str(Fault(fault.get("file", "?"), fault.get("line", 0), fault.get("reason", "?")))
    return str(fault)


class Tail:
    """Follows a file that an agent is writing; what is no record is counted and passed over."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._rest = b""
        self.malformed = 0

    def read(self) -> list[Record]:
        """The records written since the last time."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._offset)
                data = file.read(MOST_AT_ONCE)
        except FileNotFoundError:
            return []
        self._offset += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        found: list[Record] = []
        for line in lines:
            try:
                # An agent's header says other things than the merged file's.
                if b'"kind":"header"' not in line[:40] and (record := decoded(line)) is not None:
                    found.append(record)
            except msgspec.DecodeError:
                self.malformed += 1
        return found


class Poses:
    """Writes poses to a file of their own while the run goes on, with host times."""

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] = path.open("wb")

    def write(self, time: float, states: list[BodyState]) -> None:
        for pid, state in enumerate(states):
            place = tuple(round(c, 5) for c in state.position)
            record = {"kind": "pose", "time": time, "pid": pid, "position": place, "yaw": round(state.yaw, 5)}
            self._file.write(_encoder.encode(record) + b"\n")

    def close(self) -> None:
        self._file.close()


def merge(path: Path, header: Header, zero: float, poses: Path, agents: list[Path], marks: list[Mark]) -> None:
    """Write the merged trace: all records by time, `zero` the host time of t = 0; the agents' files in the order of
    their pids. Raises OSError."""
    streams = [
        _marked(marks),
        _posed(poses, zero),
        *(_told(file, zero, pid) for pid, file in enumerate(agents)),
    ]
    with path.open("wb") as out:
        out.write(_encoder.encode(header) + b"\n")
        for _, line in heapq.merge(*streams, key=lambda pair: pair[0]):
            out.write(line + b"\n")


def _marked(marks: list[Mark]) -> Iterator[tuple[float, bytes]]:
    for mark in sorted(marks, key=lambda m: m.t):
        yield mark.t, _encoder.encode(mark)


def _posed(path: Path, zero: float) -> Iterator[tuple[float, bytes]]:
    """Written by the run itself, so in order; whatever is broken raises."""
    if path.exists():
        with path.open("rb") as file:
            for line in file:
                if line.endswith(b"\n"):
                    yield _shifted(line, zero, {})


def _told(path: Path, zero: float, pid: int) -> Iterator[tuple[float, bytes]]:
    """An agent's records by time, those of one time as it wrote them. It writes a round when that is certain, behind
    later records of other kinds; how far behind depends on its peers. So the file is looked through first."""
    if not path.exists():
        return
    places: list[tuple[float, int]] = []
    with path.open("rb") as file:
        after = 0
        for line in file:
            place, after = after, after + len(line)
            if line.endswith(b"\n") and b'"kind":"header"' not in line[:40]:
                with suppress(msgspec.DecodeError):
                    decoded(line)
                    time = _kind_decoder.decode(line).time
                    places.append((zero if time is None else time, place))
        for _, place in sorted(places):
            file.seek(place)
            yield _shifted(file.readline(), zero, {"pid": pid})


def _shifted(line: bytes, zero: float, own: dict[str, int]) -> tuple[float, bytes]:
    record = json.loads(line)
    t = round(record.pop("time", zero) - zero, 6)
    return t, _encoder.encode({"kind": record.pop("kind"), "t": t, **own, **record})


def read(path: Path) -> tuple[Header, Iterator[Record]]:
    """A merged trace: its header, and everything else in order, but for kinds that are not known here. Raises BadTrace,
    also while being read."""
    records = _records(path)
    header = next(records, None) if _headed(path) else None
    if not isinstance(header, Header) or header.format != FORMAT:
        raise BadTrace(f"{path}: no header of a run's trace, of format {FORMAT}")
    return header, records


def _headed(path: Path) -> bool:
    """Whether the first line is the header of a merged trace: an agent's own has no seed. Raises BadTrace."""
    try:
        with path.open("rb") as file:
            first = json.loads(file.readline())
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
    except ValueError:
        return False
    return isinstance(first, dict) and first.get("format") == FORMAT and "seed" in first


def _records(path: Path) -> Iterator[Record]:
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    record = decoded(line)
                except msgspec.DecodeError as error:
                    cut = "" if line.endswith(b"\n") else "; the file is cut off there"
                    raise BadTrace(f"{path}:{number}: {error}{cut}") from None
                if record is not None:
                    yield record
    except OSError as error:
        raise BadTrace(f"{path}: {error.strerror or error}") from None
