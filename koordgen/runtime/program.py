"""What a generated program offers to the runtime, and how one of its events is run.

A generated `program.py` defines one `PROGRAM: Program`. An event works on a `State` of its own, made by `begin` from
a `Frame`; `end` tells what it wrote. Nothing else of the robot can be reached from an event, so to discard an event
is to drop its State.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from koordgen.runtime.containers import OutOfRange
from koordgen.runtime.values import INT_MAX, INT_MIN, transmissible

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Frame:
    """What a robot knows when it evaluates an event. Keys of `sensors` and `actuators` are "Module.port";
    `shared` maps an allread variable to its slots by pid and an allwrite variable to its value."""

    pid: int
    n_sys: int
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Effects:
    """What an event did: all locals as they are afterwards, and only those shared variables and actuators that it
    wrote (an equal value counts as written)."""

    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool


@dataclass(frozen=True, slots=True)
class Fault:
    """Why an event was discarded: the Koord file and line (0 when unknown) and the reason in words."""

    file: str
    line: int
    reason: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.reason}"


class Stopped(Exception):
    """Raised by `stop` in generated code: ends the event at once, with what it wrote so far."""


class Slots(Generic[T]):
    """An allread variable inside an event: anyone's slot can be read, only `own` can be written."""

    __slots__ = ("_pid", "_values", "written")

    def __init__(self, values: Sequence[T], pid: int) -> None:
        self._values = list(values)
        self._pid = pid
        self.written = False

    def __getitem__(self, index: int) -> T:
        if not 0 <= index < len(self._values):
            raise OutOfRange(f"index {index} names no robot (0 to {len(self._values) - 1})")
        return self._values[index]

    @property
    def own(self) -> T:
        return self._values[self._pid]

    @own.setter
    def own(self, value: T) -> None:
        self._values[self._pid] = value
        self.written = True


class Cell(Generic[T]):
    """An allwrite variable or an actuator inside an event: reads back what it wrote."""

    __slots__ = ("_value", "written")

    def __init__(self, value: T) -> None:
        self._value = value
        self.written = False

    @property
    def value(self) -> T:
        return self._value

    @value.setter
    def value(self, value: T) -> None:
        self._value = value
        self.written = True


@dataclass(frozen=True, slots=True)
class Variable:
    """A local or shared variable: `type` is what msgspec decodes it as, `initial` makes its first value."""

    name: str
    kind: Literal["local", "allread", "allwrite"]
    type: Any
    initial: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Port:
    """A sensor or an actuator, named "Module.port"."""

    name: str
    direction: Literal["sensor", "actuator"]
    type: Any


@dataclass(frozen=True, slots=True)
class Event:
    """An event of the program: its name, the Koord line it stands on, guard and effect over the program's State."""

    name: str
    line: int
    guard: Callable[[Any], bool]
    effect: Callable[[Any], None]


@dataclass(frozen=True, slots=True)
class Program:
    """A whole generated program. `source` is the Koord file's name; hashes are 16 hexadecimal digits: peers must
    share `interface_hash` (shared declarations, wire format) always and `program_hash` within one application."""

    name: str
    source: str
    program_hash: str
    interface_hash: str
    locals: tuple[Variable, ...]
    shared: tuple[Variable, ...]
    ports: tuple[Port, ...]
    init: Callable[[Any], None] | None
    events: tuple[Event, ...]
    begin: Callable[[Frame], Any]
    end: Callable[[Any, bool], Effects]
    file: str
    lines: Mapping[int, int]


def choose(program: Program, frame: Frame) -> Event | Fault | None:
    """The first event in text order whose guard holds, or None. A guard that raises is a Fault."""
    state = program.begin(frame)  # one for all: a guard writes nothing
    for event in program.events:
        try:
            if event.guard(state):
                return event
        except Exception as error:
            return _fault(program, error)
    return None


def run(program: Program, effect: Callable[[Any], None], frame: Frame, line: int = 0) -> Effects | Fault:
    """Run one effect, which stands on a Koord line, on a State of its own. Whatever it raises, and any value that must
    not leave the robot, discards it whole."""
    state = program.begin(frame)
    stopped = False
    try:
        effect(state)
    except Stopped:
        stopped = True
    except Exception as error:
        return _fault(program, error)
    effects = program.end(state, stopped)
    for name, value in effects.locals.items():
        # An int squared every round would soon hang the robot.
        if isinstance(value, int) and not INT_MIN <= value <= INT_MAX:
            return Fault(program.source, line, f"{name} would become an int beyond 64 bits, which no robot may use")
    for name, value in (*effects.shared.items(), *effects.actuators.items()):
        if not transmissible(value):
            shown = "an int beyond 64 bits" if isinstance(value, int) else repr(value)  # it may have very many digits
            return Fault(program.source, line, f"{name} would become {shown}, which no robot may use")
    return effects


def _fault(program: Program, error: Exception) -> Fault:
    line = 0
    trace = error.__traceback__
    while trace is not None:  # the innermost frame of the generated file is the statement that failed
        if Path(trace.tb_frame.f_code.co_filename) == Path(program.file):
            line = program.lines.get(trace.tb_lineno, line)
        trace = trace.tb_next
    reason = str(error) if isinstance(error, OutOfRange) else f"{type(error).__name__}: {error}"
    return Fault(program.source, line, reason)
