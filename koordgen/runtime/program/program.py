"""What a generated program offers to the runtime, and how one of its events is run.

A generated `program.py` defines one `PROGRAM: Program`. An event works on a Transaction of its own, made by `begin`
from a `Frame`. Nothing else of the robot can be reached from an event, so to discard an event is to drop that.
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
LONGEST_REASON = 300  # characters


def no_ports(port: str, args: tuple[Any, ...]) -> Any:
    """The `Frame.call` of a robot without callable ports."""
    raise LookupError(f"nothing serves {port}")


class Frame(msgspec.Struct, frozen=True):
    """What a robot knows when it evaluates an event. Keys of `sensors` and `actuators` are "Module.port";
    `shared` maps an allread variable to its slots by pid and an allwrite variable to its value; `call` answers a
    callable port, by its name and arguments."""

    pid: int
    n_sys: int
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    sensors: Mapping[str, Any]
    actuators: Mapping[str, Any]
    call: Callable[[str, tuple[Any, ...]], Any] = no_ports


class Effects(msgspec.Struct, frozen=True):
    """What an event did: all locals as they are afterwards, only those shared variables and actuators that it
    wrote (an equal value counts as written), and the lines it put out, as (port, line) in order. `violated`: the Koord
    lines of the loop invariants that were false or had no value, each once."""

    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool
    streams: tuple[tuple[str, str], ...] = ()
    violated: tuple[int, ...] = ()


class Life(msgspec.Struct, frozen=True):
    """A robot's own variables after its event of a round; of round 0, after `init`."""

    round: int
    locals: Mapping[str, Any]
    actuators: Mapping[str, Any]
    stopped: bool


@dataclass(frozen=True, slots=True)
class Fault:
    """Why an event was discarded: the Koord file and line (0 when unknown) and the reason in words. The line is that on
    which the failing statement begins, within a function the function's; of an extern function's contract, the call's;
    of a value that must not be kept, that of its last write."""

    file: str
    line: int
    reason: str
    contract: Contract | None = None  # that was broken

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.reason}" if self.line else f"{self.file}: {self.reason}"


class Stopped(Exception):
    """Raised by `stop` in generated code: ends the event at once, with what it wrote so far."""


_violated: dict[int, None] = {}  # Koord lines of the loop invariants that did not hold in the event that is run


def claim(line: int, holds: Callable[[], bool]) -> bool:
    """Evaluate the loop invariant on a Koord line, for the event that is run. Always true, whatever comes of it: it
    stands before a loop's condition. Raises NoTurns: an event that has used up its turns is discarded."""
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
    """The value at which a loop over `turns` ends: the first that it does not take."""
    return turns.start + len(turns) * turns.step


class Cell(Generic[T]):
    """A variable or an actuator inside an event: reads back what it wrote. `line` is where that was last, in the file
    of whoever wrote it; 0 when nobody did."""

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
        """Let the event begin with another value. Tools evaluate one event on many states."""
        self._value = value
        self.line = 0


class Slots(Generic[T]):
    """An allread variable inside an event: anyone's slot can be read, only `own` can be written. `line` as of Cell."""

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
        """Every robot's slot, by pid."""
        return self._values

    @property
    def own(self) -> T:
        return self._values[self._pid]

    @own.setter
    def own(self, value: T) -> None:
        self._values = (*self._values[: self._pid], value, *self._values[self._pid + 1 :])
        self.line = sys._getframe(1).f_lineno

    def show(self, values: Sequence[T], pid: int) -> None:
        """Let the event begin with other values, on robot `pid`. See Cell."""
        self._values = tuple(values)
        self._pid = pid
        self.line = 0


