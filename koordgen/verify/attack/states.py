"""Random states for attacks: draws initial states, new sensor values, and results of planners.

The drawn states are only proposals: the caller checks them against the program's assumptions.

Values that are likely to reveal a mistake are drawn: constants in the program, params, targets in commands, and numbers
next to constants. A seed determines all drawn values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from random import Random
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import clearable, held, positions
from koordgen.lang.ir.ports import ports as named_ports
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, POSE, STRING, MapOf, RecordType, TupleOf, Type
from koordgen.lang.ir.types import Sequence as SequenceType
from koordgen.lang.semantics.builtins import map_of, set_of
from koordgen.lang.semantics.exact import made_exact
from koordgen.lang.semantics.state import Robot, State, Store
from koordgen.lang.semantics.step import initial
from koordgen.lang.semantics.values import RecordValue, Value, default
from koordgen.runtime.values.points import Point, Pose
from koordgen.verify.prove.report.model import exact_state, with_values
from koordgen.verify.prove.report.reach import Pools

VALUES = 16  # number of different values of one type that can be drawn
VARIED = 3  # largest number of changes that make a variation of a state
DRAWS = 6  # attempts to draw the initial sensor values of one robot so that `initially` holds
ARRIVING = 0.4  # probability that the first proposed sensor values place the robot at its goal
MOVES = 5  # number of random proposals of new sensor values for each robot in one step of the environment
BASE = (BOOL, INT, FLOAT, POINT)


def _exact_point(x: int, y: int, z: int) -> Point:
    return Point(Fraction(x), Fraction(y), Fraction(z))  # type: ignore[arg-type]


ELSEWHERE = tuple([_exact_point(*place) for place in ((2, -1, 1), (-3, 4, 0), (9, 9, 0), (-9, 6, 2))])


class States:
    """Source of random states of one Koord program.

    `program`: the program with exact numbers.
    `free`: names of the params that may have any value; all other params have the program's values."""

    def __init__(self, program: decl.Program, free: Iterable[str], random: Random) -> None:
        self.program, self.random = program, random
        self.free = [p for p in program.params if p.name in set(free)]
        ports = [(m, p) for m in program.modules for p in m.ports]
        self.sensors = [(f"{m.name}.{p.name}", p.type) for m, p in ports if p.direction == "sensor"]
        self.types = {name: port.type for name, _, port in named_ports(program)}
        self.held = held(program)
        self.cleared, self.positions = clearable(program), positions(program)
        self.usual: State | None = None
        self.variables = [("local", v.name, v.type) for v in program.locals]
        self.variables += [("slot" if v.kind == "allread" else "cell", v.name, v.type) for v in program.shared]
        self.variables += [
            ("port", f"{m.name}.{p.name}", p.type) for m, p in ports if p.direction in ("sensor", "actuator")
        ]
        self.sensed = {name for name, _ in self.sensors}
        spoken, self.texts = _spoken(program)
        self.pools = Pools((), [*spoken, *ELSEWHERE], VALUES)
        self.pooled: dict[tuple[Type, int], tuple[Mapping[str, Value], list[Value]]] = {}

    # Initial states, before `init`

    def launch(self, robots: int, attempt: int, plausible: Callable[[State], bool]) -> State | None:
        """Draw an initial state (before `init`) that satisfies the predicate `plausible`; None if none is found.

        Robots are added one after another, and the predicate is checked after each robot. In attempt 0, robots are at
        different positions if possible, and params have the program's values."""
        values = {}
        if self.free and attempt % 2:
            bare = self._blank({})
            values = {p.name: self.value(p.type, bare) for p in self.free if self.random.random() < 0.5}
        blank = self._blank(values)
        fleet: list[Robot] = []
        state = blank
        for pid in range(robots):
            for _ in range(DRAWS):
                robot = self._launched(blank, pid, attempt)
                state = _fleet(blank, [*fleet, robot])
                if plausible(state):
                    break
                attempt = max(attempt, 1)
            else:
                return None
            fleet.append(robot)
        return state

    def _blank(self, values: Mapping[str, Value]) -> State:
        """Return the initial state of a single robot, with the given values of params."""
        if values or self.usual is None:
            found = exact_state(initial(with_values(self.program, values), 1))
            if values:
                return found
            self.usual = found
        return self.usual

    def _launched(self, blank: State, pid: int, attempt: int) -> Robot:
        found: dict[str, Value] = {}
        for name, type_ in self.sensors:
            pool: list[Value] = [True] if name in self.cleared else self.pool(type_, blank)
            if pool and attempt == 0:
                found[name] = pool[pid % len(pool)]
            else:
                found[name] = self.random.choice(pool) if pool else self.value(type_, blank)
        for name, sensor in self.held.items():  # draw a value for a sensor that the program does not declare
            found[name] = found[sensor] if sensor in found else self._elsewhere(name, blank, pid, attempt)
        robot = blank.robots[0]
        return robot._replace(ports={**robot.ports, **found})

    def _elsewhere(self, name: str, blank: State, pid: int, attempt: int) -> Value:
        type_ = self.types[name]
        pool = self.pool(type_, blank)
        if not pool:
            return self.value(type_, blank)
        return pool[-1 - pid % len(pool)] if attempt == 0 else self.random.choice(pool)

    # New sensor values for a step of the environment

    def moves(self, now: State, pid: int) -> Iterator[dict[str, Value]]:
        """Propose new sensor values of robot `pid` for a step of the environment.

        The first proposal often places the robot at its goal. The last proposal is the robot's present values."""
        ports = now.robots[pid].ports
        goals = [goal for name, value in ports.items() if name not in self.sensed for goal in _goal(value)]
        if self.random.random() < ARRIVING:
            yield {name: self._arrived(name, type_, goals, ports) for name, type_ in self.sensors}
        for _ in range(MOVES):
            yield {name: self._moved(name, type_, goals, ports, now) for name, type_ in self.sensors}
        yield {name: ports[name] for name, _ in self.sensors}

    def _arrived(self, name: str, type_: Type, goals: list[Point], ports: Mapping[str, Value]) -> Value:
        if type_ == POINT and goals:
            return goals[0]
        return True if name in self.cleared else ports[name]

    def _moved(self, name: str, type_: Type, goals: list[Point], ports: Mapping[str, Value], now: State) -> Value:
        chance = self.random.random()
        if chance < 0.3:
            return ports[name]
        if chance < 0.6 and type_ == POINT and goals:
            goal, place = self.random.choice(goals), ports[name]
            return (place + goal) / 2 if chance < 0.4 and isinstance(place, Point) else goal
        return self.value(type_, now)

    # Variations of a state in a few variables

    def varied(self, state: State) -> State:
        """Return a variation of a state: a few variables get drawn values, or values copied from other variables."""
        for _ in range(self.random.randint(1, VARIED)):
            kind, name, type_ = self.random.choice(self.variables)
            pids = range(len(state.robots))
            chosen = pids if self.random.random() < 0.3 else [self.random.choice(pids)]
            value = self._other(state, self.random.choice(pids), type_)
            for pid in chosen if kind != "cell" else [0]:
                state = _with(state, kind, name, pid, value)
        return state

    def _other(self, state: State, pid: int, type_: Type) -> Value:
        alike = [(kind, name) for kind, name, other in self.variables if other == type_]
        if self.random.random() < 0.4:
            return _of(state, *self.random.choice(alike), pid)
        return self.value(type_, state)

    # Results of port calls

    def answers(self, state: State, pid: int, port: str, args: tuple[Value, ...]) -> Iterator[Value]:
        """Propose results of a planner's call in random order: no path, a straight path, a detour, only the goal."""
        module = port.partition(".")[0]
        position = next((state.robots[pid].ports[n] for n in self.positions if n.partition(".")[0] == module), None)
        goal = next((arg for arg in args if isinstance(arg, Point)), None)
        ways: list[Value] = [()]
        if goal is not None:
            start = (position,) if isinstance(position, Point) else ()
            ways += [(*start, goal), (*start, self.random.choice(ELSEWHERE), goal), (goal,)]
        self.random.shuffle(ways)
        yield from ways

    # Random values of a type

    def pool(self, type_: Type, state: State) -> list[Value]:
        """Return the list of values of a type that can be drawn.

        For a type that is not in BASE, such as a list or a record, the result is empty."""
        if type_ not in BASE:
            return []
        key = type_, len(state.robots)
        known = self.pooled.get(key)
        if known is None or known[0] != state.params:
            known = self.pooled[key] = state.params, self.pools.pool(type_, state)
        return known[1]

    def value(self, type_: Type, state: State) -> Value:
        """Draw a random value of a Koord type."""
        pool = self.pool(type_, state)
        if pool:
            return self.random.choice(pool)
        match type_:
            case _ if type_ == POSE:
                return Pose(self.value(POINT, state), self.value(FLOAT, state))  # type: ignore[arg-type]
            case _ if type_ == STRING:
                return self.random.choice(["", *self.texts])
            case TupleOf(parts):
                return tuple([self.value(part, state) for part in parts])
            case RecordType(name, fields):
                return RecordValue(name, tuple([self.value(part, state) for _, part in fields]))
            case SequenceType(name, element, capacity):
                count = min(self.random.randrange(3), capacity)
                found = tuple([self.value(element, state) for _ in range(count)])
                return set_of(found) if name == "Set" else found
            case MapOf(key, held):
                return map_of((self.value(TupleOf((key, held)), state),) * self.random.randrange(2))
            case _:
                return made_exact(default(type_, {}))  # type: ignore[no-any-return]


