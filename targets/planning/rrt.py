"""Built-in planners: RRT-Connect, RRT-Connect with shortened paths, RRT*, and the straight line.

OMPL grows the trees (ompl_trees.py). If OMPL has no wheel for this Python, own_trees.py grows them, without RRT*.
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

TRIES = 8  # number of random short cuts that are tried for each point of a path, before another path is searched for
ENOUGH = 1.002  # no shorter path is searched for if the path's length is at most this times the straight line's
FLAT = 1e-6  # metres; paths in an arena of less height are planned in a plane


class Trees(Protocol):
    """Interface of a tree search for a path between two places of the arena."""

    def connect(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        """Return the corners of a path that RRT-Connect finds; None if it finds no path.

        `turn`: number of the search within a question; each search has its own random numbers."""
        ...


class Rrt:
    """Planner that returns the first path that RRT-Connect finds."""

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
        """Return a path from `start` to `goal` for a Scene; () if none is found within `seconds`."""
        return self.plan_in(room(self._world, self._standing, scene, start), start, goal, seconds)

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path:
        """Return a path from `start` to `goal` through a prepared Room; () if none is found in time."""
        if here.clear(start, goal):
            return start, goal
        return self._planned(here, start, goal, Limit(seconds, self._world.iterations))

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        return self._connected(here, start, goal, over, 0)

    def _connected(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> Path:
        found = self._trees.connect(here, self._held(start), self._held(goal), over, turn)
        return self._whole(found, here, start, goal)

    def _whole(self, between: list[Point] | None, here: Room, start: Point, goal: Point) -> Path:
        """Return the path with start and goal added to its corners; () if no corners were found.

        Return () also if the path is not clear.

        Position noise can put the start outside the arena. If the direct line to the first corner is then not clear,
        the path enters the arena at the place nearest to the start."""
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
        """Return the place in the arena that is nearest to `p`."""
        low, high = self._low, self._high
        return Point(*(max(a, min(b, v)) for a, b, v in zip(_parts(low), _parts(high), _parts(p), strict=True)))


class RrtSmoothed(Rrt):
    """Planner that shortens the paths of RRT-Connect by random short cuts.

    It searches for paths until its time is over, and returns the shortest path."""

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
    """Planner with RRT*, which improves its tree until the time is over. RRT* needs OMPL."""

    def __init__(self, world: World) -> None:
        from targets.planning.ompl_trees import OmplTrees

        super().__init__(world)
        self._improving = OmplTrees(self._low, self._high, self._flat, world.seed)

    def _planned(self, here: Room, start: Point, goal: Point, over: Limit) -> Path:
        found = self._improving.improve(here, self._held(start), self._held(goal), over)
        return self._whole(found, here, start, goal)


class Straight:
    """Planner that returns the straight line if it is clear, else no path."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._standing = fixed(world.obstacles)

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """Return the straight line from `start` to `goal`; () if the line is not clear."""
        return self.plan_in(room(self._world, self._standing, scene, start), start, goal, seconds)

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path:
        """Return the straight line through a prepared Room; () if the line is not clear."""
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
    """Return the path shortened by clear short cuts, which remove corners or cut them off.

    `holds`: returns whether a place is in the arena. The arena is convex, so short cuts stay in the arena. The start
    may be outside; no new corner is placed on the part of the path that is outside."""
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
    """Remove each corner whose neighbours have a clear straight line between them."""
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
