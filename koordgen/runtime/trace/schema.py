"""Schema of a trace, format koord-trace/2: every record, every key with its meaning and its unit.

A trace is a file of JSON objects, one on each line. The first object is the header. The key `kind` of an object names
its type. A trace has one of two forms. A robot's own trace begins with a RobotHeader, and its records have the key
`time`: seconds of the robot's local monotonic clock, in lockstep as in a flight. The merged trace of a run begins with
a Header, and its records have `t`, seconds since the start of round 1 (negative before), and `pid`, the number of the
robot. Points are [x, y, z] in metres, local ENU: x east, y north, z up. Yaw is in radians, counter-clockwise from east.
The program's types decide how values of the program are written in JSON. Numbers that are not finite are null.

The comment behind each field gives the meaning of the key, and the unit in brackets. `python -m tools.trace_tables`
writes these comments as tables into docs/reference/trace.md.

Agents write these types, simulators merge the records, and every reader checks its input against the types. Format
koord-trace/1 lacks the keys `applications` and `application`. `upgraded` adds both keys, so readers need to know only
the present format.
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
HEADER = b'{"kind":"header"'  # first bytes of each header that an agent writes
MOST_ROBOTS = 1000
MOST_ROUND = 100_000_000
OF_EVENTS = ("property", "fault")  # kinds of violations that an application's events cause

# Value of a key that a writer leaves out of a record: the key belongs to the other form of trace, or has no value.
LEFT_OUT: Any = UNSET

Vector = tuple[float, float, float]
Values = Mapping[str, msgspec.Raw]  # name of a variable or port -> value as JSON, by its type in the program
RoundNumber = Annotated[int, Meta(ge=0, le=MOST_ROUND)]  # number of a round; 0: `init`
LastRound = Annotated[int, Meta(ge=-1, le=MOST_ROUND)]  # last round of a robot; 0: `init`; -1: `init` has not run
Incarnation = Annotated[int, Meta(ge=-1, le=MOST_ROUND)]  # number of a robot's incarnation; -1: no member


class BadTrace(Exception):
    """Raised for a file that is no trace, or a damaged trace; the message names the file and the line."""


class RobotName(msgspec.Struct, frozen=True):
    """One robot of a run."""

    name: str  # name of the robot in the fleet file
    pid: int  # number of the robot; the numbers are 0, 1, 2 and so on
    target: str  # target of the robot, such as quad


class SharedVariable(msgspec.Struct, frozen=True):
    """A shared variable of the program."""

    name: str  # name of the variable in the program; of several applications, `application.variable`
    kind: str  # allread: one value for each robot; allwrite: one value for the fleet
    type: str  # type of the variable, written in Koord


class ApplicationRecord(msgspec.Struct, frozen=True):
    """One of several applications of a fleet."""

    name: str  # name of the application in the fleet file
    members: tuple[int, ...]  # pids of the robots that run it; a robot's pid in the application is its place here
    variables: dict[str, str]  # shared variables of its program -> their names in `shared`


class BoxRecord(msgspec.Struct, frozen=True):
    """An axis-parallel box."""

    lo: Vector  # lower corner [m]
    hi: Vector  # upper corner [m]


class Wind(msgspec.Struct, frozen=True):
    """Wind of a simulated world."""

    mean: Vector = (0.0, 0.0, 0.0)  # mean velocity of the wind, ENU [m/s]
    gust: float = 0.0  # standard deviation of the gusts in each direction [m/s]
    correlation: float = 1.0  # correlation time of the gusts [s]


class Marker(msgspec.Struct, frozen=True):
    """A place of interest; a robot within `radius` of its centre has reached it."""

    name: str  # name of the marker, shown to users
    position: Vector  # centre of the marker [m]
    radius: float = 0.3  # distance within which a robot has reached the marker [m]


class MarkerList(msgspec.Struct, frozen=True):
    """A shared list whose elements at the mission's start are markers."""

    variable: str  # name of the shared list
    position: str = ""  # field of a list element that holds its place; "": elements are Points
    radius: float = 0.3  # distance within which a robot has reached an element [m]