def _fleet(blank: State, robots: Sequence[Robot]) -> State:
    """Return the initial state (before `init`) of a fleet of the given robots, with the store of `blank`."""
    count = len(robots)
    slots = {name: values[:1] * count for name, values in blank.store.slots.items()}
    return blank._replace(robots=tuple(robots), store=Store(slots, blank.store.cells))


def _of(state: State, kind: str, name: str, pid: int) -> Value:
    """Return the value of a variable in a state. For a variable that each robot has, return the value of `pid`."""
    if kind == "cell":
        return state.store.cells[name]
    if kind == "slot":
        return state.store.slots[name][pid]
    robot = state.robots[pid]
    return (robot.locals if kind == "local" else robot.ports)[name]


def _with(state: State, kind: str, name: str, pid: int, value: Value) -> State:
    """Return a copy of a state in which one variable has a new value. For an allwrite variable, `pid` is ignored."""
    store = state.store
    if kind == "cell":
        return state._replace(store=Store(store.slots, {**store.cells, name: value}))
    if kind == "slot":
        slots = (*store.slots[name][:pid], value, *store.slots[name][pid + 1 :])
        return state._replace(store=Store({**store.slots, name: slots}, store.cells))
    robot = state.robots[pid]
    changed = (
        robot._replace(locals={**robot.locals, name: value})
        if kind == "local"
        else robot._replace(ports={**robot.ports, name: value})
    )
    return state._replace(robots=(*state.robots[:pid], changed, *state.robots[pid + 1 :]))


