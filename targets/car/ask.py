"""Asks the car's planner in its own process: told a heading besides start and goal, it answers a curve besides points.

No way goes out that was not looked at as it will be driven, along its whole length, whoever planned it.
"""

from __future__ import annotations

import math
import random

import msgspec

from koordgen.runtime.values import Point
from targets.car.curves import Curve, Triple
from targets.car.ground import PAD, Way, ground
from targets.car.lattice import COARSE, FINE
from targets.car.planner import Plan, Wish, points, price
from targets.car.search import Search, Task
from targets.car.shapes import named
from targets.planning.ask import NAMES, finite, within
from targets.planning.ask import Asked as AskedForPoints
from targets.planning.limit import Limit
from targets.planning.pipe import Answer, Question
from targets.planning.world import World

TREES = 0.02  # seconds for a tree, before a lattice is explored
LATTICE = 0.6  # of the time for a good way is for the lattice at first


class Asked:
    """The car's judge: see `targets.planning.ask.Judge`."""

    def __init__(self, name: str, world: World) -> None:
        self._name, self._world = name, world
        self._own = AskedForPoints(name, world) if name not in NAMES else None
        self._ground = ground(world)
        self._search = Search(world.turning_radius, world.reverse, self._ground.area, world.seed)

    def serve(self, question: Question) -> Answer:
        """The curve that is answered ends at the goal exactly but for rounding, and so do its points, exactly."""
        if self._own is not None:
            return self._own.serve(question)
        wish = msgspec.msgpack.decode(question.more, type=Wish)
        start = (question.start.x, question.start.y, wish.yaw)
        goal = question.goal
        reason = self._amiss(question, wish)
        if reason:
            return Answer(question.number, (), reason)
        seen = named(question.scene, self._ground.body, (start[0], start[1]), self._ground.clearance)
        way = self._ground.around(start, (goal.x, goal.y), seen)
        if way.inside:
            return Answer(question.number, (), f"the car is in {way.inside}")
        headings = self._headings(start, question.goal, wish)
        free = tuple(h for h in headings if way.slack(goal.x, goal.y, h) >= PAD)
        if not free:
            blocker = way.obstacle(goal.x, goal.y, headings[0])
            return Answer(question.number, (), f"the goal is too near to {blocker}")
        task = Task(start, (goal.x, goal.y), free, wish.gear)
        curve = self._found(task, way, question.seconds, max(question.seconds, wish.patience))
        if curve is None or not way.clear(curve, 0.0):
            return Answer(question.number, (), "")
        middle = (Point(x, y, 0.0) for x, y in points(curve)[1:-1])
        path = (question.start, *middle, goal)
        return Answer(question.number, path, "", msgspec.msgpack.encode(Plan(start, curve.pieces)))

    def _amiss(self, question: Question, wish: Wish) -> str:
        if not finite(question.start) or not finite(question.goal) or not math.isfinite(wish.yaw):
            return "start or goal is not finite"
        if question.goal.z != 0.0:
            return "the goal is not on the ground"
        return "" if within(self._world.arena, question.goal) else "the goal is outside the arena"

    def _headings(self, start: Triple, goal: Point, wish: Wish) -> tuple[float, ...]:
        if wish.heading is not None:
            return (wish.heading,)
        found = tuple(self._search.headings(start, (goal.x, goal.y)))
        return found if wish.arrival is None else (*found, wish.arrival)

    def _found(self, task: Task, way: Way, seconds: float, patience: float) -> Curve | None:
        """`seconds` are for a good way, `patience` for any."""
        if math.dist(task.start[:2], task.goal) < 1e-3:
            return None
        search, name = self._search, self._name
        if (curve := search.direct(task, way)) is not None or name == "straight":
            return curve
        over, end = self._limit(seconds), self._limit(patience)
        if name == "rrt-star":
            return search.connected(task, way, over, 0, star=True)
        best = None
        ample = self._world.iterations is not None or seconds > TREES
        if name != "rrt" and ample:  # what the lattice holds is shorter, but not always found as soon
            best = search.explored(task, way, self._limit(LATTICE * seconds))
        turn = 0
        for seconds, width in ((TREES, 0.0), (patience, COARSE), (10 * TREES, 0.0), (patience, FINE), (patience, 0.0)):
            if best is not None or end.late:
                break
            limit = end.anew(seconds)
            best = search.explored(task, way, limit, width) if width else search.connected(task, way, limit, turn)
            turn += not width
        while best is None and not (end.late or end.spent(turn)):
            best = search.connected(task, way, end, turn)  # rarely, what a tree found is not clear after all
            turn += 1
        return best if best is None or name == "rrt" else self._polished(best, task, way, over)

    def _limit(self, seconds: float) -> Limit:
        return Limit(seconds, self._world.iterations)

    def _polished(self, best: Curve, task: Task, way: Way, over: Limit) -> Curve:
        """Short cuts, also of what other trees find, for as long as there is time."""
        search, dice = self._search, random.Random(self._world.seed)
        best = search.shortened(best, task, way, dice, over)
        turn = 2
        while not over.spent(turn):
            best = search.shortened(best, task, way, dice, over)
            another = search.connected(task, way, over, turn)
            if another is not None:
                best = _cheaper(best, search.shortened(another, task, way, dice, over), task)
            turn += 1
        return best


def _cheaper(a: Curve, b: Curve, task: Task) -> Curve:
    return min(a, b, key=lambda curve: price(curve.pieces, task.gear))