class WorldRecord(msgspec.Struct, frozen=True):
    """World of the fleet: arena, floor, wind and markers, from the fleet file."""

    arena: BoxRecord | None = None  # box in which the fleet moves; null: not given
    floor_friction: float = 1.0  # factor of the usual friction between robots and the floor
    wind: Wind = Wind()  # wind in the arena
    markers: tuple[Marker, ...] = ()  # markers with fixed places
    marker_list: MarkerList | None = None  # shared list whose elements are markers; null: none


class RobotHeader(msgspec.Struct, frozen=True, tag_field="kind", tag="header"):
    """First record of each part of a robot's own trace."""

    format: str  # version of the trace: koord-trace/2
    app: str  # name of the program; of several applications their names, joined by `+`
    applications: tuple[str, ...]  # names of the applications in this trace, in the order of the fleet file
    robot: str  # name of the robot
    pid: int  # number of the robot, from 0
    n_sys: int  # number of robots in the fleet
    delta: float  # length of a round [s]
    program_hash: str  # hash of the program, or of all applications: 16 hexadecimal digits
    part: int | UnsetType = UNSET  # number of this part of the trace, from 1, unless it is the first part
    followed: str | UnsetType = UNSET  # the run executed a counterexample, a "run" or a "step"


class Header(msgspec.Struct, frozen=True, tag_field="kind", tag="header"):
    """First record of a merged trace: describes the run, the fleet, the world and the shared variables."""

    format: str  # version of the trace: koord-trace/2
    app: str  # name of the program; of several applications their names, joined by `+`
    program_hash: str  # 16 hexadecimal digits; "": a counterexample with numbers that no robot has, such as 1/3
    delta: float  # length of a round [s]
    seed: int  # seed of the simulator's random numbers
    robots: tuple[RobotName, ...]  # robots of the run, in the order of their pids
    duration: float = 0.0  # length of the mission that the user asked for [s]
    started: bool = True  # the fleet began round 1; if not, `t` counts from the launch
    min_separation: float = 0.0  # required smallest distance between two robots; 0: no requirement [m]
    geofence: tuple[Vector, Vector] | None = None  # lower and upper corner of the geofence; null: no geofence [m]
    obstacles: tuple[Obstacle, ...] = ()  # obstacles in the form of a robot's settings; records number them from 0
    world: WorldRecord = WorldRecord()  # arena, floor, wind and markers
    shared: tuple[SharedVariable, ...] = ()  # shared variables of the program
    records: dict[str, tuple[tuple[str, str], ...]] = {}  # record types: name -> names and types of the fields
    followed: str = ""  # kind of the counterexample that the run executed: "run" or "step"; "": none
    applications: tuple[str, ...] = ()  # names of the applications in this trace, in the order of the fleet file
    counterexample: Literal["run", "step"] | UnsetType = UNSET  # of a counterexample: begins at initial or at any state
    params: Mapping[str, Any] | UnsetType = UNSET  # only of a counterexample: values of the program's params
    given: tuple[str, ...] | UnsetType = UNSET  # only of a counterexample: params whose values the user gave
    composition: tuple[ApplicationRecord, ...] | UnsetType = UNSET  # only of several applications: what they consist of


class PoseRecord(msgspec.Struct, frozen=True, tag_field="kind", tag="pose"):
    """Position and heading of a robot.

    In a simulation this is the true pose, `pose_rate` times a second; in a flight the measured pose, once a round."""

    pid: int  # number of the robot
    position: Vector  # position of the robot [m]
    yaw: float  # heading of the robot [rad]
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]


class MemberPose(msgspec.Struct, frozen=True, tag_field="kind", tag="member"):
    """True position and heading of a robot of a squad, in the trace of a simulated outer fleet.

    The squad is a robot of this trace. The position in its own `pose` is the mean of those of its members."""

    pid: int  # number of the squad
    member: str  # name of the robot in the fleet of the squad
    position: Vector  # position of the robot [m]
    yaw: float  # heading of the robot [rad]
    time: float = 0.0  # not in a merged trace: time by the simulator's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]


class Phase(msgspec.Struct, frozen=True, tag_field="kind", tag="phase"):
    """A robot's agent entered a phase, or made progress in its phase."""

    phase: str  # phase of the agent: starting, joining, running, stopping, stopped
    detail: str = ""  # cause of the phase, or progress in it, as text for users
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot


