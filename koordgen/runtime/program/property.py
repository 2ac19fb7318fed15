"""What a generated `properties.py` builds on: a program's properties over what is known of a fleet at one moment.

Where the values come from is the affair of whoever asks: the simulator puts in the truth, a monitor on a robot what it
has heard. What is not known is UNKNOWN, and a property that cannot be told without it is "unknown", never held.
"""

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
# Sensors of a body that a harness can measure itself, by their types; what else there is the robot says.
MEASURED = {"position": Point, "velocity": Point, "pose": Pose}


class _Unknown:
    def __repr__(self) -> str:
        return "unknown"


UNKNOWN: Final = _Unknown()


class Unknown(Exception):
    """A value that is not known was asked for; the message names it, `robot` is whose it is, -1 of nobody's."""

    def __init__(self, what: str, robot: int = -1) -> None:
        super().__init__(what)
        self.robot = robot


class Bound(NamedTuple):
    """What a quantified name stood for; `robot` tells whether that is a robot's pid."""

    name: str
    value: Any
    robot: bool


class Read(NamedTuple):
    """A value that was read; `robot` is whose it is, None of an allwrite variable."""

    name: str
    robot: int | None
    value: Any


Trail = list[Bound | Read]


class Each(Generic[T]):
    """A port, a local variable or an allread variable of every robot, by pid. `values` are put in by whoever asks."""

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
        """Every robot's, by pid."""
        return tuple([self[robot] for robot in range(len(self.values))])


class One(Generic[T]):
    """An allwrite variable; in an assumption, a port of the robot that it is about."""

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
    """What is known at one moment: by its name in the program everything that a formula reads, of an assumption its
    one robot's ports, those of the moment after with a prime behind; `pid` is that robot's, or whose knowledge it is
    (-1: nobody's alone). With a trail it is told what a formula came to: the names that made it false, outermost first,
    and the values read for them."""

    def __init__(self, n_sys: int, trail: Trail | None = None) -> None:
        self.n_sys = n_sys
        self.pid = -1
        self.asked: Calls = ()  # of callable ports, in the step that an assumption is about
        self.each: dict[str, Each[Any]] = {}
        self.one: dict[str, One[Any]] = {}
        self._trail = trail

    def of_each(self, name: str) -> Each[Any]:
        return self.each.setdefault(name, Each(name, self._trail))

    def of_one(self, name: str) -> One[Any]:
        return self.one.setdefault(name, One(name, self._trail))

    def put(self, values: Mapping[str, Any]) -> None:
        """Take values by their names; what no formula reads is left."""
        for name, value in values.items():
            if name in self.each:
                self.each[name].values = value
            elif name in self.one:
                self.one[name].content = value

    def take(self, other: Known) -> None:
        """Know all that another does."""
        self.pid, self.asked = other.pid, other.asked
        self.put({name: each.values for name, each in other.each.items()})
        self.put({name: one.content for name, one in other.one.items()})

    def answer(self, port: str, args: tuple[Any, ...]) -> Any:
        """What a callable port has answered. Raises Unknown where it was not asked."""
        for name, given, answer in self.asked:
            if name == port and given == args:
                return answer
        raise Unknown(f"{port}: nobody asked it that")

    def every(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """forall: false for the first that it is false for; unknown where it is for any, and false for none."""
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
        """forall over robots, of which who knows one alone (`pid`) can tell nothing but for that one."""
        if self.pid < 0 or self.n_sys == 1:
            return self.every(name, range(self.n_sys), body)
        if self.every(name, (self.pid,), body):
            raise Unknown(f"{name}: what the other robots know")
        return False

    def some(self, name: str, domain: Iterable[T], body: Callable[[T], bool], robots: bool = True) -> bool:
        """exists: true for the first that it is true for."""
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
    """`reads`: the names of ports, locals and shared variables in its formula. `surely`: a condition over arrays that
    is enough for it at many moments, for who evaluates it often; None when it has none."""

    kind: Literal["initially", "invariant"]
    name: str
    line: int
    holds: Callable[[Any], bool]
    reads: tuple[str, ...]
    surely: Callable[[Any], Any] | None = None


@dataclass(frozen=True, slots=True)
class Asking:
    """A call in an assumption to which goals are handed: the port, how many arguments, the goals' names by place."""

    port: str
    arguments: int
    goals: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class Assumption:
    """Of every robot with the module; with goals, it holds of all calls that were made. `surely` as of a Property, for
    all robots at once."""

    module: str
    line: int
    holds: Callable[..., bool]
    reads: tuple[str, ...]
    goals: tuple[Asking, ...] = ()
    surely: Callable[[Any], Any] | None = None

    def holds_of_calls(self, known: Known) -> bool:
        """Whether it holds of each combination of goals that was asked for; where none was, it does."""
        return all(self.holds(known, **goals) for goals in _asked_for(self.goals, known.asked, {}))

    def asked(self, known: Known) -> bool:
        """Whether there is anything that it says something of."""
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
    """A formula that cannot be evaluated, and why."""

    kind: str
    name: str
    line: int
    why: str


@dataclass(frozen=True, slots=True)
class Properties:
    """All of a program. `fleet` and `step` make what its properties and its assumptions are evaluated on, for a fleet
    of so many robots. `measured`: the sensors that tell of the body's motion, so that whoever has the truth need not
    ask the robot."""

    program: Program
    fleet: Callable[[int, Trail | None], Known]
    step: Callable[[int, Trail | None], Known]
    properties: tuple[Property, ...] = ()
    assumptions: tuple[Assumption, ...] = ()
    unchecked: tuple[Unchecked, ...] = ()
    measured: tuple[str, ...] = ()


def properties_of(root: Path, program: Program, driven: Collection[str] = ()) -> Properties:
    """Return the properties of the bundle at `root`, from which `program` was imported. `driven` are the modules that
    drivers of the user's own serve. A bundle has no file for properties where its program has none."""
    if not (root / "properties.py").is_file():
        return without_properties(program, driven)
    found: Properties = importlib.import_module("properties").PROPERTIES
    return found


def without_properties(program: Program, driven: Collection[str] = ()) -> Properties:
    """Return what there is to tell of a program that has no properties: which sensors are `measured`."""
    measured = []
    for port in program.ports:
        module, _, name = port.name.partition(".")
        if port.direction == "sensor" and module not in driven and MEASURED.get(name) is port.type:
            measured.append(port.name)
    return Properties(program, Known, Known, measured=tuple(measured))


def judged(holds: Callable[[Known], bool], known: Known) -> tuple[Outcome, str]:
    """What a formula comes to, and why it has no value or which one is not known."""
    begin()
    try:
        return ("held" if holds(known) else "violated"), ""
    except Unknown as unknown:
        return "unknown", str(unknown)
    except Exception as error:  # of whatever the user's functions raise
        reason = str(error) or type(error).__name__
        return "no value", reason if len(reason) <= LONGEST else f"{reason[:LONGEST]} ..."
