"""Schema of a trace, format koord-trace/2: every record, every key with its meaning and its unit.

A trace is a file of JSON objects, one a line; the first one is its header, and `kind` names the type of each. There are
two forms. A robot's own trace begins with a RobotHeader and has `time` in its records; in lockstep and in a flight that
is the robot's local monotonic clock in seconds. The merged trace of a run begins with a Header and has `t` instead,
seconds since the start of round 1 (negative before), and `pid`, the number of the robot. Points are [x, y, z] in
metres, local ENU: x east, y north, z up. Yaw is in radians, counter-clockwise from east. Values of the program are JSON
by the program's types; numbers that are not finite are null.

The comment behind each field says what the key means, and in brackets its unit; docs/reference/trace.md has the same as
tables (`python -m tools.trace_tables`).

Agents write these types, simulators merge them, and all readers check what they read against them. Format koord-trace/1
lacks `applications` and `application`: `upgraded` adds both, so each reader has the present format only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypedDict

import msgspec
from msgspec import UNSET, Meta, UnsetType

from koordgen.runtime.values.obstacles import Obstacle

FORMAT = "koord-trace/2"
OLD_FORMAT = "koord-trace/1"
FAMILY = "koord-trace/"
NO_HEADER = f"no header of format {FORMAT} or {OLD_FORMAT}"
HEADER = b'{"kind":"header"'  # beginning of a header as agents write it
MOST_ROBOTS = 1000
MOST_ROUND = 100_000_000
OF_EVENTS = ("property", "fault")  # violations that stem from an application's events

# A writer gives this for a key that it leaves out, because it is of the other form or there is nothing to say.
LEFT_OUT: Any = UNSET

Vector = tuple[float, float, float]
Values = Mapping[str, msgspec.Raw]  # by name, as JSON: the program declares the types
RoundNumber = Annotated[int, Meta(ge=0, le=MOST_ROUND)]  # 0: `init`
LastRound = Annotated[int, Meta(ge=-1, le=MOST_ROUND)]  # -1: none yet, not even `init`
Incarnation = Annotated[int, Meta(ge=-1, le=MOST_ROUND)]  # starts of an agent before this one; -1: none counts


class BadTrace(Exception):
    """A file that is no trace, or is broken inside; the message names the file and the line."""


class RobotName(msgspec.Struct, frozen=True):
    """One robot of a run."""

    name: str  # as in the fleet file
    pid: int  # from 0, without gaps
    target: str  # platform, such as quad


class Shared(msgspec.Struct, frozen=True):
    """A shared variable of the program."""

    name: str  # as in the program
    kind: str  # allread: one value for each robot; allwrite: one value
    type: str  # in Koord


class Box(msgspec.Struct, frozen=True):
    """An axis-parallel box."""

    lo: Vector  # lower corner [m]
    hi: Vector  # upper corner [m]


class Wind(msgspec.Struct, frozen=True):
    """Wind of a simulated world."""

    mean: Vector = (0.0, 0.0, 0.0)  # mean velocity, ENU [m/s]
    gust: float = 0.0  # standard deviation of the gusts in each direction [m/s]
    correlation: float = 1.0  # time in which gusts change [s]


class Marker(msgspec.Struct, frozen=True):
    """A place of interest, reached within `radius`."""

    name: str  # for people
    position: Vector  # of its middle [m]
    radius: float = 0.3  # within which it counts as reached [m]


class MarkerList(msgspec.Struct, frozen=True):
    """A shared list whose elements at the mission's start are markers."""

    variable: str  # name of the list
    position: str = ""  # field of an element that holds its place; "": elements are Points
    radius: float = 0.3  # within which an element counts as reached [m]


class World(msgspec.Struct, frozen=True):
    """Conditions of the world, as the fleet file gives them."""

    arena: Box | None = None  # room in which the fleet moves
    floor_friction: float = 1.0  # multiplies the friction that bodies have on a usual floor
    wind: Wind = Wind()  # of the air
    markers: tuple[Marker, ...] = ()  # that stay where they are
    marker_list: MarkerList | None = None  # of markers that are in a shared list