class InitRecord(msgspec.Struct, frozen=True, tag_field="kind", tag="init"):
    """Run of `init` on a robot."""

    sensors: Values = {}  # sensor values that `init` read
    locals: Values = {}  # all local variables after `init`
    shared: Values = {}  # shared variables that `init` wrote
    actuators: Values = {}  # all actuators that have a value after `init`
    violated: tuple[int, ...] = ()  # source lines of the loop invariants that were false in `init`
    stopped: bool = False  # the program has stopped on this robot
    calls: tuple[tuple[str, tuple[msgspec.Raw, ...], msgspec.Raw], ...] = ()  # calls of ports: name, arguments, answer
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot
    application: str = ""  # name of the application whose `init` ran


class Restored(msgspec.Struct, frozen=True):
    """Local variables and actuators of a robot after a round."""

    round: LastRound  # round after which the variables had these values; 0: `init`
    locals: Values = {}  # all local variables
    actuators: Values = {}  # all actuators that have a value
    stopped: bool = False  # the program has stopped on this robot


class EventFault(msgspec.Struct, frozen=True):
    """Reason for which an event was discarded."""

    file: str  # file of the program text
    line: int  # line in the program text; 0: not known
    reason: str  # reason as text for users

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        return f"{place}: {self.reason}" if place else self.reason


class Round(msgspec.Struct, frozen=True, tag_field="kind", tag="round"):
    """One round of an application on a robot. The robot writes this record when the round is committed."""

    round: RoundNumber  # number of the round, from 1; 0 only in a counterexample
    event: str | None = None  # event that ran or was discarded; null: no event
    skipped: str | None = None  # reason for which no event ran; null: an event ran
    fault: EventFault | None = None  # reason for which the event was discarded; null: it was not
    late: float = 0.0  # delay from the start of the round until the robot chose its event [s]
    sensors: Values = {}  # sensor values at the start of the round
    locals: Values = {}  # local variables that the event wrote
    shared: Values = {}  # shared variables that the event wrote; of an allread variable the robot's own slot
    actuators: Values = {}  # actuators that the event wrote
    copy: Values = {}  # shared variables that changed in the robot's copy before the event; allread: pid -> value
    calls: tuple[tuple[str, tuple[msgspec.Raw, ...], msgspec.Raw], ...] = ()  # calls of ports: name, arguments, answer
    violated: tuple[int, ...] = ()  # source lines of the loop invariants that were false in the event
    stopped: bool = False  # the program has stopped on this robot
    restored: Restored | None = None  # state with which the robot continued when it rejoined before this round
    clock_bound: float | None = 0.0  # largest possible error of the robot's fleet time; null: not known [s]
    counters: Mapping[str, int] = {}  # counters of the runtime that changed since the round before
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot
    application: str = ""  # name of the application whose event it is
    step: str | UnsetType = UNSET  # only of a counterexample: step that led to the values of this record


class Checkpoint(msgspec.Struct, frozen=True, tag_field="kind", tag="checkpoint"):
    """State of a robot at the beginning of a part of its trace, so that a reader needs no older parts."""

    round: LastRound  # last round in the earlier parts; 0: `init`, -1: none
    own: Restored | None = None  # robot's own variables after that round; null: not known
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot
    application: str = ""  # name of the application whose variables these are


class ViewRecord(msgspec.Struct, frozen=True, tag_field="kind", tag="view"):
    """Beginning of a new membership view."""

    number: RoundNumber  # number of the view, from 0
    since: Annotated[int, Meta(ge=-MOST_ROUND, le=MOST_ROUND)]  # first round of the view
    members: tuple[Incarnation, ...]  # incarnation of each robot, in the order of their pids; -1: no member
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot


class LogLine(msgspec.Struct, frozen=True, tag_field="kind", tag="log"):
    """Log line of a robot's agent."""

    level: str = "info"  # level of the log line: info, warning, error
    message: str = ""  # text of the log line
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot


