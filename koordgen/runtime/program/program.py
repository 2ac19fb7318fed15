"""Interface between a generated program and the runtime, and the execution of one event.

A generated `program.py` defines one `PROGRAM: Program`. An event works on a Transaction of its own, created by `begin`
from a `Frame`. An event can reach nothing else of the robot, so dropping the Transaction discards the event.
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
LONGEST_REASON = 300  # characters after which the reason of a fault is cut


def no_ports(port: str, args: tuple[Any, ...]) -> Any:
    """Raise LookupError: `Frame.call` of a robot without callable ports."""
    raise LookupError(f"nothing serves {port}")


class Frame(msgspec.Struct, frozen=True):
    """Input of an event: everything that the robot knows.

    Keys of `sensors` and `actuators` are "Module.port". `shared` maps an allread variable to its slots by pid and an
    allwrite variable to its value. `call` answers a callable port by name and arguments."""

    pid: int
    n_sys: int
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]
    call: Callable[[str, tuple[Any, ...]], Any] = no_ports


class Effects(msgspec.Struct, frozen=True):
    """Result of an event.

    All locals as they are afterwards; only those shared variables and actuators that it wrote (an equal value counts as
    written); its output lines as (port, line) in order. `violated`: Koord lines of the loop invariants that were false
    or had no value, each once."""

    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool
    streams: tuple[tuple[str, str], ...] = ()
    violated: tuple[int, ...] = ()


class Life(msgspec.Struct, frozen=True):
    """A robot's private variables after its event of a round; round 0: after `init`."""

    round: int
    locals: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool


@dataclass(frozen=True, slots=True)
class Fault:
    """Reason why an event was discarded: Koord file, line (0 if unknown), and text.

    The line is that of the failing statement, also inside a function; of the call, for a contract of an extern
    function; of the last write, for an invalid value."""

    file: str
    line: int
    reason: str
    contract: Contract | None = None  # the broken contract

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.reason}" if self.line else f"{self.file}: {self.reason}"


class Stopped(Exception):
    """Raised by `stop` in generated code: ends the event at once, keeping its writes so far."""


_violated: dict[int, None] = {}  # Koord lines of loop invariants that did not hold in the running event


def claim(line: int, holds: Callable[[], bool]) -> bool:
    """Evaluate the loop invariant on a Koord line, for the running event. Always return True.

    Generated code calls it before a loop's condition. Raises NoTurns: an event that has used up its turns is
    discarded."""
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
    """Return the value with which a loop over `turns` ends: the first one outside."""
    return turns.start + len(turns) * turns.step


class Cell(Generic[T]):
    """A variable or an actuator inside an event; reads return what was written.

    `line` is the line of the last write, in the writer's file; 0 if there was none."""

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
        """Set the initial value of the event. Tools evaluate one event on many states."""
        self._value = value
        self.line = 0


class Slots(Generic[T]):
    """An allread variable inside an event: all slots are readable, only `own` is writable.

    `line` as in Cell."""

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
        """All slots, by pid."""
        return self._values

    @property
    def own(self) -> T:
        return self._values[self._pid]

    @own.setter
    def own(self, value: T) -> None:
        self._values = (*self._values[: self._pid], value, *self._values[self._pid + 1 :])
        self.line = sys._getframe(1).f_lineno

    def show(self, values: Sequence[T], pid: int) -> None:
        """Set the initial values of the event on robot `pid`. See Cell.show."""
        self._values = tuple(values)
        self._pid = pid
        self.line = 0


class Transaction:
    """One event's view of its robot, with its writes so far.

    Generated programs request each variable by `local`, `shared`, `actuator` and `slots`, so a subclass may return
    cells of its own kind."""

    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.call = frame.call
        self.written: dict[str, Cell[Any] | Slots[Any]] = {}  # all variables that can be written
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
        """Append one line to a stream."""
        self._streams.append((port, made("".join(parts))))

    def news(self) -> dict[str, Any]:
        """Return the written values by name; of an allread variable, the robot's own slot."""
        written = self.written.items()
        return {name: place.own if isinstance(place, Slots) else place.value for name, place in written if place.line}

    def effects(self, found: Mapping[str, Any], stopped: bool) -> Effects:
        """Return the event's effects, given its `news`."""
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
    """A local or shared variable.

    `type`: for decoding by msgspec. `initial` returns its initial value. `bound`: limits of its size."""

    name: str
    kind: Literal["local", "allread", "allwrite"]
    type: Any
    bound: Bound
    initial: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Port:
    """A port, named "Module.port".

    `type` is that of a sensor's or actuator's value, or of a call's result. An actuator has a `bound`; `unset` returns
    its value before it is written.

    `is_position`: the sensor is the robot's own position (Point, local ENU, metres). `held`: the sensor whose value the
    actuator has before it is written, instead of `unset`; the program may not declare it. `clears`: sensors of the
    program that are true before any command, and false from a command of this actuator until the robot sets them
    again."""

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
    """An event of the program: name, Koord line, guard and effect over the program's Transaction.

    `lock` is the index in `Program.locks` of the lock that an atomic event needs; None for a plain event."""

    name: str
    line: int
    guard: Callable[[Any], bool]
    effect: Callable[[Any], None]
    lock: int | None = None