class RobotHeader(msgspec.Struct, frozen=True, tag_field="kind", tag="header"):
    """First record of each part of a robot's own trace."""

    format: str  # version of the trace: koord-trace/2
    app: str  # name of the program
    applications: tuple[str, ...]  # names of the applications that records name; one today, `app`
    robot: str  # name of the robot
    pid: int  # of the robot, from 0
    n_sys: int  # number of robots in the fleet
    delta: float  # length of a round [s]
    program_hash: str  # 16 hexadecimal digits
    part: int | UnsetType = UNSET  # number of a later part of the trace, from 1
    followed: str | UnsetType = UNSET  # as in the header of a merged trace


class Header(msgspec.Struct, frozen=True, tag_field="kind", tag="header"):
    """First record of a merged trace: the run, its fleet, its world and its shared variables."""

    format: str  # version of the trace: koord-trace/2
    app: str  # name of the program
    program_hash: str  # 16 hexadecimal digits; "": a counterexample of a program without numbers that robots have
    delta: float  # length of a round [s]
    seed: int  # of the simulator's random numbers
    robots: tuple[RobotName, ...]  # by pid
    duration: float = 0.0  # of the mission as asked for [s]
    started: bool = True  # there was a round 1; if not, t counts from the launch
    min_separation: float = 0.0  # smallest distance of two robots as asked for; 0: none [m]
    geofence: tuple[Vector, Vector] | None = None  # lower and upper corner [m]
    obstacles: tuple[Obstacle, ...] = ()  # as in a robot's settings; records name them by number, from 0
    world: World = World()  # conditions of the world
    shared: tuple[Shared, ...] = ()  # shared variables of the program
    records: dict[str, tuple[tuple[str, str], ...]] = {}  # record types of the program: fields and their types
    followed: str = ""  # the run executed a counterexample, a "run" or a "step"; "": none
    applications: tuple[str, ...] = ()  # names of the applications that records name; one today, `app`
    counterexample: Literal["run", "step"] | UnsetType = UNSET  # no run of robots: from an initial state, from any
    params: Mapping[str, Any] | UnsetType = UNSET  # of a counterexample: values of the program's params
    given: tuple[str, ...] | UnsetType = UNSET  # of a counterexample: params whose values the user gave


class Pose(msgspec.Struct, frozen=True, tag_field="kind", tag="pose"):
    """True place of a robot in a simulation, `pose_rate` times a second.

    In a flight the measured one, once a round."""

    pid: int  # of the robot
    position: Vector  # place [m]
    yaw: float  # heading [rad]
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]


class Phase(msgspec.Struct, frozen=True, tag_field="kind", tag="phase"):
    """A robot's agent is in a phase, or its progress in the phase has changed."""

    phase: str  # starting, joining, running, resting, rested
    detail: str = ""  # cause or progress, for people
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot


class Init(msgspec.Struct, frozen=True, tag_field="kind", tag="init"):
    """A robot has run `init`."""

    sensors: Values = {}  # as sampled before
    locals: Values = {}  # all of them, afterwards
    shared: Values = {}  # those that were written
    actuators: Values = {}  # all that have a value, afterwards
    violated: tuple[int, ...] = ()  # lines of the loop invariants that were false
    stopped: bool = False  # the program has stopped
    calls: tuple[tuple[str, tuple[msgspec.Raw, ...], msgspec.Raw], ...] = ()  # as in `round`
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot
    application: str = ""  # whose `init`


class Restored(msgspec.Struct, frozen=True):
    """A robot's own variables after its event of a round."""

    round: LastRound  # after which the values were these; 0: after `init`
    locals: Values = {}  # all of them
    actuators: Values = {}  # all that have a value
    stopped: bool = False  # the program has stopped