class Stall(msgspec.Struct, frozen=True, tag_field="kind", tag="stall"):
    """Stall of a robot: it has no path to its target. A `log` record reports the same stall as text."""

    state: Literal["begins", "goes on", "ends"]  # change of the stall
    why: str  # text that names the target and the obstacle
    lasted: float  # time since the stall began [s]
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot


class StreamLine(msgspec.Struct, frozen=True, tag_field="kind", tag="stream"):
    """Line of text that the program wrote to a stream."""

    port: str  # name of the stream
    text: str  # line without its line end
    round: RoundNumber = 0  # round whose event wrote the line; 0: `init`
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot
    application: str = ""  # name of the application that wrote the line


class Monitor(msgspec.Struct, frozen=True, tag_field="kind", tag="monitor"):
    """New verdict of a robot's monitor on a property."""

    of: str  # kind of the property: invariant, guarantee, assume, requires, ensures, loop invariant
    name: str  # name of the property
    line: str  # place of the property, such as app.koord:12
    outcome: str  # verdict: held, violated, no value, unknown
    age: Annotated[int, Meta(ge=0)] = 0  # age of the oldest value that the monitor read [rounds]
    why: str = ""  # values that the monitor read, as text for users
    action: str = "log"  # reaction of the robot to a violation: log, hold, land, stop
    round: RoundNumber = 0  # round for whose start the verdict is valid
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot
    application: str = ""  # name of the application that has the property


class PeerQuality(TypedDict, total=False):
    """Quality of the link from one other robot (peer), as Metrics contains it."""

    loss: float | None  # share of the peer's recent datagrams that were lost; null: it sent none
    delay_ms: dict[str, float]  # percentiles of the delay of the peer's datagrams: p50, p99, max [ms]
    silent_ms: float | None  # time since the peer's last datagram; null: it sent none [ms]
    longest_silence_ms: float  # longest time between two datagrams of the peer [ms]
    behind: int  # number of the peer's round messages that have not arrived yet [rounds]
    repeats: int  # number of the peer's datagrams that were repetitions


class MetricsRecord(msgspec.Struct, frozen=True, tag_field="kind", tag="metrics"):
    """Quality of a robot's links and rounds, recorded every 10 s."""

    late_ms: Mapping[str, float] = {}  # percentiles of `late` of the rounds: p50, p99, max [ms]
    rejected: Mapping[str, int] = {}  # cause -> number of datagrams that were rejected
    peers: Mapping[str, PeerQuality] = {}  # pid of a peer -> quality of the link from it
    rounds: int = 0  # number of rounds that the robot has finished
    current: int = 0  # number of finished rounds in which the robot was current
    events: int = 0  # number of finished rounds with an event
    skipped: Mapping[str, int] = {}  # reason -> number of finished rounds without an event
    time: float = 0.0  # only in a robot's own trace: time by the robot's clock [s]
    t: float = 0.0  # only in a merged trace: time since the start of round 1 [s]
    pid: int = -1  # only in a merged trace: number of the robot


class Violation(msgspec.Struct, frozen=True, tag_field="kind", tag="violation"):
    """Violation of a property or of another requirement in a run."""

    t: float  # time since the start of round 1 [s]
    what: str  # kind: separation, collision, ended, fault, not_stopped, property, idle
    robots: tuple[str, ...]  # names of the robots that took part in the violation
    detail: str  # description for users
    name: str = ""  # name of the violated property, if `what` is "property"
    line: str = ""  # place of the violated property, such as app.koord:12
    host: str = ""  # how a busy computer caused the violation; "": it did not
    application: str = ""  # name of the application that has the property or the fault
    pid: int | UnsetType = UNSET  # only of a counterexample: number of the robot whose next event has no result
    event: str | UnsetType = UNSET  # only of a counterexample: event that has no result


Found = Literal["held", "violated", "no value", "unchecked", "out of model"]


