"""Anytime search for paths that a car can drive: a single curve, or a lattice's path that short cuts make cheaper.

`Search.paths` does its work in small units. Their sequence depends on the task alone; a time limit only ends it. So a
larger time limit finds every path that a smaller one finds, and its answer costs at most as much.

OMPL measures the lengths of curves and grows the trees of RRT* (`ompl_space.py`). `curves.py` computes the curves, and
`ground.py` checks them for collisions. On a Python without a wheel of OMPL, `curves.py` also measures lengths, more
slowly.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

from targets.car.planning.curves import Curve, Piece, Triple, dubins, reeds_shepp
from targets.car.planning.field import Field
from targets.car.planning.ground import PAD, Terrain
from targets.car.planning.lattice import Lattice, SearchGoal
from targets.car.planning.planner import Area, Point2, price
from targets.planning import own_trees
from targets.planning.limit import Limit

if TYPE_CHECKING:
    from targets.car.planning.ompl_space import OmplSpace

HEADINGS = 24  # number of evenly spaced headings that are tried at the goal
DETOUR = 1.6  # a single curve longer than this times the shortest curve, plus a full circle, is not tried
WAITS = 4.0, 1.5  # `wait` of the two lattices, in turning radii
ALONE = 40  # batches of the first lattice before both lattices alternate
UNIT = 8  # short cuts tried in one unit of work
TRIES = 150  # unsuccessful short cuts of one path in a row, after which the search for other paths goes on
WORTH = 1.3  # a path that costs more than this times the cheapest one of a lattice is not shortened
SHOTS = 3  # maximum number of curves to the goal that are tried from one pose of a lattice
LEAST_CUT = 0.1  # metres; a shorter stretch of a path is not replaced by a short cut
GAIN = 1e-3  # metres by which a short cut must lower the price
FORWARDS = 0.3  # share of the short cuts that are tried without reverse gear, because they may be cheaper


@dataclass(frozen=True, slots=True)
class Task:
    """One task for a search: a path from `start` to `goal` that ends at one of the `headings` (rad).

    `gear`: direction in which the car rolls at the start (1 forward, -1 reverse, 0: it stands)."""

    start: Triple
    goal: Point2
    headings: tuple[float, ...]
    gear: int = 0


class Space:
    """Poses of a car and the shortest curves between them, with the reverse gear if `reverse`."""

    def __init__(self, radius: float, reverse: bool, area: Area) -> None:
        self.radius, self.reverse = radius, reverse
        self.ompl = _ompl_space(radius, reverse, area)
        self._solve: Callable[[Triple, Triple, float, float | None], Curve] = reeds_shepp if reverse else dubins

    def distance(self, a: Triple, b: Triple) -> float:
        """Return the length (m) of the shortest curve from one pose to another."""
        return self._solve(a, b, self.radius, None).length if self.ompl is None else self.ompl.distance(a, b)

    def curve(self, a: Triple, b: Triple, length: float | None = None) -> Curve:
        if length is None and self.ompl is not None:
            length = self.ompl.distance(a, b)
        return self._solve(a, b, self.radius, length)


def _ompl_space(radius: float, reverse: bool, area: Area) -> OmplSpace | None:
    if own_trees.is_needed():
        return None
    from targets.car.planning.ompl_space import OmplSpace

    return OmplSpace(radius, reverse, area)


class Search:
    """Path search for one car in one world.

    If a `seed` is given and time limits count iterations, the answer depends on the task alone."""

    def __init__(self, radius: float, reverse: bool, area: Area, seed: int | None) -> None:
        self._radius, self._seed, self._area = radius, seed, area
        self._forwards = Space(radius, False, area)
        self._spaces = (self._forwards, Space(radius, True, area)) if reverse else (self._forwards,)
        self._space = self._spaces[-1]

    def headings(self, start: Triple, goal: Point2) -> Iterator[float]:
        """Yield headings (rad) to try at the goal if the task requires none.

        They are HEADINGS evenly spaced ones, and those at which one turn and a straight line arrive."""
        yield from (start[2] + i * 2 * math.pi / HEADINGS for i in range(HEADINGS))
        x, y, yaw = start
        for side in (1, -1):  # one turn to either side, then a straight line; in either gear
            cx, cy = x - side * self._radius * math.sin(yaw), y + side * self._radius * math.cos(yaw)
            away = math.hypot(goal[0] - cx, goal[1] - cy)
            if away > self._radius:
                bearing = math.atan2(goal[1] - cy, goal[0] - cx)
                aside = math.asin(self._radius / away)
                yield bearing + side * aside
                if self._space.reverse:
                    yield bearing - side * aside + math.pi

    def direct(self, task: Task, terrain: Terrain) -> Curve | None:
        """Return the cheapest collision-free single curve to the goal; None if there is none."""
        curves = [
            (space.distance(task.start, (*task.goal, heading)), heading, i)
            for i, space in enumerate(self._spaces)
            for heading in task.headings
        ]
        curves.sort()
        best, least = None, math.inf
        for length, heading, i in curves:
            if length >= least or length > DETOUR * curves[0][0] + 2 * math.pi * self._radius:
                break  # a price is at least the length, and all further curves are longer
            curve = self._spaces[i].curve(task.start, (*task.goal, heading), length)
            cost = price(curve.pieces, task.gear)
            if cost < least and terrain.clear(curve):
                best, least = curve, cost
        return best

    def paths(self, task: Task, terrain: Terrain) -> Iterator[Curve | None]:
        """Yield after each unit of work a path that is cheaper than all earlier ones, or None.

        The iteration ends when a lattice has no pose left to expand."""
        least, dice = math.inf, random.Random(self._seed or 0)
        most = math.inf
        for found in self._explored(task, terrain):
            if found is not None and (cost := price(found.pieces, task.gear)) < most and terrain.clear(found, 0.0):
                most = min(most, WORTH * cost)
                if cost < least:
                    least = cost
                    yield found
                for curve in self._shortened(found, task, terrain, dice):
                    cheaper = price(curve.pieces, task.gear) < least
                    least = min(least, price(curve.pieces, task.gear))
                    yield curve if cheaper else None
            yield None

    def _explored(self, task: Task, terrain: Terrain) -> Iterator[Curve | None]:
        """Yield after each batch of a lattice the path that it found, or None.

        The first lattice nearly always finds a path sooner. The second one, with a shorter wait, finds paths where the
        first one explores too many large cells before it turns to small cells."""
        goals = [(*task.goal, heading) for heading in task.headings]
        distance = self._space.distance

        def shots(at: Triple) -> Iterator[Curve]:
            for length, goal in sorted((distance(at, goal), goal) for goal in goals)[:SHOTS]:
                yield self._space.curve(at, goal, length)

        aim = SearchGoal(task.goal, Field(task.goal, terrain.cells, terrain.passable()), shots)
        reverse = self._space.reverse
        lattices = [Lattice(task.start, self._radius, reverse, terrain, aim, wait).explore() for wait in WAITS]
        for number in count():
            lattice = lattices[0 if number < ALONE else number % 2]
            try:
                pieces = next(lattice)
            except StopIteration:
                return
            yield None if pieces is None else Curve(task.start, merged(pieces))

    def _shortened(self, curve: Curve, task: Task, terrain: Terrain, dice: random.Random) -> Iterator[Curve]:
        """Yield the path after each unit of short cuts. A short cut is used if it is clear and cheaper."""
        vain = 0
        while vain < TRIES:
            for _ in range(UNIT):
                cut = self._cut(curve, task, terrain, dice)
                vain = 0 if cut is not None else vain + 1
                curve = curve if cut is None else cut
            yield curve

    def _cut(self, curve: Curve, task: Task, terrain: Terrain, dice: random.Random) -> Curve | None:
        """Return the path with one random short cut; None if the short cut is not clear or not cheaper."""
        begin, end = sorted((dice.uniform(-0.2, 1.2), dice.uniform(-0.2, 1.2)))
        begin, end = max(0.0, begin) * curve.length, min(1.0, end) * curve.length
        if end - begin < LEAST_CUT:
            return None
        space = self._forwards if dice.random() < FORWARDS else self._space
        a = curve.at(begin)
        b = curve.at(end) if end < curve.length else (*task.goal, dice.choice(task.headings))
        length, least = space.distance(a, b), price(curve.pieces, task.gear)
        if length > end - begin + least - curve.length:
            return None
        cut = space.curve(a, b, length)
        pieces = merged((*curve.between(0.0, begin), *cut.pieces, *curve.between(end, curve.length)))
        if price(pieces, task.gear) > least - GAIN or not terrain.clear(cut):
            return None
        whole = Curve(curve.start, pieces)
        return whole if terrain.clear(whole, 0.0) else None

    def grown(self, task: Task, terrain: Terrain, over: Limit) -> Curve | None:
        """Return the path that OMPL's RRT* finds until `over`; None if it finds none. Needs OMPL."""
        space = self._space
        assert space.ompl is not None, own_trees.NEEDS_OMPL

        def clear(a: Triple, b: Triple, length: float) -> bool:
            return terrain.slack(*b) >= PAD and terrain.clear(space.curve(a, b, length))

        goals = [(*task.goal, heading) for heading in task.headings]
        poses = space.ompl.grown(task.start, goals, clear, over, self._seed)
        return None if poses is None else self._joined(task.start, poses, terrain)

    def _joined(self, start: Triple, poses: list[Triple], terrain: Terrain) -> Curve | None:
        """Return the poses of an RRT* solution, joined to one curve; None if a joint is not clear.

        A joint may be obstructed, because the tree may have checked another curve of equal length."""
        pieces: list[Piece] = []
        at = start
        for pose in poses:
            curve = self._space.curve(at, pose)
            if not terrain.clear(curve):
                return None
            pieces += curve.pieces
            at = curve.end
        return Curve(start, merged(pieces))


def merged(pieces: list[Piece] | tuple[Piece, ...]) -> tuple[Piece, ...]:
    """Return the pieces with neighbours of equal curvature and direction merged."""
    found: list[Piece] = []
    for curvature, way in pieces:
        if found and found[-1][0] == curvature and found[-1][1] * way > 0:
            way += found.pop()[1]
        found.append((curvature, way))
    return tuple(found)
