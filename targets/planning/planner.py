"""Plans straight-line paths in a plane around obstacles: what the callable port `planner` answers.

OMPL's RRT-Connect finds a way and its simplifier shortens it. Collision is ours: squares in bins, exact, because the
validity of thousands of states is asked for within milliseconds. Of OMPL's Python binding only the calls below are
relied on (version 2.0.1 leaves out-parameters empty).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from koordgen.runtime.settings import Box
from koordgen.runtime.values import Grid, Point

SECONDS = 0.006  # for the search; a planner call has 10 ms
COARSE, CHECKED = 0.04, 0.01  # metres between the places looked at in the search, and of a path that was found
PAD = 0.01  # metres kept more than asked for in the search, so that the finer look seldom refuses a path


class Square(NamedTuple):
    """An obstacle seen from above, metres, local ENU; a point is a square without extent."""

    west: float
    south: float
    east: float
    north: float

    def distance(self, x: float, y: float) -> float:
        """How far a place is from it; 0 inside."""
        return math.hypot(max(self.west - x, 0.0, x - self.east), max(self.south - y, 0.0, y - self.north))


class Obstacles:
    """Squares to be kept away from by `clearance` metres. What stands nearer than that to `start` already is kept at
    the distance it has: a robot may leave a tight place."""

    def __init__(self, given: Iterable[Grid | Point], clearance: float, start: Point) -> None:
        self._bins: dict[tuple[int, int], list[tuple[Square, float]]] = {}
        self._size = max(clearance, 0.05)
        for square in map(_square, given):
            kept = min(clearance, 0.95 * square.distance(start.x, start.y) - PAD)
            for place in self._touched(square, kept + PAD):
                self._bins.setdefault(place, []).append((square, kept))

    def _touched(self, square: Square, kept: float) -> Iterator[tuple[int, int]]:
        west, east = self._bin(square.west - kept), self._bin(square.east + kept)
        south, north = self._bin(square.south - kept), self._bin(square.north + kept)
        return ((i, j) for i in range(west, east + 1) for j in range(south, north + 1))

    def _bin(self, along: float) -> int:
        return math.floor(along / self._size)

    def clear(self, x: float, y: float, pad: float = 0.0) -> bool:
        """Whether a place keeps its distance, and `pad` metres more, from all of them."""
        for square, kept in self._bins.get((math.floor(x / self._size), math.floor(y / self._size)), ()):
            if square.distance(x, y) < kept + pad:
                return False
        return True

    def clear_line(self, a: Point, b: Point) -> bool:
        """Whether every place of a straight line does, looked at each centimetre."""
        steps = max(1, math.ceil(math.hypot(b.x - a.x, b.y - a.y) / CHECKED))
        return all(self.clear(a.x + (b.x - a.x) * i / steps, a.y + (b.y - a.y) * i / steps) for i in range(steps + 1))


class Planner:
    """Plans for one robot inside the geofence, at least `clearance` metres from obstacles."""

    def __init__(self, fence: Box, clearance: float) -> None:
        from ompl import base, geometric, util

        util.setLogLevel(util.LogLevel.LOG_ERROR)
        self._clearance = clearance
        self._geometric = geometric
        self._space = base.RealVectorStateSpace(2)
        bounds = base.RealVectorBounds(2)
        self._area = Square(
            min(fence.lo.x, fence.hi.x), min(fence.lo.y, fence.hi.y),
            max(fence.lo.x, fence.hi.x), max(fence.lo.y, fence.hi.y),
        )  # fmt: skip
        for axis, (low, high) in enumerate(((self._area.west, self._area.east), (self._area.south, self._area.north))):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        self._space.setBounds(bounds)

    def plan(self, start: Point, goal: Point, obstacles: Sequence[Grid | Point] = ()) -> tuple[Point, ...]:
        """From `start` to `goal`, both included, straight from each point to the next; () when no way was found. Only
        x and y of the way between are planned: every point but the first has the goal's z."""
        if self._area.distance(goal.x, goal.y) > 0.0 or not all(map(math.isfinite, (goal.x, goal.y, goal.z))):
            return ()
        inside = Obstacles(obstacles, self._clearance, start)
        if inside.clear_line(start, goal):
            return (start, goal)
        if not inside.clear(goal.x, goal.y, PAD):
            return ()
        found = [start, *(Point(x, y, goal.z) for x, y in self._search(inside, start, goal)[1:-1]), goal]
        return tuple(found) if len(found) > 2 and all(inside.clear_line(a, b) for a, b in pairwise(found)) else ()

    def _search(self, inside: Obstacles, start: Point, goal: Point) -> list[tuple[float, float]]:
        setup = self._geometric.SimpleSetup(self._space)
        setup.setStateValidityChecker(lambda state: inside.clear(state[0], state[1], PAD))
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(COARSE / self._space.getMaximumExtent())
        setup.setStartAndGoalStates(self._state(start), self._state(goal))
        setup.setPlanner(self._geometric.RRTConnect(information))
        if not setup.solve(SECONDS) or not setup.haveExactSolutionPath():
            return []
        setup.simplifySolution(SECONDS / 2)
        path = setup.getSolutionPath()
        return [(path.getState(i)[0], path.getState(i)[1]) for i in range(path.getStateCount())]

    def _state(self, p: Point) -> Any:
        state = self._space.allocState()
        # A position's noise can put it outside: from there, the robot may come back in.
        state[0] = max(self._area.west, min(self._area.east, p.x))
        state[1] = max(self._area.south, min(self._area.north, p.y))
        return state


def _square(obstacle: Grid | Point) -> Square:
    if isinstance(obstacle, Point):
        return Square(obstacle.x, obstacle.y, obstacle.x, obstacle.y)
    west, south = obstacle.x * obstacle.size, obstacle.y * obstacle.size
    return Square(west, south, west + obstacle.size, south + obstacle.size)