class EventFault(msgspec.Struct, frozen=True):
    """Cause for which an event's writes were discarded."""

    file: str  # of the program
    line: int  # in that file; 0: not known
    reason: str  # for people

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        return f"{place}: {self.reason}" if place else self.reason


class Round(msgspec.Struct, frozen=True, tag_field="kind", tag="round"):
    """One round of a robot, written when the round is certain to count."""

    round: RoundNumber  # from 1; 0 only in a counterexample
    event: str | None = None  # that ran or was discarded; null: none was
    skipped: str | None = None  # reason for which no event ran
    fault: EventFault | None = None  # of the event, whose writes do not count then
    late: float = 0.0  # from the start of the round to its decision [s]
    sensors: Values = {}  # as sampled at the start of the round
    locals: Values = {}  # that the event wrote
    shared: Values = {}  # that the event wrote; of an allread variable the robot's own value
    actuators: Values = {}  # that the event wrote
    copy: Values = {}  # changes of the robot's copy of the shared variables before the event; allread: by pid
    calls: tuple[tuple[str, tuple[msgspec.Raw, ...], msgspec.Raw], ...] = ()  # callable ports: name, arguments, answer
    violated: tuple[int, ...] = ()  # lines of the loop invariants that were false in the event
    stopped: bool = False  # the program has stopped
    restored: Restored | None = None  # state with which a robot that rejoined went on
    clock_bound: float = 0.0  # largest error of the robot's fleet time [s]
    counters: Mapping[str, int] = {}  # counters of the runtime that have changed since the round before
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot
    application: str = ""  # whose event
    step: str | UnsetType = UNSET  # of a counterexample: the step after which the values are those of this record


class Checkpoint(msgspec.Struct, frozen=True, tag_field="kind", tag="checkpoint"):
    """State at the beginning of a later part of a robot's trace."""

    round: LastRound  # that earlier parts record last; 0: `init`, -1: none
    own: Restored | None = None  # own variables after that round; null: not known
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot
    application: str = ""  # whose variables


class View(msgspec.Struct, frozen=True, tag_field="kind", tag="view"):
    """Another membership view counts."""

    number: RoundNumber  # of the view, from 0
    since: Annotated[int, Meta(ge=-MOST_ROUND, le=MOST_ROUND)]  # first round of the view
    members: tuple[Incarnation, ...]  # by pid: earlier starts of the robot's agent; -1: it does not count
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot


class Log(msgspec.Struct, frozen=True, tag_field="kind", tag="log"):
    """A log line of the agent."""

    level: str = "info"  # info, warning, error
    message: str = ""  # for people
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot


class Stall(msgspec.Struct, frozen=True, tag_field="kind", tag="stall"):
    """A robot has no path to its target, or has one again. A `log` record has the same in words."""

    state: Literal["begins", "goes on", "ends"]  # of the stall
    why: str  # the target, and the obstacle
    lasted: float  # length so far [s]
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot


class Stream(msgspec.Struct, frozen=True, tag_field="kind", tag="stream"):
    """A line of text that the program sent to a stream."""

    port: str  # name of the stream
    text: str  # one line
    round: RoundNumber = 0  # whose event sent it
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot
    application: str = ""  # whose text


class Monitor(msgspec.Struct, frozen=True, tag_field="kind", tag="monitor"):
    """A property has another outcome than before, by one robot's knowledge."""

    of: str  # invariant, assume, requires, ensures, loop invariant
    name: str  # of the property
    line: str  # such as app.koord:12
    outcome: str  # held, violated, no value, unknown
    age: Annotated[int, Meta(ge=0)] = 0  # of the oldest value that was read [rounds]
    why: str = ""  # values that were read, for people
    action: str = "log"  # log, hold, land, stop
    round: RoundNumber = 0  # at whose start the outcome is true
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot
    application: str = ""  # whose property


