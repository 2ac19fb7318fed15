"""Base of a generated `properties.py`: a program's properties, evaluated on values of one time.

The caller provides the values. The simulator provides the true values, a monitor on a robot the values that the robot
knows. An unknown value is UNKNOWN. A property that depends on an unknown value is "unknown", never "held"."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, Literal, NamedTuple, TypeVar

from koordgen.runtime.program.program import Calls, Program
from koordgen.runtime.values.containers import OutOfRange
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.values.turns import begin

T = TypeVar("T")
Outcome = Literal["held", "violated", "no value", "unknown"]
LONGEST = 300  # characters of a reason
# Sensors of a vehicle that a simulator can measure itself, with their types. Only the robot knows the others.
MEASURED = {"position": Point, "velocity": Point, "pose": Pose}


class _Unknown:
    def __repr__(self) -> str:
        return "unknown"


UNKNOWN: Final = _Unknown()


class Unknown(Exception):
    """An unknown value was read. The message names it; `robot` is its owner, -1 for none."""

    def __init__(self, what: str, robot: int = -1) -> None:
        super().__init__(what)
        self.robot = robot


class Bound(NamedTuple):
    """Value of a quantified name; `robot`: the value is a robot's pid."""

    name: str
    value: Any
    robot: bool


class Read(NamedTuple):
    """A value that was read; `robot` is its owner, None for an allwrite variable."""

    name: str
    robot: int | None
    value: Any


Trail = list[Bound | Read]


class Each(Generic[T]):
    """A port, local variable or allread variable of every robot, by pid. The caller sets `values`."""

    __slots__ = ("_trail", "name", "values")

    def __init__(self, name: str, trail: Trail | None) -> None:
        self.name = name
        self.values: Sequence[Any] = ()
        self._trail = trail

    def __getitem__(self, robot: int) -> T:
        if not 0 <= robot < len(self.values):
            raise OutOfRange(f"index {robot} names no robot (0 to {len(self.values) - 1})")
        value: T = self.values[robot]
        if value is UNKNOWN:
            raise Unknown(f"{self.name}[{robot}]", robot)
        if self._trail is not None:
            self._trail.append(Read(self.name, robot, value))
        return value

    @property
    def all(self) -> tuple[T, ...]:
        """Values of all robots, by pid."""
        return tuple([self[robot] for robot in range(len(self.values))])


class One(Generic[T]):
    """An allwrite variable; in an assumption, a port of its robot."""

    __slots__ = ("_trail", "content", "name")

    def __init__(self, name: str, trail: Trail | None) -> None:
        self.name = name
        self.content: Any = UNKNOWN
        self._trail = trail

    @property
    def value(self) -> T:
        value: T = self.content
        if value is UNKNOWN:
            raise Unknown(self.name)
        if self._trail is not None:
            self._trail.append(Read(self.name, None, value))
        return value


