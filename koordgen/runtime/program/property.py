"""Classes that a generated `properties.py` uses to evaluate the properties of a program on values of one time.

The caller provides the values. The simulator provides the true values. A monitor on a robot provides the values that
the robot knows, and UNKNOWN for every other value. A property that depends on an unknown value is "unknown", never
"held"."""

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
LONGEST = 300  # largest number of characters in the reason for a verdict; longer reasons are cut

# Sensors whose true values a simulator knows, with their types. Only the robot knows the values of other sensors.
MEASURED = {"position": Point, "velocity": Point, "pose": Pose}


class _Unknown:
    def __repr__(self) -> str:
        return "unknown"


UNKNOWN: Final = _Unknown()


class Unknown(Exception):
    """Raised when a formula reads an unknown value. The message names the value.

    `robot`: pid of the robot that knows the value; -1 if it belongs to no robot."""

    def __init__(self, what: str, robot: int = -1) -> None:
        super().__init__(what)
        self.robot = robot


class BoundName(NamedTuple):
    """Value of a name that a quantifier binds. `robot`: True if the value is a robot's pid."""

    name: str
    value: Any
    robot: bool


class Read(NamedTuple):
    """Value that a formula read. `robot`: pid of the robot that owns the value; None for an allwrite variable."""

    name: str
    robot: int | None
    value: Any


Trail = list[BoundName | Read]


class Each(Generic[T]):
    """Port, local variable or allread variable with one value for each robot.

    The caller sets `values`, in the order of the robots' pids."""

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
        """Values of all robots, in the order of their pids."""
        return tuple([self[robot] for robot in range(len(self.values))])