class Transaction:
    """What one event sees on one robot, and what it has written so far. Generated programs name its parts: they ask
    `local`, `shared`, `actuator` and `slots` for the cell of each, so a subclass may give cells of its own kind."""

    def __init__(self, frame: Frame) -> None:
        self.pid = frame.pid
        self.n_sys = frame.n_sys
        self.call = frame.call
        self.written: dict[str, Cell[Any] | Slots[Any]] = {}  # all that can be
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
        """One line to a stream."""
        self._streams.append((port, made("".join(parts))))

    def news(self) -> dict[str, Any]:
        """What was written, by name; of an allread variable, the robot's own slot."""
        written = self.written.items()
        return {name: place.own if isinstance(place, Slots) else place.value for name, place in written if place.line}

    def effects(self, found: Mapping[str, Any], stopped: bool) -> Effects:
        """What the event did, given its `news`."""
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
    """A local or shared variable: `type` is what msgspec decodes it as, `initial` makes its first value, `bound` says
    how much it may hold."""

    name: str
    kind: Literal["local", "allread", "allwrite"]
    type: Any
    bound: Bound
    initial: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Port:
    """A port, named "Module.port". `type` is that of a sensor's or actuator's value, or of a call's result. An actuator
    has a `bound`, and `unset` makes the value that it has before it is written.

    `is_position`: the sensor says where the robot itself is (Point, local ENU, metres). `held`: the sensor whose value
    the actuator has before it is written, instead of `unset`; the program may not declare it. `clears`: sensors of the
    program that are true before any command, and false from a command of this actuator on until the robot says
    otherwise.
    """

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
    """An event of the program: its name, the Koord line it stands on, guard and effect over the program's Transaction.
    `lock` is the index in `Program.locks` of what an atomic event needs the right to; None of a plain event."""

    name: str
    line: int
    guard: Callable[[Any], bool]
    effect: Callable[[Any], None]
    lock: int | None = None


@dataclass(frozen=True, slots=True)
class Program:
    """A whole generated program. `source` is the Koord file's name; hashes are 16 hexadecimal digits: peers must
    share `interface_hash` (shared declarations, wire format) always and `program_hash` within one application.
    `locks` are groups of shared variables; `lines` maps lines of `file` to those of the source."""

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
    bounds: Mapping[str, Bound] = field(init=False, repr=False, compare=False)  # by name, of all that has one

    @property
    def clears(self) -> dict[str, tuple[str, ...]]:
        """The sensors that a command of an actuator clears, for each actuator of which there are some."""
        return {port.name: port.clears for port in self.ports if port.clears}

    def __post_init__(self) -> None:
        targets: tuple[Variable | Port, ...] = (*self.locals, *self.shared, *self.ports)
        object.__setattr__(self, "bounds", {t.name: t.bound for t in targets if t.bound is not None})


def choose(program: Program, state: Transaction) -> Event | Fault | None:
    """The first event in text order whose guard holds, or None. A guard that raises is a Fault; none writes anything,
    so that all of them and the effect share one Transaction."""
    for event in program.events:
        try:
            if enabled(event, state):
                return event
        except Exception as error:
            return _fault(program, error)
    return None


def enabled(event: Event, state: Transaction) -> bool:
    """Return whether an event's guard holds. It has turns of its own."""
    begin()
    return event.guard(state)


def run(program: Program, effect: Callable[[Any], None], state: Transaction, line: int = 0) -> Effects | Fault:
    """Run one effect, which stands on a Koord line. Whatever it raises, and any value that must not be kept or leave
    the robot, discards it whole."""
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
    """Why what was written does not count, at the line of its last write."""
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
    """Return the flaw of a value that would be kept or sent; empty when it has none. Locals are judged as all else is:
    NaN never outlives its event, and an int that is squared every round would soon hang the robot."""
    flaw = bound.flaw(value)
    return flaw or ("" if transmissible(value) else f"{reprlib.repr(value)}, which no robot may use")


def wrong_first_value(program: Program) -> str | None:
    """Return why a variable must not begin with its first value, in words; None when all are right. The compiler
    refuses such first values, too; an agent does not rely on it."""
    for variable in (*program.locals, *program.shared):
        flaw = _flaw(variable.bound, variable.initial())
        if flaw:
            return f"{variable.name} would begin as {flaw}"
    return None


def _fault(program: Program, error: Exception) -> Fault:
    line = 0
    trace = error.__traceback__
    while trace is not None:  # the innermost frame of the generated file is the statement that failed
        if Path(trace.tb_frame.f_code.co_filename) == Path(program.file):
            line = program.lines.get(trace.tb_lineno, line)
        trace = trace.tb_next
    told = isinstance(error, (OutOfRange, Missing, NotANumber, BadExtern, TooMuch))
    reason = str(error) if told else f"{type(error).__name__}: {error}"
    reason = reason if len(reason) <= LONGEST_REASON else f"{reason[:LONGEST_REASON]} ..."
    return Fault(program.source, line, reason, error.contract if isinstance(error, BadExtern) else None)


Calls = tuple[tuple[str, tuple[Any, ...], Any], ...]  # of callable ports: port, arguments, answer