class PeerQuality(TypedDict, total=False):
    """Quality of the link from one peer, in Metrics."""

    loss: float | None  # share of the datagrams that were sent lately; null: none was
    delay_ms: dict[str, float]  # percentiles of the datagrams' delay: p50, p99, max [ms]
    silent_ms: float | None  # time since its last datagram; null: there was none [ms]
    longest_silence_ms: float  # longest time between two of its datagrams [ms]
    behind: int  # rounds of it that are not known yet [rounds]
    repeats: int  # its datagrams that were repetitions


class Metrics(msgspec.Struct, frozen=True, tag_field="kind", tag="metrics"):
    """Quality of a robot's links and rounds, every 10 s."""

    late_ms: Mapping[str, float] = {}  # percentiles of `late`: p50, p99, max [ms]
    rejected: Mapping[str, int] = {}  # datagrams that were rejected, by cause
    peers: Mapping[str, PeerQuality] = {}  # by pid
    rounds: int = 0  # that the robot has finished
    current: int = 0  # of these, those in which its copy of the shared variables was complete in time
    events: int = 0  # of these, those with an event
    skipped: Mapping[str, int] = {}  # of these, those without one, by reason
    time: float = 0.0  # in a robot's own trace: by the robot's clock [s]
    t: float = 0.0  # in a merged trace: since the start of round 1 [s]
    pid: int = -1  # in a merged trace: of the robot


class Violation(msgspec.Struct, frozen=True, tag_field="kind", tag="violation"):
    """A run was not as it must be."""

    t: float  # since the start of round 1 [s]
    what: str  # separation, collision, ended, fault, unrest, property, idle
    robots: tuple[str, ...]  # names of those that had a part in it
    detail: str  # for people
    name: str = ""  # of the property
    line: str = ""  # of the property, such as app.koord:12
    host: str = ""  # how the computer caused it; "": it did not
    application: str = ""  # of a property and of a fault
    pid: int | UnsetType = UNSET  # of a counterexample: robot whose next event has no result
    event: str | UnsetType = UNSET  # of a counterexample: that event


Found = Literal["held", "violated", "no value", "unchecked", "out of model"]


class Verdict(msgspec.Struct, frozen=True, tag_field="kind", tag="verdict"):
    """Verdict of a simulated run on one property, at the mission's end.

    A loop invariant has one only if it was ever false."""

    t: float  # since the start of round 1 [s]
    of: str  # invariant, initially, assume, axiom, loop invariant
    name: str  # of the property
    line: str  # such as app.koord:12
    outcome: Found  # of the whole run
    since: float | None = None  # when it was first violated, without value or out of model; null: never [s]
    robots: tuple[str, ...] = ()  # names of those for which it was false
    detail: str = ""  # values that were read, for people
    moments: int = 0  # at which it was evaluated
    application: str = ""  # whose property


class Cause(msgspec.Struct, frozen=True, tag_field="kind", tag="cause"):
    """A fault was injected."""

    t: float  # since the start of round 1 [s]
    what: str  # network, link, follow, or a kind of event of the scenario file
    robots: tuple[str, ...]  # names
    detail: str = ""  # for people
    lasts: float | None = None  # duration; null: for good, or no time at all [s]


class Moved(msgspec.Struct, frozen=True, tag_field="kind", tag="moved"):
    """An obstacle was moved, as a fault."""

    t: float  # since the start of round 1 [s]
    number: int  # in the header's `obstacles`, from 0
    obstacle: Obstacle  # at its new place


class End(msgspec.Struct, frozen=True, tag_field="kind", tag="end"):
    """The mission's end: the agents were asked to stop."""

    t: float  # since the start of round 1 [s]
    why: str  # for people


class _Kind(msgspec.Struct):
    kind: str