def _goal(command: Value) -> list[Point]:
    """Return the goal of a motion command as a list of one Point: the Point itself, or the last Point of a path.

    For any other command, the list is empty."""
    last = command[-1] if isinstance(command, tuple) and command else command
    return [last] if isinstance(last, Point) else []


def _spoken(program: decl.Program) -> tuple[list[Value], list[str]]:
    """Return the constants in a program's text: a list of numbers and Points, and a list of strings.

    For each number n, the list also contains n + 1 and n - 1."""
    numbers: dict[Any, None] = {}
    points: list[Value] = []
    texts: dict[str, None] = {}
    spoken = (program.params, program.functions, program.modules, program.events, program.properties)
    for node in reversed(list(walk(spoken))):  # visit the program's constants from the last to the first
        if isinstance(node, ir.Const):
            if type(node.value) is str:
                texts[node.value] = None
            elif type(node.value) is not bool:
                numbers[node.value] = None
        elif isinstance(node, ir.Builtin) and node.name == "Point":
            parts = [arg.value for arg in node.args if isinstance(arg, ir.Const)]
            points += [Point(*map(Fraction, parts))] if len(parts) == 3 else []  # type: ignore[arg-type]
    beside = [number + 1 for number in numbers] + [number - 1 for number in numbers]
    return [*numbers, *points, *beside], list(texts)
