"""Interface between a generated program and the runtime, and the execution of one event.

A generated `program.py` defines one `PROGRAM: Program`. Each event works on a new Transaction, which `Program.begin`
creates from a `Frame`. An event can change nothing else of the robot, so dropping the Transaction discards the event.
"""

from __future__ import annotations

import reprlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import msgspec

from koordgen.runtime.program.extern import BadExtern, Contract, Library
from koordgen.runtime.values.bounds import Bound
from koordgen.runtime.values.containers import Missing, OutOfRange
from koordgen.runtime.values.points import NotANumber, transmissible
from koordgen.runtime.values.turns import NoTurns, TooMuch, begin, made

T = TypeVar("T")
LONGEST_REASON = 300  # largest number of characters in the reason of a fault; longer reasons are cut


def no_ports(port: str, args: tuple[Any, ...]) -> Any:
    """Raise LookupError. This is `Frame.call` of a robot without callable ports."""
    raise LookupError(f"nothing serves {port}")


class Frame(msgspec.Struct, frozen=True):
    """Input of an event: all values that the robot knows.

    The keys of `sensors` and `actuators` are "Module.port". `shared` maps the name of an allread variable to the tuple
    of its slots, and the name of an allwrite variable to its value. `call` returns the answer of a callable port from
    the port's name and the arguments."""

    pid: int
    n_sys: int
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]
    call: Callable[[str, tuple[Any, ...]], Any] = no_ports


class Effects(msgspec.Struct, frozen=True):
    """Result of an event.

    `locals`: values of all local variables after the event. `shared`, `actuators`: only the variables that the event
    wrote; a write of an equal value counts. `streams`: output lines as (port, line), in their order. `violated`: Koord
    lines of the loop invariants that were false or had no value, without repetition."""

    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool
    streams: tuple[tuple[str, str], ...] = ()
    violated: tuple[int, ...] = ()


class Life(msgspec.Struct, frozen=True):
    """Private variables of a robot after the event of a round; round 0 denotes `init`."""

    round: int
    locals: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool


@dataclass(frozen=True, slots=True)
class Fault:
    """Reason why an event was discarded: file and line of the Koord program, and text.

    `line`: line of the statement that failed, which may be in a function. For a broken contract of an extern function,
    the line of the call. For an invalid value, the line of its last write. 0: unknown."""

    file: str
    line: int
    reason: str
    contract: Contract | None = None  # contract of an extern function that the event broke

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.reason}" if self.line else f"{self.file}: {self.reason}"


class Stopped(Exception):
    """Raised by the statement `stop` in generated code. It ends the event, whose writes before the statement count."""


_violated: dict[int, None] = {}  # Koord lines of the loop invariants that were false in the running event


def claim(line: int, holds: Callable[[], bool]) -> bool:
    """Evaluate the loop invariant on a Koord line of the running event, and record the line if it is false.

    Always return True, because generated code calls this function as a part of the loop's condition. Raises NoTurns if
    the event has used up its turns, so that the event is discarded."""
    try:
        held = holds()
    except NoTurns:
        raise
    except Exception:
        held = False
    if not held:
        _violated[line] = None
    return True


def behind(turns: range) -> int:
    """Return the first value behind a range: the value of the loop variable after a loop over `turns`."""
    return turns.start + len(turns) * turns.step


class Cell(Generic[T]):
    """Variable or actuator inside an event. A read returns the value that the event wrote last.

    `line`: line of the last write, in the Python file that wrote; 0 before the first write."""

    __slots__ = ("_value", "line")

    def __init__(self, value: T) -> None:
        self._value = value
        self.line = 0

    @property
    def value(self) -> T:
        return self._value

    @value.setter
    def value(self, value: T) -> None:
        self._value = value
        self.line = sys._getframe(1).f_lineno

    def show(self, value: T) -> None:
        """Set the value that the event reads before it writes. Tools use this to run one event on many states."""
        self._value = value
        self.line = 0