Mark = Violation | Verdict | Cause | Moved | End
OfRobot = Pose | Phase | Init | Round | Checkpoint | View | Log | Stall | Stream | Monitor | Metrics
TraceRecord = Header | OfRobot | Mark
KINDS: dict[str, type[msgspec.Struct]] = {str(kind.__struct_config__.tag): kind for kind in TraceRecord.__args__}
OF_APPLICATIONS = frozenset(kind for kind, type_ in KINDS.items() if "application" in type_.__struct_fields__)
_record = msgspec.json.Decoder(TraceRecord)
_header = msgspec.json.Decoder(Header)
_robot_header = msgspec.json.Decoder(RobotHeader)
_kind = msgspec.json.Decoder(_Kind)
_raw = msgspec.json.Decoder(dict[str, msgspec.Raw])
_encoder = msgspec.json.Encoder()
encoded = _encoder.encode


def decoded(line: bytes) -> TraceRecord | None:
    """Return the record of a line; None if this version does not know its kind.

    Raises msgspec.DecodeError."""
    try:
        record: TraceRecord = _record.decode(line)
    except msgspec.ValidationError:
        if _kind.decode(line).kind in KINDS:
            raise
        return None
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(str(error)) from None
    return record


def decoded_header(line: bytes) -> Header | RobotHeader:
    """Return the header in a line: of a robot's own trace if it names a robot. Raises msgspec.DecodeError."""
    return _robot_header.decode(line) if "robot" in _raw.decode(line) else _header.decode(line)


def misfit(line: bytes) -> str:
    """Return why a line does not fit the schema.

    Empty if it does, or if this version does not know its kind."""
    try:
        decoded(line)
    except (ValueError, RecursionError) as error:
        return str(error) or type(error).__name__
    return ""


def plain(record: msgspec.Struct) -> dict[str, Any]:
    """Return a record as JSON has it, of lists and dicts."""
    found: dict[str, Any] = msgspec.to_builtins(record)
    return found


def format_of(line: bytes) -> str:
    """Return the format of the trace that begins with this line.

    Empty if the line is no header of a trace. Raises ValueError if this version cannot read the format."""
    format_ = str(_header_in(line).get("format", ""))
    if format_ not in ("", OLD_FORMAT, FORMAT):
        raise ValueError(f"its format is {format_}; this koordgen reads {OLD_FORMAT} and {FORMAT}")
    return format_


def _header_in(line: bytes) -> Mapping[str, Any]:
    """Return the header of a trace in a line; empty if there is none."""
    if b'"header"' not in line:
        return {}
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    is_header = isinstance(header, dict) and header.get("kind") == "header"
    return header if is_header and str(header.get("format", "")).startswith(FAMILY) else {}


def upgraded(line: bytes, application: str) -> bytes:
    """Return a line of a koord-trace/1 trace as koord-trace/2 has it.

    A header with `applications`, a record that stems from an application's event with `application`. All other lines
    are returned as they are."""
    try:
        record = _raw.decode(line)
        kind = str(msgspec.json.decode(record["kind"]))
    except (ValueError, KeyError, RecursionError):
        return line
    if kind == "header" and bytes(record.get("format", b"")) == b'"%s"' % OLD_FORMAT.encode():
        named = {"format": msgspec.Raw(encoded(FORMAT)), "applications": msgspec.Raw(encoded([application]))}
    elif kind in OF_APPLICATIONS and "application" not in record and _is_of_event(kind, record):
        named = {"application": msgspec.Raw(encoded(application))}
    else:
        return line
    return encoded({**record, **named}) + (b"\n" if line.endswith(b"\n") else b"")


def _is_of_event(kind: str, record: Mapping[str, msgspec.Raw]) -> bool:
    return kind != "violation" or bytes(record.get("what", b"")).strip(b'"').decode(errors="replace") in OF_EVENTS


class Upgrade:
    """Reader of one file's lines: returns each as the present format has it, by the headers in the file."""

    def __init__(self) -> None:
        self._application: str | None = None  # of a trace of the old format

    def line(self, line: bytes) -> bytes:
        """Return the next line of the file. Raises ValueError if this version cannot read its format."""
        format_ = format_of(line)
        if format_:
            self._application = str(_header_in(line).get("app", "")) if format_ == OLD_FORMAT else None
        return line if self._application is None else upgraded(line, self._application)
