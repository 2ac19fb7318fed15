"""Run of an example by the executable semantics in a simple world, without processes and clock: seconds for a mission.

Robots move at 1 m/s straight to their targets, lidars see the fleet file's obstacles, rooms cool down.
"""

from __future__ import annotations

import importlib.util
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from random import Random
from typing import Any

from koordgen.build.pipeline import check_file, read_fleet
from koordgen.fleet import manifest
from koordgen.fleet.file import Fleet
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import NoMeaning, Writes
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.step import Step, initial, round_, run_init, sense
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.points import Grid, Point, Scan, distance

EXAMPLES = Path(__file__).parents[2] / "examples"
SPEED, NEAR = 1.0, 0.05  # m/s; metres within which a goal counts as met
RAYS, SIGHT = 180, 6.0  # as the simulator's lidar has them; metres


class Body:
    """State of one robot: position, target, and the temperature of its room."""

    def __init__(self, start: Point, height: float) -> None:
        self.position, self.height = Point(start.x, start.y, height), height
        self.goals: deque[Point] = deque()
        self.temp, self.heating = 15.0, False

    def command(self, ports: dict[str, Any]) -> None:
        for name, value in ports.items():
            match name.split(".")[1]:
                case "target":
                    self.goals = deque([value])
                case "path":
                    self.goals = deque(value)
                case "heat":
                    self.heating = value

    def move(self, seconds: float) -> None:
        """Move the robot: a quad's goals are raised to its flight height, a car stays on the ground."""
        self.temp += seconds * (0.02 * (5.0 - self.temp) + (1.2 if self.heating else 0.0))
        left, here = SPEED * seconds, self.position
        while self.goals and left > 0:
            goal = self.lifted(self.goals[0])
            away = distance(here, goal)
            here = goal if away <= left else here + (goal - here) * (left / away)
            left -= away
            if distance(here, goal) <= NEAR:
                self.goals.popleft()
        self.position = here

    def lifted(self, goal: Point) -> Point:
        return Point(goal.x, goal.y, max(goal.z, self.height) if self.height > 0 else 0.0)


class Stage:
    """A fleet in its world. `step` runs one round, and checks every invariant after it.

    `lines`: output of robots, as (pid, line). `discarded`: faults of events. `skips`: share of missed rounds.
    `params`: replace those of the fleet file.
    """

    def __init__(self, name: str, skips: float = 0.0, fleet: str = "fleet.yaml", **params: Any) -> None:
        folder = EXAMPLES / name
        targets = {target: manifest.load(target) for target in manifest.available()}
        checked = check_file(str(folder / f"{name}.koord")).program
        self.fleet, given = read_fleet(str(folder / fleet), targets, checked)
        self.program = with_params(checked, {**given, **params})
        self.rng, self.skips = Random(name), skips
        self.bodies = list(bodies(self.fleet))
        self.world = World(externs(self.program, folder), self.answer)
        self.lines: list[tuple[int, str]] = []
        self.discarded: list[Step] = []
        before = initial(self.program, len(self.bodies), self.sensors())
        for property_ in self.program.properties:
            assert property_.kind != "initially" or holds_property(property_, self.program, before, self.world)
        self.state, steps = run_init(self.program, before, self.world)
        self.settle(steps)

    def step(self) -> State:
        n_sys = len(self.bodies)
        turn = {lock: (self.state.round + lock) % n_sys for lock in range(len(self.program.locks))}
        skipping = [pid for pid in range(n_sys) if self.rng.random() < self.skips]
        self.state, steps = round_(self.program, self.state, skipping, turn, self.world)
        self.settle(steps)
        return self.state

    def until(self, done: Callable[[State], bool], rounds: int) -> None:
        """Step until a condition holds, within that many rounds."""
        for _ in range(rounds):
            if done(self.step()):
                return
        raise AssertionError(f"not after {rounds} rounds: {self.state}")

    def settle(self, steps: list[Step]) -> None:
        """Apply the robots' commands to the world, and let delta pass."""
        for pid, _, outcome in steps:
            if isinstance(outcome, Writes):
                self.bodies[pid].command(dict(outcome.ports))
                self.lines += [(pid, line) for _, line in outcome.streams]
        self.discarded += [step for step in steps if isinstance(step.outcome, Discarded)]
        self.hold("after the program's step")
        for body in self.bodies:
            body.move(self.fleet.delta)
        self.state = sense(self.state, self.sensors())
        self.hold("after the environment's step")

    def hold(self, when: str) -> None:
        for property_ in self.program.properties:
            if property_.kind != "invariant":
                continue
            try:
                held = holds_property(property_, self.program, self.state, self.world)
            except NoMeaning:  # it speaks of a spec fun, of which only proofs know
                continue
            assert held, f"{property_.name} does not hold {when} of round {self.state.round - 1}: {self.state}"

    def sensors(self) -> list[dict[str, Value]]:
        wanted = [(m.name, p.name) for m in self.program.modules for p in m.ports if p.direction == "sensor"]
        return [{f"{module}.{port}": self.sensed(body, port) for module, port in wanted} for body in self.bodies]

    def sensed(self, body: Body, port: str) -> Value:
        match port:
            case "position":
                return body.position
            case "reached":
                return not body.goals
            case "temp":
                return body.temp
            case "pscan":
                return ((body.position, scan(body.position, self.fleet)),)
        raise AssertionError(f"nothing senses {port}")

    def answer(self, pid: int, port: str, args: tuple[Any, ...]) -> tuple[Point, ...]:
        assert port.endswith(".planner")
        here = self.bodies[pid].position
        if (self.bodies[pid].height > 0) != (args[0].z > 0):
            return ()  # on the ground for a quad, in the air for a car
        return way(here, args[0], args[1]) if len(args) > 1 and args[1] else (here, args[0])


