"""The planners that come along: RRT-Connect, the same made short, RRT*, and straight ahead.

OMPL samples and grows the trees; whether a straight line is clear is ours, and exact, so a tree's edges need no
padding and are not looked at in steps. Of OMPL's Python binding only these calls are relied on (version 2.0.1, where
out-parameters stay empty; a test holds that they work): `RealVectorStateSpace`, `RealVectorBounds.setLow/setHigh`,
`setBounds`, `allocState`, states' `[i]`, `SpaceInformation` with `setStateValidityChecker`, `setMotionValidator` and
`setup`, `MotionValidator` as a base class, `ProblemDefinition.setStartAndGoalStates/hasExactSolution/getSolutionPath`,
`RRTConnect`, `RRTstar`, `setProblemDefinition`, `setup`, `solve`, `PlannerTerminationCondition` of a callable,
`getStateCount`, `getState`, `RNG.setSeed`, `setLogLevel`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from ompl import base, geometric, util

from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point, distance
from targets.planning.limit import STARTS, Limit
from targets.planning.room import Room, fixed, room
from targets.planning.world import Path, Planner, Scene, World

TRIES = 8  # at shortening a path, per corner, before another is looked for
ENOUGH = 1.002  # a path so little longer than the straight line is short enough
FLAT = 1e-6  # metres: a lower arena is a plane


class Rrt:
    """RRT-Connect's first path."""

    def __init__(self, world: World) -> None:
        util.setLogLevel(util.LogLevel.LOG_NONE)
        self._world = world
        self._standing = fixed(world.obstacles)
        self._low, self._high = _corners(world.arena)
        if not world.flies:
            self._low, self._high = Point(self._low.x, self._low.y, 0.0), Point(self._high.x, self._high.y, 0.0)
        self._flat = self._high.z - self._low.z < FLAT
        self._space = base.RealVectorStateSpace(2 if self._flat else 3)
        bounds = base.RealVectorBounds(2 if self._flat else 3)
        for axis in range(2 if self._flat else 3):
            bounds.setLow(axis, getattr(self._low, "xyz"[axis]))
            bounds.setHigh(axis, getattr(self._high, "xyz"[axis]))
        self._space.setBounds(bounds)

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """See Planner."""
        return self.plan_in(room(self._world, self._standing, scene, start), start, goal, seconds)

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path:
        """See InRoom."""
        if here.clear(start, goal):
            return start, goal
        return self._planned(here, start, goal, Limit(seconds, self._world.iterations))

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        return self._search(geometric.RRTConnect, here, start, goal, over, 0)

    def _search(self, kind: Any, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> Path:
        """What one of OMPL's planners finds. `turn` numbers the searches of a question: each has random numbers of its
        own."""
        if self._world.seed is not None:
            util.RNG.setSeed(self._world.seed * STARTS + turn + 1)
        information = base.SpaceInformation(self._space)
        information.setStateValidityChecker(lambda state: True)  # the ends of every line are looked at with the line
        validator = _Lines(information, here, self._point)
        information.setMotionValidator(validator)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.setStartAndGoalStates(self._state(start), self._state(goal))
        planner = kind(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(over))
        if not problem.hasExactSolution():
            return ()
        found = problem.getSolutionPath()
        between = [self._point(found.getState(i)) for i in range(1, found.getStateCount() - 1)]
        path = (start, *between, goal)
        if not here.clear(path[0], path[1]):  # a start outside the arena was moved into it for the search
            path = (start, self._point(self._state(start)), *between, goal)
        return path if here.clear(path[0], path[1]) else ()

    def _point(self, state: Any) -> Point:
        return Point(state[0], state[1], self._low.z if self._flat else state[2])

    def _holds(self, p: Point) -> bool:
        """Whether a place is in the arena."""
        low, high = self._low, self._high
        return low.x <= p.x <= high.x and low.y <= p.y <= high.y and low.z <= p.z <= high.z

    def _state(self, p: Point) -> Any:
        """A position's noise can put the start outside: from there, the robot may come back in."""
        state = self._space.allocState()
        for axis in range(2 if self._flat else 3):
            name = "xyz"[axis]
            state[axis] = max(getattr(self._low, name), min(getattr(self._high, name), getattr(p, name)))
        return state


class RrtSmoothed(Rrt):
    """RRT-Connect's paths, each shortened by random short cuts; the shortest that was found in the time."""

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        dice = random.Random(self._world.seed)
        straight = distance(start, goal)
        best = self._search(geometric.RRTConnect, here, start, goal, over, 0)
        if not best:
            return ()
        best = shortened(best, here, dice, over, self._holds)
        turn = 1
        while length(best) > ENOUGH * straight and not over.spent(turn):
            another = self._search(geometric.RRTConnect, here, start, goal, over, turn)
            if another:
                best = min(best, shortened(another, here, dice, over, self._holds), key=length)
            turn += 1
        return best


class RrtStar(Rrt):
    """RRT*: goes on improving its tree for as long as there is time."""

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        return self._search(geometric.RRTstar, here, start, goal, over, 0)


class Straight:
    """The straight line when it is clear, and nothing else."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._standing = fixed(world.obstacles)

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """See Planner."""
        return self.plan_in(room(self._world, self._standing, scene, start), start, goal, seconds)

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path:
        """See InRoom."""
        return (start, goal) if here.clear(start, goal) else ()


PLANNERS: dict[str, Callable[[World], Planner]] = {
    "rrt": Rrt,
    "rrt-smoothed": RrtSmoothed,
    "rrt-star": RrtStar,
    "straight": Straight,
}


def length(path: Path) -> float:
    return sum(distance(p, q) for p, q in pairwise(path))


def shortened(path: Path, here: Room, dice: random.Random, over: Limit, holds: Callable[[Point], bool]) -> Path:
    """The path with corners left out and cut off, as far as the lines instead are clear. Every place of it but the
    start is held by a convex arena; where the start is not, its line into the arena gets no new corner outside."""
    points = _reduced(list(path), here)
    for _ in range(TRIES * len(points)):
        if len(points) < 3 or over.late:
            break
        lengths = [distance(p, q) for p, q in pairwise(points)]
        whole = sum(lengths)
        ends = sorted(dice.uniform(0.0, whole) for _ in range(2))
        (i, p), (j, q) = (_at(points, lengths, along) for along in ends)
        if i < j and holds(p) and here.clear(p, q):
            points = _reduced([*points[: i + 1], p, q, *points[j + 1 :]], here)
    return tuple(points)


def _reduced(points: list[Point], here: Room) -> list[Point]:
    """Without the corners that the straight line between their neighbours makes needless."""
    i = 1
    while i < len(points) - 1:
        if here.clear(points[i - 1], points[i + 1]):
            del points[i]
            i = max(1, i - 1)
        else:
            i += 1
    return points


def _at(points: list[Point], lengths: list[float], along: float) -> tuple[int, Point]:
    """The place so many metres along a path, and which of its parts it is on."""
    for i, part in enumerate(lengths):
        if along <= part and part > 0.0:
            return i, points[i] + (points[i + 1] - points[i]) * (along / part)
        along -= part
    return len(lengths) - 1, points[-1]


class _Lines(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, here: Room, point: Callable[[Any], Point]) -> None:
        super().__init__(information)
        self._here, self._point = here, point

    def checkMotion(self, a: Any, b: Any) -> bool:  # OMPL's name
        return self._here.clear(self._point(a), self._point(b))


def _corners(arena: Box) -> tuple[Point, Point]:
    lo, hi = arena.lo, arena.hi
    return (
        Point(min(lo.x, hi.x), min(lo.y, hi.y), min(lo.z, hi.z)),
        Point(max(lo.x, hi.x), max(lo.y, hi.y), max(lo.z, hi.z)),
    )
