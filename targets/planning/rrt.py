"""The planners that come along: RRT-Connect, the same made short, RRT*, and straight ahead.

The trees are OMPL's (ompl_trees.py); where OMPL has no wheel, they are our own (own_trees.py), without RRT*.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise
from typing import Protocol

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point, distance
from targets.planning import own_trees
from targets.planning.limit import Limit
from targets.planning.room import Room, fixed, room
from targets.planning.world import Path, Planner, Scene, World

TRIES = 8  # at shortening a path, per corner, before another is looked for
ENOUGH = 1.002  # a path so little longer than the straight line is short enough
FLAT = 1e-6  # metres: a lower arena is a plane


class Trees(Protocol):
    """Searches for corners between two places of the arena."""

    def connect(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        """Return the corners between start and goal that RRT-Connect finds; None without a path. `turn` numbers the
        searches of a question: each has random numbers of its own."""
        ...


class Rrt:
    """RRT-Connect's first path."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._standing = fixed(world.obstacles)
        self._low, self._high = _corners(world.arena)
        if not world.flies:
            self._low, self._high = Point(self._low.x, self._low.y, 0.0), Point(self._high.x, self._high.y, 0.0)
        self._flat = self._high.z - self._low.z < FLAT
        self._trees: Trees
        if own_trees.is_needed():
            self._trees = own_trees.OwnTrees(self._low, self._high, self._flat, world.seed)
        else:
            from targets.planning.ompl_trees import OmplTrees

            self._trees = OmplTrees(self._low, self._high, self._flat, world.seed)

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """See Planner."""
        return self.plan_in(room(self._world, self._standing, scene, start), start, goal, seconds)

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path:
        """See InRoom."""
        if here.clear(start, goal):
            return start, goal
        return self._planned(here, start, goal, Limit(seconds, self._world.iterations))

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        return self._connected(here, start, goal, over, 0)

    def _connected(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> Path:
        found = self._trees.connect(here, self._held(start), self._held(goal), over, turn)
        return self._whole(found, here, start, goal)

    def _whole(self, between: list[Point] | None, here: Room, start: Point, goal: Point) -> Path:
        """The path with its ends. A position's noise can put the start outside the arena: from there, the robot may
        come back in."""
        if between is None:
            return ()
        path = (start, *between, goal)
        if not here.clear(path[0], path[1]):
            path = (start, self._held(start), *between, goal)
        return path if here.clear(path[0], path[1]) else ()

    def _holds(self, p: Point) -> bool:
        """Return whether a place is in the arena."""
        low, high = self._low, self._high
        return low.x <= p.x <= high.x and low.y <= p.y <= high.y and low.z <= p.z <= high.z

    def _held(self, p: Point) -> Point:
        """Return the place in the arena that is nearest to a place."""
        low, high = self._low, self._high
        return Point(*(max(a, min(b, v)) for a, b, v in zip(_parts(low), _parts(high), _parts(p), strict=True)))


class RrtSmoothed(Rrt):
    """RRT-Connect's paths, each shortened by random short cuts; the shortest that was found in the time."""

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        dice = random.Random(self._world.seed)
        straight = distance(start, goal)
        best = self._connected(here, start, goal, over, 0)
        if not best:
            return ()
        best = shortened(best, here, dice, over, self._holds)
        turn = 1
        while length(best) > ENOUGH * straight and not over.spent(turn):
            another = self._connected(here, start, goal, over, turn)
            if another:
                best = min(best, shortened(another, here, dice, over, self._holds), key=length)
            turn += 1
        return best


class RrtStar(Rrt):
    """RRT*: goes on improving its tree for as long as there is time. It needs OMPL."""

    def __init__(self, world: World) -> None:
        from targets.planning.ompl_trees import OmplTrees

        super().__init__(world)
        self._improving = OmplTrees(self._low, self._high, self._flat, world.seed)

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        found = self._improving.improve(here, self._held(start), self._held(goal), over)
        return self._whole(found, here, start, goal)


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
    """Return the point at this arc length (metres) of a path, and the index of its segment."""
    for i, part in enumerate(lengths):
        if along <= part and part > 0.0:
            return i, points[i] + (points[i + 1] - points[i]) * (along / part)
        along -= part
    return len(lengths) - 1, points[-1]


def _parts(p: Point) -> tuple[float, float, float]:
    return p.x, p.y, p.z


def _corners(arena: Box) -> tuple[Point, Point]:
    lo, hi = arena.lo, arena.hi
    return (
        Point(min(lo.x, hi.x), min(lo.y, hi.y), min(lo.z, hi.z)),
        Point(max(lo.x, hi.x), max(lo.y, hi.y), max(lo.z, hi.z)),
    )