def bodies(fleet: Fleet) -> Iterator[Body]:
    for robot in fleet.robots:
        yield Body(Point(*robot.start["position"]), robot.settings.get("flight_height", 0.0))


def externs(program: Program, folder: Path) -> dict[str, Callable[..., Value]]:
    """Return the program's extern functions, from the file beside it."""
    if not program.externs:
        return {}
    spec = importlib.util.spec_from_file_location(f"{program.name}_functions", folder / f"{program.name}_functions.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def wrapped(function: Callable[..., Any]) -> Callable[..., Value]:
        def called(*args: Value) -> Value:
            result = function(*args)
            return tuple(result) if isinstance(result, list) else result

        return called

    return {extern.name: wrapped(getattr(module, extern.name)) for extern in program.externs}


def way(start: Point, goal: Point, obstacles: Iterable[Grid]) -> tuple[Point, ...]:
    """Return a path over cells that are not beside an occupied cell; [] without a path."""
    taken = {(g.x, g.y) for g in obstacles}
    size = next(iter(obstacles)).size
    blocked = {(x + i, y + j) for x, y in taken for i in (-1, 0, 1) for j in (-1, 0, 1)}
    first, last = (
        (math.floor(start.x / size), math.floor(start.y / size)),
        (math.floor(goal.x / size), math.floor(goal.y / size)),
    )
    came, queue = {first: first}, deque([first])
    while queue and last not in came:
        x, y = queue.popleft()
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if cell not in came and cell not in blocked and max(map(abs, cell)) < 100:
                came[cell] = (x, y)
                queue.append(cell)
    if last not in came:
        return ()
    cells = [last]
    while cells[-1] != first:
        cells.append(came[cells[-1]])
    middles = [Point((x + 0.5) * size, (y + 0.5) * size, 0.0) for x, y in reversed(cells[1:-1])]
    return (start, *middles, goal)


def scan(position: Point, fleet: Fleet) -> Scan:
    angles = tuple([2 * math.pi * k / RAYS for k in range(RAYS)])
    return Scan(angles, tuple([sight(position, angle, fleet) for angle in angles]), SIGHT)


def sight(position: Point, angle: float, fleet: Fleet) -> float:
    """Return the distance (m) to the first obstacle's face along a ray."""
    found = SIGHT
    for box in fleet.obstacles:
        enter, leave = 0.0, found
        for axis, (at, along) in enumerate(((position.x, math.cos(angle)), (position.y, math.sin(angle)))):
            if abs(along) < 1e-12:
                leave = leave if box["lo"][axis] <= at <= box["hi"][axis] else -1.0
                continue
            one, other = sorted(((box["lo"][axis] - at) / along, (box["hi"][axis] - at) / along))
            enter, leave = max(enter, one), min(leave, other)
        if enter < leave:
            found = enter
    return found