class Verdict(msgspec.Struct, frozen=True, tag_field="kind", tag="verdict"):
    """Verdict of a simulated run on one property, at the mission's end.

    A loop invariant has a verdict only if it was ever false."""

    t: float  # time since the start of round 1 [s]
    of: str  # kind of the property: invariant, guarantee, initially, assume, axiom, loop invariant
    name: str  # name of the property
    line: str  # place of the property, such as app.koord:12
    outcome: Found  # verdict on the whole run
    since: float | None = None  # time of the first violation, missing value or state out of model; null: none [s]
    robots: tuple[str, ...] = ()  # names of the robots for which the property was false
    detail: str = ""  # values that the property read, as text for users
    observations: int = 0  # number of times at which the property was evaluated
    application: str = ""  # name of the application that has the property


class Cause(msgspec.Struct, frozen=True, tag_field="kind", tag="cause"):
    """Fault that the simulator injected into a run."""

    t: float  # time since the start of round 1 [s]
    what: str  # kind: network, link, follow, or an event's kind in the scenario file
    robots: tuple[str, ...]  # names of the robots that the fault affects
    detail: str = ""  # description of the fault for users
    lasts: float | None = None  # duration of the fault; null: it does not end, or it takes no time [s]


class Moved(msgspec.Struct, frozen=True, tag_field="kind", tag="moved"):
    """Obstacle that an injected fault moved."""

    t: float  # time since the start of round 1 [s]
    number: int  # number of the obstacle in the header's `obstacles`, from 0
    obstacle: Obstacle  # obstacle at its new place


class End(msgspec.Struct, frozen=True, tag_field="kind", tag="end"):
    """End of the mission: the simulator asked the agents to stop."""

    t: float  # time since the start of round 1 [s]
    why: str  # reason for the end, as text for users


class _Kind(msgspec.Struct):
    kind: str


Mark = Violation | Verdict | Cause | Moved | End
OfRobot = (
    PoseRecord
    | MemberPose
    | Phase
    | InitRecord
    | Round
    | Checkpoint
    | ViewRecord
    | LogLine
    | Stall
    | StreamLine
    | Monitor
    | MetricsRecord
)
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
    """Return the record in a line of a trace; None if this version does not know the record's kind.

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
    """Return the header in a line: a RobotHeader if the line has the key `robot`. Raises msgspec.DecodeError."""
    return _robot_header.decode(line) if "robot" in _raw.decode(line) else _header.decode(line)


def misfit(line: bytes) -> str:
    """Return the reason why a line of a trace does not fit the schema.

    Return "" if the line fits, or if this version does not know the record's kind."""
    try:
        decoded(line)
    except (ValueError, RecursionError) as error:
        return str(error) or type(error).__name__
    return ""


def plain(record: msgspec.Struct) -> dict[str, Any]:
    """Convert a record to the lists, dicts, numbers and strings that its JSON text denotes."""
    found: dict[str, Any] = msgspec.to_builtins(record)
    return found


def format_of(line: bytes) -> str:
    """Return the format of the trace that begins with a line; "" if the line is no header of a trace.

    Raises ValueError if this version cannot read the format."""
    format_ = str(_header_in(line).get("format", ""))
    if format_ not in ("", OLD_FORMAT, FORMAT):
        raise ValueError(f"its format is {format_}; this koordgen reads {OLD_FORMAT} and {FORMAT}")
    return format_


def _header_in(line: bytes) -> Mapping[str, Any]:
    """Return the header of a trace that a line contains; an empty mapping if the line contains none."""
    if b'"header"' not in line:
        return {}
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    is_header = isinstance(header, dict) and header.get("kind") == "header"
    return header if is_header and str(header.get("format", "")).startswith(FAMILY) else {}


def upgraded(line: bytes, application: str) -> bytes:
    """Convert a line of a koord-trace/1 trace to koord-trace/2.

    A header gets the key `applications`. A record that an application's event caused gets the key `application`. All
    other lines are returned unchanged."""
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
    """Converter of the lines of one trace file to the present format. The headers in the file name the old format."""

    def __init__(self) -> None:
        self._application: str | None = None  # application in a file of the old format; None: present format

    def line(self, line: bytes) -> bytes:
        """Convert the next line of the file. Raises ValueError if this version cannot read the file's format."""
        format_ = format_of(line)
        if format_:
            self._application = str(_header_in(line).get("app", "")) if format_ == OLD_FORMAT else None
        return line if self._application is None else upgraded(line, self._application)