class Slots(Generic[T]):
    """Allread variable inside an event: the event can read all slots, and write only the slot `own`.

    `line`: line of the last write, in the Python file that wrote; 0 before the first write."""

    __slots__ = ("_pid", "_values", "line")

    def __init__(self, values: Sequence[T], pid: int) -> None:
        self._values = tuple(values)
        self._pid = pid
        self.line = 0

    def __getitem__(self, index: int) -> T:
        if not 0 <= index < len(self._values):
            raise OutOfRange(f"index {index} names no robot (0 to {len(self._values) - 1})")
        return self._values[index]

    @property
    def all(self) -> tuple[T, ...]:
        """Slots of all robots, in the order of their pids."""
        return self._values

    @property
    def own(self) -> T:
        return self._values[self._pid]

    @own.setter
    def own(self, value: T) -> None:
        self._values = (*self._values[: self._pid], value, *self._values[self._pid + 1 :])
        self.line = sys._getframe(1).f_lineno

    def show(self, values: Sequence[T], pid: int) -> None:
        """Set the slots that the event reads before it writes, and the robot `pid` that runs the event."""
        self._values = tuple(values)
        self._pid = pid
        self.line = 0


class Transaction:
    """Variables of a robot as one event sees them, with the event's writes.

    Generated programs get each variable from `local`, `shared`, `actuator` or `slots`, so a subclass can return a
    subclass of Cell or Slots."""

    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.call = frame.call
        self.written: dict[str, Cell[Any] | Slots[Any]] = {}  # name -> variable or actuator that the event can write
        self._frame = frame
        self._streams: list[tuple[str, str]] = []

    def local(self, name: str) -> Cell[Any]:
        cell = self.written[name] = Cell(self._frame.locals[name])
        return cell

    def shared(self, name: str) -> Cell[Any]:
        cell = self.written[name] = Cell(self._frame.shared[name])
        return cell

    def actuator(self, name: str) -> Cell[Any]:
        cell = self.written[name] = Cell(self._frame.actuators[name])
        return cell

    def slots(self, name: str) -> Slots[Any]:
        slots = self.written[name] = Slots(self._frame.shared[name], self.pid)
        return slots

    def emit(self, port: str, *parts: str) -> None:
        """Append one line of text, joined from `parts`, to the output stream `port`."""
        self._streams.append((port, made("".join(parts))))

    def written_values(self) -> dict[str, Any]:
        """Return the values that the event wrote (name -> value); for an allread variable the robot's own slot."""
        written = self.written.items()
        return {name: place.own if isinstance(place, Slots) else place.value for name, place in written if place.line}

    def effects(self, found: Mapping[str, Any], stopped: bool) -> Effects:
        """Return the effects of the event. `found`: the values that the event wrote (name -> value)."""
        frame = self._frame
        return Effects(
            {name: found.get(name, value) for name, value in frame.locals.items()},
            {name: found[name] for name in frame.shared if name in found},
            {name: found[name] for name in frame.actuators if name in found},
            stopped,
            tuple(self._streams),
            tuple(_violated),
        )


@dataclass(frozen=True, slots=True)
class Variable:
    """Declaration of a local or shared variable.

    `type`: Python type for decoding by msgspec. `initial`: returns the initial value. `bound`: size limit of the value.
    """

    name: str
    kind: Literal["local", "allread", "allwrite"]
    type: Any
    bound: Bound
    initial: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Port:
    """Declaration of a port with the name "Module.port".

    `type`: type of a sensor's or actuator's value, or of a callable port's answer. `bound`: size limit of an actuator.
    `unset`: returns an actuator's value before the first write.

    `is_position`: the sensor is the robot's own position (Point, local ENU, metres). `held`: sensor whose value the
    actuator has before the first write, in place of `unset`; the program need not declare this sensor. `clears`:
    sensors that a command of this actuator sets to false until the robot sets them to true again. They are true before
    the first command."""

    name: str
    direction: Literal["sensor", "actuator", "callable", "stream"]
    type: Any
    bound: Bound | None = None
    unset: Callable[[], Any] | None = None
    is_position: bool = False
    held: str = ""
    clears: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """Event of a program: name, Koord line, guard and effect. Guard and effect are functions of a Transaction.

    `lock`: index in `Program.locks` of the lock that an atomic event needs; None for an event that is not atomic."""

    name: str
    line: int
    guard: Callable[[Any], bool]
    effect: Callable[[Any], None]
    lock: int | None = None