@dataclass(frozen=True, slots=True)
class Program:
    """A whole generated program.

    `source` is the Koord file's name. Hashes are 16 hexadecimal digits: `interface_hash` (shared declarations, wire
    format) must be equal for all peers, `program_hash` within one application. `locks` are groups of shared variables.
    `lines` maps lines of `file` to those of the source."""

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
    bounds: Mapping[str, Bound] = field(init=False, repr=False, compare=False)  # by name, for everything with a bound

    @property
    def clears(self) -> dict[str, tuple[str, ...]]:
        """For each actuator that clears sensors, the sensors that its command clears."""
        return {port.name: port.clears for port in self.ports if port.clears}

    def __post_init__(self) -> None:
        targets: tuple[Variable | Port, ...] = (*self.locals, *self.shared, *self.ports)
        object.__setattr__(self, "bounds", {t.name: t.bound for t in targets if t.bound is not None})


def choose(program: Program, state: Transaction) -> Event | Fault | None:
    """Return the first event in text order whose guard holds, or None. A guard that raises is a Fault.

    Guards write nothing, so all guards and the effect share one Transaction."""
    for event in program.events:
        try:
            if enabled(event, state):
                return event
        except Exception as error:
            return _fault(program, error)
    return None


def enabled(event: Event, state: Transaction) -> bool:
    """Return whether an event's guard holds, with a turn count of its own."""
    begin()
    return event.guard(state)


def run(program: Program, effect: Callable[[Any], None], state: Transaction, line: int = 0) -> Effects | Fault:
    """Run one effect, which is on a Koord line. Return its effects, or a Fault.

    An exception, and any value that must not be kept or sent, discards the whole event."""
    stopped = False
    _violated.clear()
    begin()
    try:
        effect(state)
    except Stopped:
        stopped = True
    except Exception as error:
        return _fault(program, error)
    found = state.news()
    effects = state.effects(found, stopped)
    return _refused(program, state, found, effects, line) or effects


def _refused(
    program: Program, state: Transaction, found: Mapping[str, Any], effects: Effects, line: int
) -> Fault | None:
    """Return the first invalid value that was written, at the line of its last write."""
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
    """Return the flaw of a value that would be kept or sent; "" if there is none.

    Locals are checked like all others: NaN never outlives its event, and an int that is squared every round would soon
    block the robot."""
    flaw = bound.flaw(value)
    return flaw or ("" if transmissible(value) else f"{reprlib.repr(value)}, which no robot may use")


def wrong_first_value(program: Program) -> str | None:
    """Return which variable has an invalid initial value; None if all are valid.

    The compiler refuses such initial values, too; an agent does not rely on it."""
    for variable in (*program.locals, *program.shared):
        flaw = _flaw(variable.bound, variable.initial())
        if flaw:
            return f"{variable.name} would begin as {flaw}"
    return None


def _fault(program: Program, error: Exception) -> Fault:
    line = 0
    trace = error.__traceback__
    while trace is not None:  # the innermost frame of the generated file is the failing statement
        if Path(trace.tb_frame.f_code.co_filename) == Path(program.file):
            line = program.lines.get(trace.tb_lineno, line)
        trace = trace.tb_next
    told = isinstance(error, (OutOfRange, Missing, NotANumber, BadExtern, TooMuch))
    reason = str(error) if told else f"{type(error).__name__}: {error}"
    reason = reason if len(reason) <= LONGEST_REASON else f"{reason[:LONGEST_REASON]} ..."
    return Fault(program.source, line, reason, error.contract if isinstance(error, BadExtern) else None)


Calls = tuple[tuple[str, tuple[Any, ...], Any], ...]  # calls of callable ports: port, arguments, answer