class Known:
    """Known values at one time.

    They have their names in the program; in an assumption, ports of its one robot, and primed names for the time after.
    `pid` is that robot, or the robot whose knowledge it is (-1: nobody's alone). A trail records why a formula was
    false: the bound names, outermost first, and the values read."""

    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:
        self.n_sys = n_sys
        self.pid = -1
        self.asked: Calls = ()  # calls of callable ports in the step of an assumption
        self.each: dict[str, Each[Any]] = {}
        self.one: dict[str, One[Any]] = {}
        self._trail = trail

    def of_each(self, name: str) -> Each[Any]:
        return self.each.setdefault(name, Each(name, self._trail))

    def of_one(self, name: str) -> One[Any]:
        return self.one.setdefault(name, One(name, self._trail))

    def put(self, values: Mapping[str, Any]) -> None:
        """Set values by name; names that no formula reads are ignored."""
        for name, value in values.items():
            if name in self.each:
                self.each[name].values = value
            elif name in self.one:
                self.one[name].content = value

    def take(self, other: Known) -> None:
        """Copy all values of another object."""
        self.pid, self.asked = other.pid, other.asked
        self.put({name: each.values for name, each in other.each.items()})
        self.put({name: one.content for name, one in other.one.items()})

    def answer(self, port: str, args: tuple[Any, ...]) -> Any:
        """Return the recorded answer of a callable port. Raises Unknown if it was not called so."""
        for name, given, answer in self.asked:
            if name == port and given == args:
                return answer
        raise Unknown(f"{port}: not called with these arguments")

    def every(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """Evaluate forall: false if false for any value; otherwise unknown if unknown for any."""
        trail, unknown, mark = self._trail, None, 0
        for value in domain:
            if trail is not None:
                mark = len(trail)
            try:
                if not body(value):
                    if trail is not None:
                        trail.insert(mark, Bound(name, value, robots))
                    return False
            except Unknown as found:
                unknown = unknown or found
            if trail is not None:
                del trail[mark:]
        if unknown is not None:
            raise unknown
        return True

    def own(self, name: str, body: Callable[[int], bool]) -> bool:
        """Evaluate forall over robots by one robot (`pid`), which knows only its own values."""
        if self.pid < 0 or self.n_sys == 1:
            return self.every(name, range(self.n_sys), body)
        if self.every(name, (self.pid,), body):
            raise Unknown(f"{name}: what the other robots know")
        return False

    def some(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """Evaluate exists: true for the first value that makes it true."""
        unknown, mark = None, 0 if self._trail is None else len(self._trail)
        for value in domain:
            try:
                if body(value):
                    return True
            except Unknown as found:
                unknown = unknown or found
            if self._trail is not None:
                del self._trail[mark:]
        if unknown is not None:
            raise unknown
        return False


@dataclass(frozen=True, slots=True)
class Property:
    """A property of the program.

    `reads`: names of ports, locals and shared variables in its formula. `surely`: screening, a vectorised sufficient
    condition over arrays of many observations; None if there is none."""

    kind: Literal["initially", "invariant"]
    name: str
    line: int
    holds: Callable[[Any], bool]
    reads: tuple[str, ...]
    surely: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class Asking:
    """A call pattern in an assumption with goals: port, number of arguments, goal names by argument index."""

    port: str
    arguments: int
    goals: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class Assumption:
    """An assumption about every robot with the module.

    With goals, it must hold for all calls made. `surely`: screening as in Property, for all robots at once."""

    module: str
    line: int
    holds: Callable[..., bool]
    reads: tuple[str, ...]
    goals: tuple[Asking, ...] = ()
    surely: Callable[[Any], Any] | None = None

    def holds_of_calls(self, known: Known) -> bool:
        """Return whether it holds for each combination of goals called; true without calls."""
        return all(self.holds(known, **goals) for goals in _asked_for(self.goals, known.asked, {}))

    def asked(self, known: Known) -> bool:
        """Return whether there is any call that it is about."""
        return any(True for _ in _asked_for(self.goals, known.asked, {}))


def _asked_for(patterns: tuple[Asking, ...], asked: Calls, known: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if not patterns:
        yield known
        return
    first, *rest = patterns
    for port, args, _ in asked:
        if port == first.port and len(args) == first.arguments:
            given = {name: args[place] for place, name in first.goals.items()}
            if all(name not in known or known[name] == value for name, value in given.items()):
                yield from _asked_for(tuple(rest), asked, {**known, **given})


@dataclass(frozen=True, slots=True)
class Unchecked:
    """A formula that cannot be evaluated, with the reason."""

    kind: str
    name: str
    line: int
    why: str


@dataclass(frozen=True, slots=True)
class Properties:
    """All properties of a program.

    `fleet` and `step` create the known values for properties and for assumptions, for a fleet of this size. `measured`:
    sensors that measure the vehicle's motion, so a simulator can use the true values."""

    program: Program
    fleet: Callable[[int, Trail | None], Known]
    step: Callable[[int, Trail | None], Known]
    properties: tuple[Property, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    unchecked: tuple[Unchecked, ...] = ()
    measured: tuple[str, ...] = ()


def properties_of(root: Path, program: Program, driven: Collection[str] = ()) -> Properties:
    """Return the properties of the bundle at `root`, from which `program` was imported.

    `driven`: modules served by the user's own drivers. A bundle of a program without properties has no file for
    them."""
    if not (root / "properties.py").is_file():
        return without_properties(program, driven)
    found: Properties = importlib.import_module("properties").PROPERTIES
    return found


def without_properties(program: Program, driven: Collection[str] = ()) -> Properties:
    """Return the properties of a program without any: only `measured` is set."""
    measured = []
    for port in program.ports:
        module, _, name = port.name.partition(".")
        if port.direction == "sensor" and module not in driven and MEASURED.get(name) is port.type:
            measured.append(port.name)
    return Properties(program, Known, Known, measured=tuple(measured))


def judged(holds: Callable[[Known], bool], known: Known) -> tuple[Outcome, str]:
    """Evaluate a formula. Return its verdict, and why it has no value or which value is unknown."""
    begin()
    try:
        return ("held" if holds(known) else "violated"), ""
    except Unknown as unknown:
        return "unknown", str(unknown)
    except Exception as error:  # whatever the user's functions raise
        reason = str(error) or type(error).__name__
        return "no value", reason if len(reason) <= LONGEST else f"{reason[:LONGEST]} ..."
