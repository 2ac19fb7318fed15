"""Parser of a counterexample's trace, which reads the trace as steps of a fleet.

koordgen/verify/prove/report/trace.py writes such traces of one program, and koordgen/verify/explore/system/trace.py
those of several applications. A step has a record for each instance, in the order of the instances: application by
application, and within an application by pid. With one application the number of an instance is its robot's pid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from koordgen.runtime.trace.schema import NO_HEADER, BadTrace, format_of
from koordgen.verify.replay.trace import TraceParts, records

BEGINNING, INIT, ENVIRONMENT = "the beginning", "init", "(environment)"
GROUPS = ("sensors", "shared", "actuators", "locals")
MOST_ROBOTS = 128  # same limit as in koordgen/runtime/net/wire.py; a test compares both limits

Values = Mapping[str, Any]  # name of a variable -> value in JSON


class InstanceRecord(NamedTuple):
    """Values of one instance after a step: those of its robot, as its program sees them.

    `calls`: (callable port, arguments, answer) of each call in the step."""

    sensors: Values
    shared: Values
    actuators: Values
    locals: Values
    stopped: bool
    calls: tuple[tuple[str, list[Any], Any], ...]


class TraceStep(NamedTuple):
    """Step of the fleet.

    `line`: the line of the step's first record.
    `event`: BEGINNING, INIT, ENVIRONMENT, or the name of an event.
    `instance`: the instance that runs the event; -1 for steps that are no event."""

    line: int
    round: int
    event: str
    instance: int
    records: tuple[InstanceRecord, ...]


class Ending(NamedTuple):
    """Violation after the last step of a counterexample.

    `name`: the violated property.
    `instance`, `event`: the instance and its next event, if the violation is that this event has no result; otherwise
    -1 and "".
    `application`: the application that has the property; "" if none has it."""

    name: str
    line: str
    detail: str
    instance: int = -1
    event: str = ""
    application: str = ""


class Member(NamedTuple):
    """Instance in a trace: the name of its application, and the number of its robot in the trace."""

    application: str
    robot: int


class CounterexampleTrace(NamedTuple):
    """Trace of a counterexample.

    `initial`: whether the trace begins in an initial state.
    `composed`: whether the header describes applications; names of params then begin with that of their application.
    `members`: all instances by their numbers.
    `params`: values of all params, in JSON.
    `given`: the names of the params whose values differ from the program's values.
    `ending`: the violation; None if the trace is cut off or contains no violation.
    `cut`: the first line that cannot be read; 0 if all lines can be read."""

    path: Path
    app: str
    program_hash: str
    initial: bool
    composed: bool
    robots: int
    members: tuple[Member, ...]
    params: Values
    given: tuple[str, ...]
    steps: tuple[TraceStep, ...]
    ending: Ending | None
    cut: int


def read(path: Path) -> CounterexampleTrace:
    """Read a trace, as far as its lines are complete. Raises BadTrace."""
    blank = TraceParts(path, "", "", (), False, 0)
    lines = records(blank)
    number, header, line = next(lines, (0, {}, b""))
    if not format_of(line):
        raise BadTrace(f"{path}: {NO_HEADER}")
    if header.get("counterexample") not in ("run", "step"):
        raise BadTrace(f"{path}: not the trace of a counterexample, which `koordgen explore --trace` writes")
    try:
        app, program_hash = str(header["app"]), str(header["program_hash"])
        robots, params, given = len(header["robots"]), _table(header["params"]), tuple(header["given"])
        if not all(name in params for name in given):
            raise ValueError(f"given {given!r}")
        if not 1 <= robots <= MOST_ROBOTS:
            raise ValueError(f"{robots} robots")
        members = _members(header, app, robots)
    except (KeyError, TypeError, ValueError) as error:
        raise BadTrace(f"{path}:{number}: a broken header: {error!r}") from None
    composed = "composition" in header
    steps, ending, cut = _steps(path, ((number, record) for number, record, _ in lines), members, composed)
    cut = blank.cut or cut
    if not steps:
        raise BadTrace(f"{path}: the trace contains no complete step")
    initial = header["counterexample"] == "run"
    return CounterexampleTrace(
        path, app, program_hash, initial, composed, robots, members, params, given, steps, ending, cut
    )


def _members(header: Mapping[str, Any], app: str, robots: int) -> tuple[Member, ...]:
    """Return all instances by their numbers. Raises KeyError, TypeError, ValueError."""
    if "composition" not in header:
        if len(header.get("applications", ())) > 1:
            raise ValueError("several applications without a composition")
        return tuple([Member(app, robot) for robot in range(robots)])
    found = [Member(str(each["name"]), robot) for each in header["composition"] for robot in each["members"]]
    if not found or not all(type(m.robot) is int and 0 <= m.robot < robots for m in found):
        raise ValueError(f"members {found!r}")
    return tuple(found)


def _steps(
    path: Path, found: Iterator[tuple[int, dict[str, Any]]], members: Sequence[Member], composed: bool
) -> tuple[tuple[TraceStep, ...], Ending | None, int]:
    """Return the complete steps, the violation, and the line at which an incomplete step begins.

    The line is 0 if all steps are complete."""
    steps: list[TraceStep] = []
    part: list[dict[str, Any]] = []
    first = 0
    for number, record in found:
        try:
            if record.get("kind") == "violation":
                if part:
                    raise ValueError("the last step lacks the records of some robots")
                return tuple(steps), _ending(record, members, composed), 0
            if record.get("kind") != "round":
                continue
            first = first if part else number
            expected = members[len(part)]
            if record["pid"] != expected.robot:
                raise ValueError(f"found robot {record['pid']!r}, expected robot {expected.robot}")
            if composed and record["application"] != expected.application:
                raise ValueError(f"found {record['application']!r}, expected {expected.application!r}")
            part.append(record)
            if len(part) == len(members):
                steps.append(_step(first, part))
                part = []
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadTrace(f"{path}:{number}: a broken record: {error!r}") from None
    return tuple(steps), None, first if part else 0


def _step(line: int, part: list[dict[str, Any]]) -> TraceStep:
    event, round_ = part[0]["step"], part[0]["round"]
    if type(event) is not str or type(round_) is not int or round_ < 0:
        raise ValueError(f"expected a step and a round, found {event!r} and {round_!r}")
    if any((record["step"], record["round"]) != (event, round_) for record in part):
        raise ValueError("the records of one step name different steps")
    acting = [number for number, record in enumerate(part) if record["skipped"] is None]
    alone = event not in (BEGINNING, INIT, ENVIRONMENT)
    if alone and len(acting) != 1:
        raise ValueError(f"{event} must be an event of one robot, but {len(acting)} robots act")
    return TraceStep(line, round_, event, acting[0] if alone else -1, tuple(map(_record, part)))


def _record(record: dict[str, Any]) -> InstanceRecord:
    sensors, shared, actuators, locals_ = (_table(record[group]) for group in GROUPS)
    calls = tuple([(port, list(args), answer) for port, args, answer in record.get("calls", ())])
    if any(type(port) is not str for port, _, _ in calls):
        raise ValueError("a call of a port without a name")
    return InstanceRecord(sensors, shared, actuators, locals_, record["stopped"] is True, calls)


def _ending(record: dict[str, Any], members: Sequence[Member], composed: bool) -> Ending:
    pid, event, application = record.get("pid", -1), record.get("event", ""), record.get("application", "")
    known = [n for n, m in enumerate(members) if m.robot == pid and (not composed or m.application == application)]
    if type(pid) is not int or not (known or pid == -1) or type(event) is not str:
        raise ValueError(f"expected a robot and an event, found {pid!r} and {event!r}")
    instance = known[0] if known else -1
    return Ending(str(record["name"]), str(record["line"]), str(record["detail"]), instance, event, str(application))


def _table(value: Any) -> Values:
    if not isinstance(value, dict):
        raise TypeError(f"expected a table, found {value!r}")
    return value
