"""Anytime search for ways that a car can drive: a single curve, or a way of a lattice, made short by short cuts.

`Search.ways` is one sequence of small units of work. It depends on the question alone, and a budget only ends it: so a
larger budget finds every way that a smaller one finds, and answers one that is at least as cheap.

OMPL measures curves and grows the trees of RRT*; the curves themselves (`curves.py`), and whether one is clear
(`ground.py`), are ours. Of OMPL's Python binding only these calls are relied on (version 2.0.1, where out-parameters
stay empty; a test holds that they work): those listed in `targets/planning/rrt.py` but those of vector spaces, and
`ReedsSheppStateSpace`, `DubinsStateSpace`, `distance`, `setXY`, `setYaw`, `getX`, `getY`, `getYaw`,
`GoalStates.addState`, `addStartState`, `setGoal`, `setRange`, `setGoalBias`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

from ompl import base, geometric, util

from targets.car.bicycle import wrap
from targets.car.curves import Curve, Piece, Triple, dubins, reeds_shepp
from targets.car.field import Field
from targets.car.ground import PAD, Way
from targets.car.lattice import Aim, Lattice
from targets.car.planner import Area, Point2, price
from targets.planning.limit import STARTS, Limit

HEADINGS = 24  # candidates at the goal, besides those at which the shortest simple turns arrive
DETOUR = 1.6  # a single curve that is so much longer than the shortest is not worth its time; and a turn more
RANGE = 2.0  # metres: the longest edge of a tree
GOAL_BIAS = 0.2  # of the samples of a forward tree
WAITS = 4.0, 1.5  # of two lattices: see Lattice
ALONE = 40  # batches of the first one before the second takes turns with it
UNIT = 8  # short cuts that are tried in one unit of work
TRIES = 150  # short cuts of one way that are tried in vain before another way is looked for
WORTH = 1.3  # a way that costs more than so many times the first one is not worth short cuts
SHOTS = 3  # curves to a place that are tried from a pose of the lattice
LEAST_CUT = 0.1  # metres: a way between two poses that is shorter is left alone
GAIN = 1e-3  # metres of price that make a short cut one
FORWARDS = 0.3  # of the short cuts are tried without reverse gear, which may be cheaper


@dataclass(frozen=True, slots=True)
class Task:
    """From a pose to a place, at one of these headings. `gear` is the direction in which the car rolls (0: it
    stands)."""

    start: Triple
    goal: Point2
    headings: tuple[float, ...]
    gear: int = 0


class Space:
    """One of OMPL's spaces of poses, and the curves that are its distances."""

    def __init__(self, radius: float, reverse: bool, area: Area) -> None:
        self.radius, self.reverse = radius, reverse
        self.ompl = (base.ReedsSheppStateSpace if reverse else base.DubinsStateSpace)(radius)
        self._solve: Callable[[Triple, Triple, float, float | None], Curve] = reeds_shepp if reverse else dubins
        self._a, self._b = self.ompl.allocState(), self.ompl.allocState()
        bounds = base.RealVectorBounds(2)
        for axis, (low, high) in enumerate(((area.west, area.east), (area.south, area.north))):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        self.ompl.setBounds(bounds)

    def state(self, pose: Triple) -> Any:
        return _put(self.ompl.allocState(), pose)

    def distance(self, a: Triple, b: Triple) -> float:
        return float(self.ompl.distance(_put(self._a, a), _put(self._b, b)))

    def curve(self, a: Triple, b: Triple, length: float | None = None) -> Curve:
        return self._solve(a, b, self.radius, self.distance(a, b) if length is None else length)