@dataclass(frozen=True, slots=True)
class Program:
    """Generated program.

    `source`: name of the Koord file. `program_hash`, `interface_hash`: 16 hexadecimal digits each. `interface_hash`
    (shared declarations, wire format) must be equal on all peers, `program_hash` in one application. `locks`: groups of
    shared variables. `lines`: line of the generated `file` -> line of the Koord file."""

    name: str
    source: str
    program_hash: str
    interface_hash: str
    locals: tuple[Variable, ...]
    shared: tuple[Variable, ...]
    ports: tuple[Port, ...]
    init: Callable[[Any], None] | None
    events: tuple[Event, ...]
    begin: type[Transaction]
    file: str
    lines: Mapping[int, int]
    locks: tuple[tuple[str, ...], ...] = ()
    library: Library | None = None
    bounds: Mapping[str, Bound] = field(init=False, repr=False, compare=False)  # name -> size limit

    @property
    def clears(self) -> dict[str, tuple[str, ...]]:
        """Name of an actuator -> sensors that a command of the actuator clears. Other actuators are left out."""
        return {port.name: port.clears for port in self.ports if port.clears}

    def __post_init__(self) -> None:
        targets: tuple[Variable | Port, ...] = (*self.locals, *self.shared, *self.ports)
        object.__setattr__(self, "bounds", {t.name: t.bound for t in targets if t.bound is not None})


def choose(program: Program, state: Transaction) -> Event | Fault | None:
    """Return the first event, in the order of the program text, whose guard holds; None if no guard holds.

    Return a Fault if a guard raises an exception. All guards and the event's effect can share the Transaction `state`,
    because guards write nothing."""
    for event in program.events:
        try:
            if enabled(event, state):
                return event
        except Exception as error:
            return _fault(program, error)
    return None


def enabled(event: Event, state: Transaction) -> bool:
    """Return whether the guard of an event holds. The guard has its own limit of turns."""
    begin()
    return event.guard(state)


def run(program: Program, effect: Callable[[Any], None], state: Transaction, line: int = 0) -> Effects | Fault:
    """Run the statements `effect` of an event. Return the effects, or a Fault if the event is discarded.

    An exception discards the whole event, as does a value that no robot may keep or send. `line`: Koord line of the
    event."""
    stopped = False
    _violated.clear()
    begin()
    try:
        effect(state)
    except Stopped:
        stopped = True
    except Exception as error:
        return _fault(program, error)
    found = state.written_values()
    effects = state.effects(found, stopped)
    return _refused(program, state, found, effects, line) or effects


def _refused(
    program: Program, state: Transaction, found: Mapping[str, Any], effects: Effects, line: int
) -> Fault | None:
    """Return a Fault for the first invalid value that an event wrote; None if all values are valid.

    The Fault names the line of the value's last write."""
    for name, bound in program.bounds.items():
        if name not in found:
            continue
        flaw = _flaw(bound, found[name])
        if flaw:
            at = program.lines.get(state.written[name].line, line)
            return Fault(program.source, at, f"{name} would become {flaw}")
    for port, text in effects.streams:
        if not transmissible(text):
            return Fault(program.source, line, f"{port} would get a text that is not Unicode")
    return None


def _flaw(bound: Bound, value: Any) -> str:
    """Return a description of a value that no robot may keep or send; "" if the value is valid.

    Local variables are checked like shared variables. So no variable is NaN after an event, and no int can grow in each
    round until it blocks the robot."""
    flaw = bound.flaw(value)
    return flaw or ("" if transmissible(value) else f"{reprlib.repr(value)}, which no robot may use")


def wrong_first_value(program: Program) -> str | None:
    """Return a message about the first variable with an invalid initial value; None if all initial values are valid.

    The compiler refuses invalid initial values too, but an agent does not rely on this."""
    for variable in (*program.locals, *program.shared):
        flaw = _flaw(variable.bound, variable.initial())
        if flaw:
            return f"{variable.name} would begin as {flaw}"
    return None


def _fault(program: Program, error: Exception) -> Fault:
    line = 0
    trace = error.__traceback__
    while trace is not None:  # the innermost frame in the generated file has the line that failed
        if Path(trace.tb_frame.f_code.co_filename) == Path(program.file):
            line = program.lines.get(trace.tb_lineno, line)
        trace = trace.tb_next
    told = isinstance(error, (OutOfRange, Missing, NotANumber, BadExtern, TooMuch))
    reason = str(error) if told else f"{type(error).__name__}: {error}"
    reason = reason if len(reason) <= LONGEST_REASON else f"{reason[:LONGEST_REASON]} ..."
    return Fault(program.source, line, reason, error.contract if isinstance(error, BadExtern) else None)


Calls = tuple[tuple[str, tuple[Any, ...], Any], ...]  # port, arguments and answer of each call of a callable port