class One(Generic[T]):
    """Allwrite variable; in an assumption, a port of the robot that the assumption is about."""

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
    """Known values at one time, under the names that they have in the program.

    For an assumption, the values are the ports of one robot, and a primed name is the value after the step. `pid`: this
    robot, or the robot that knows the values; -1 if the values are not one robot's knowledge. `trail`: explains why a
    formula was false. It lists the values of quantified names, the outermost first, and the values that were read."""

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
        """Set values (name -> value). A name that no formula reads is ignored."""
        for name, value in values.items():
            if name in self.each:
                self.each[name].values = value
            elif name in self.one:
                self.one[name].content = value

    def copy_from(self, other: Known) -> None:
        """Copy all values from another Known."""
        self.pid, self.asked = other.pid, other.asked
        self.put({name: each.values for name, each in other.each.items()})
        self.put({name: one.content for name, one in other.one.items()})

    def answer(self, port: str, args: tuple[Any, ...]) -> Any:
        """Return the recorded answer of a callable port. Raises Unknown if no recorded call has these arguments."""
        for name, given, answer in self.asked:
            if name == port and given == args:
                return answer
        raise Unknown(f"{port}: not called with these arguments")

    def every(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """Evaluate a forall over `domain`: False if `body` is false for a value, otherwise True.

        Raises Unknown if `body` is unknown for some values and true for all others."""
        trail, unknown, mark = self._trail, None, 0
        for value in domain:
            if trail is not None:
                mark = len(trail)
            try:
                if not body(value):
                    if trail is not None:
                        trail.insert(mark, BoundName(name, value, robots))
                    return False
            except Unknown as found:
                unknown = unknown or found
            if trail is not None:
                del trail[mark:]
        if unknown is not None:
            raise unknown
        return True

    def own(self, name: str, body: Callable[[int], bool]) -> bool:
        """Evaluate a forall over all robots on the robot `pid`, which knows only its own values.

        Raises Unknown if `body` is true for this robot and the fleet has other robots, whose values are unknown. If no
        single robot knows the values (`pid` -1), `body` is evaluated for all robots."""
        if self.pid < 0 or self.n_sys == 1:
            return self.every(name, range(self.n_sys), body)
        if self.every(name, (self.pid,), body):
            raise Unknown(f"{name}: values of the other robots")
        return False

    def some(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """Evaluate an exists over `domain`: True if `body` is true for a value, otherwise False.

        Raises Unknown if `body` is unknown for some values and false for all others."""
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
    """Invariant or `initially` property of a program, or guarantee of a variable that it exports.

    `reads`: names of the ports, local variables and shared variables that the formula reads. A guarantee also reads the
    variable's value after a write, under the variable's name with a prime. `screening`: a vectorised sufficient
    condition on arrays of many observations; None if the property has none."""

    kind: Literal["initially", "invariant", "guarantee"]
    name: str
    line: int
    holds: Callable[[Any], bool]
    reads: tuple[str, ...]
    screening: Callable[[Any], Any] | None = None

    @property
    def is_step(self) -> bool:
        """True of a guarantee that compares the values before and after a write."""
        return self.kind == "guarantee" and any(name.endswith("'") for name in self.reads)


@dataclass(frozen=True, slots=True)
class GoalCall:
    """Pattern of a call in an assumption with goals.

    `port`: name of the callable port. `arguments`: number of arguments. `goals`: index of an argument -> name of the
    goal."""

    port: str
    arguments: int
    goals: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class Assumption:
    """Assumption about the ports of a module, for every robot that has the module.

    An assumption with `goals` must hold for all recorded calls. `screening`: a vectorised sufficient condition on
    arrays for all robots; None if the assumption has none."""

    module: str
    line: int
    holds: Callable[..., bool]
    reads: tuple[str, ...]
    goals: tuple[GoalCall, ...] = ()
    screening: Callable[[Any], Any] | None = None

    def holds_of_calls(self, known: Known) -> bool:
        """Return whether the assumption holds for each combination of recorded calls; True without calls."""
        return all(self.holds(known, **goals) for goals in _asked_for(self.goals, known.asked, {}))

    def asked(self, known: Known) -> bool:
        """Return whether the assumption applies to at least one combination of recorded calls."""
        return any(True for _ in _asked_for(self.goals, known.asked, {}))


def _asked_for(patterns: tuple[GoalCall, ...], asked: Calls, known: dict[str, Any]) -> Iterator[dict[str, Any]]:
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
    """Formula of a program that cannot be evaluated, with the reason `why`."""

    kind: str
    name: str
    line: int
    why: str


@dataclass(frozen=True, slots=True)
class Properties:
    """All properties of a program.

    `fleet`, `step`: create the Known that properties and assumptions are evaluated on, from the number of robots and a
    trail. `measured`: sensors that measure the vehicle's motion; a simulator can replace their values by true values.
    """

    program: Program
    fleet: Callable[[int, Trail | None], Known]
    step: Callable[[int, Trail | None], Known]
    properties: tuple[Property, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    unchecked: tuple[Unchecked, ...] = ()
    measured: tuple[str, ...] = ()


def properties_of(root: Path, program: Program, driven: Collection[str] = ()) -> Properties:
    """Return the properties of the program in the bundle at `root`, from which `program` was imported.

    If the program has no properties, the bundle has no file properties.py. `driven`: modules that the user's drivers
    serve."""
    if not (root / "properties.py").is_file():
        return without_properties(program, driven)
    found: Properties = importlib.import_module("properties").PROPERTIES
    return found


def without_properties(program: Program, driven: Collection[str] = ()) -> Properties:
    """Return a Properties for a program without properties, in which only `measured` is set."""
    measured = []
    for port in program.ports:
        module, _, name = port.name.partition(".")
        if port.direction == "sensor" and module not in driven and MEASURED.get(name) is port.type:
            measured.append(port.name)
    return Properties(program, Known, Known, measured=tuple(measured))


def judged(holds: Callable[[Known], bool], known: Known) -> tuple[Outcome, str]:
    """Evaluate a formula on known values. Return the verdict and its reason.

    The reason explains why the formula has no value, or names the unknown value; otherwise it is ""."""
    begin()
    try:
        return ("held" if holds(known) else "violated"), ""
    except Unknown as unknown:
        return "unknown", str(unknown)
    except Exception as error:  # the user's functions may raise any exception
        reason = str(error) or type(error).__name__
        return "no value", reason if len(reason) <= LONGEST else f"{reason[:LONGEST]} ..."