class Search:
    """For one car in one world. With a `seed` and `iterations` in the Limits, the answer depends on the task alone."""

    def __init__(self, radius: float, reverse: bool, area: Area, seed: int | None) -> None:
        util.setLogLevel(util.LogLevel.LOG_NONE)
        self._radius, self._seed, self._area = radius, seed, area
        self._forwards = Space(radius, False, area)
        self._spaces = (self._forwards, Space(radius, True, area)) if reverse else (self._forwards,)
        self._space = self._spaces[-1]

    def headings(self, start: Triple, goal: Point2) -> Iterator[float]:
        """Those at which a way may end that may end at any: all around, and those of the shortest simple turns."""
        yield from (start[2] + i * 2 * math.pi / HEADINGS for i in range(HEADINGS))
        x, y, yaw = start
        for side in (1, -1):  # one turn and a straight line, to either side and in either gear
            cx, cy = x - side * self._radius * math.sin(yaw), y + side * self._radius * math.cos(yaw)
            away = math.hypot(goal[0] - cx, goal[1] - cy)
            if away > self._radius:
                bearing = math.atan2(goal[1] - cy, goal[0] - cx)
                aside = math.asin(self._radius / away)
                yield bearing + side * aside
                if self._space.reverse:
                    yield bearing - side * aside + math.pi

    def direct(self, task: Task, way: Way) -> Curve | None:
        """The cheapest single curve that is clear."""
        curves = [
            (space.distance(task.start, (*task.goal, heading)), heading, i)
            for i, space in enumerate(self._spaces)
            for heading in task.headings
        ]
        curves.sort()
        best, least = None, math.inf
        for length, heading, i in curves:
            if length >= least or length > DETOUR * curves[0][0] + 2 * math.pi * self._radius:
                break  # a price is never below the length: nothing better can follow
            curve = self._spaces[i].curve(task.start, (*task.goal, heading), length)
            cost = price(curve.pieces, task.gear)
            if cost < least and way.clear(curve):
                best, least = curve, cost
        return best

    def ways(self, task: Task, way: Way) -> Iterator[Curve | None]:
        """Yield after each unit of work: a way that is cheaper than all before, or None. End when nothing is left."""
        least, dice = math.inf, random.Random(self._seed or 0)
        most = math.inf
        for found in self._explored(task, way):
            if found is not None and (cost := price(found.pieces, task.gear)) < most and way.clear(found, 0.0):
                most = min(most, WORTH * cost)
                if cost < least:
                    least = cost
                    yield found
                for curve in self._shortened(found, task, way, dice):
                    cheaper = price(curve.pieces, task.gear) < least
                    least = min(least, price(curve.pieces, task.gear))
                    yield curve if cheaper else None
            yield None

    def _explored(self, task: Task, way: Way) -> Iterator[Curve | None]:
        """Yield what lattices hold, after each batch. The first nearly always is the sooner one; where it looks at too
        many coarse cells before it looks closer, the second one has a way."""
        goals = [(*task.goal, heading) for heading in task.headings]
        distance = self._space.distance

        def shots(at: Triple) -> Iterator[Curve]:
            for length, goal in sorted((distance(at, goal), goal) for goal in goals)[:SHOTS]:
                yield self._space.curve(at, goal, length)

        aim = Aim(task.goal, Field(task.goal, way.cells, way.passable()), shots)
        reverse = self._space.reverse
        lattices = [Lattice(task.start, self._radius, reverse, way, aim, wait).explore() for wait in WAITS]
        for number in count():
            lattice = lattices[0 if number < ALONE else number % 2]
            try:
                pieces = next(lattice)
            except StopIteration:
                return
            yield None if pieces is None else Curve(task.start, merged(pieces))

    def _shortened(self, curve: Curve, task: Task, way: Way, dice: random.Random) -> Iterator[Curve]:
        """Yield the same way after each unit of short cuts, as far as they are clear and cheaper."""
        vain = 0
        while vain < TRIES:
            for _ in range(UNIT):
                cut = self._cut(curve, task, way, dice)
                vain = 0 if cut is not None else vain + 1
                curve = curve if cut is None else cut
            yield curve

    def _cut(self, curve: Curve, task: Task, way: Way, dice: random.Random) -> Curve | None:
        """Return the way with one random short cut, if that is clear and cheaper."""
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
        if price(pieces, task.gear) > least - GAIN or not way.clear(cut):
            return None
        whole = Curve(curve.start, pieces)
        return whole if way.clear(whole, 0.0) else None

    def grown(self, task: Task, way: Way, over: Limit) -> Curve | None:
        """Return what RRT* finds."""
        if self._seed is not None:
            util.RNG.setSeed(self._seed * STARTS + 1)
        space = self._space
        information = base.SpaceInformation(space.ompl)
        information.setStateValidityChecker(lambda state: True)  # the ends of every curve are looked at with the curve
        validator = _Curves(information, space, way)
        information.setMotionValidator(validator)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.addStartState(space.state(task.start))
        goals = base.GoalStates(information)
        for heading in task.headings:
            goals.addState(space.state((*task.goal, heading)))
        problem.setGoal(goals)
        planner = geometric.RRTstar(information)
        planner.setRange(RANGE)
        if not space.reverse:
            planner.setGoalBias(GOAL_BIAS)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(over))
        if not problem.hasExactSolution():
            return None
        return self._joined(task.start, problem.getSolutionPath(), way)

    def _joined(self, start: Triple, found: Any, way: Way) -> Curve | None:
        """A solution as one curve. Of two equally short curves, a tree may have looked at the other one."""
        pieces: list[Piece] = []
        at = start
        for i in range(1, found.getStateCount()):
            curve = self._space.curve(at, _pose(found.getState(i)))
            if not way.clear(curve):
                return None
            pieces += curve.pieces
            at = curve.end
        return Curve(start, merged(pieces))


def merged(pieces: list[Piece] | tuple[Piece, ...]) -> tuple[Piece, ...]:
    """The same with neighbours of equal curvature and direction as one."""
    found: list[Piece] = []
    for curvature, way in pieces:
        if found and found[-1][0] == curvature and found[-1][1] * way > 0:
            way += found.pop()[1]
        found.append((curvature, way))
    return tuple(found)


class _Curves(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, space: Space, way: Way) -> None:
        super().__init__(information)
        self._space, self._way = space, way

    def checkMotion(self, a: Any, b: Any) -> bool:  # OMPL's name
        end = _pose(b)
        if self._way.slack(*end) < PAD:
            return False
        return self._way.clear(self._space.curve(_pose(a), end, float(self._space.ompl.distance(a, b))))


def _pose(state: Any) -> Triple:
    return state.getX(), state.getY(), state.getYaw()


def _put(state: Any, pose: Triple) -> Any:
    state.setXY(pose[0], pose[1])
    state.setYaw(wrap(pose[2]))
    return state
