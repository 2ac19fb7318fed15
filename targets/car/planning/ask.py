"""Judge of the car's planner: answers questions (start, goal, heading) in the planner's process, with curves.

A curve is answered only after a collision check along its whole length, whichever search planned it. A user's own
planner answers points; `targets.planning.ask` checks these.
"""

from __future__ import annotations

import math
from functools import cache

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.car.planning.curves import Curve, Triple
from targets.car.planning.ground import PAD, Terrain, ground
from targets.car.planning.planner import Plan, Wish, points
from targets.car.planning.search import Search, Task
from targets.car.planning.shapes import named
from targets.planning import own_trees
from targets.planning.ask import NAMES, BadPlanner, finite, within
from targets.planning.ask import PlannerJudge as AskedForPoints
from targets.planning.limit import Limit
from targets.planning.pipe import Answer, Question
from targets.planning.world import World


class CarJudge:
    """Judge of the car's planner, an implementation of `targets.planning.ask.Judge`."""

    def __init__(self, name: str, world: World) -> None:
        if name == "rrt-star" and own_trees.is_needed():
            raise BadPlanner(own_trees.NEEDS_OMPL)
        self._name, self._world = name, world
        self._own = AskedForPoints(name, world) if name not in NAMES else None
        self._ground = ground(world)
        self._search = Search(world.turning_radius, world.reverse, self._ground.area, world.seed)
        _warm_up()

    def serve(self, question: Question) -> Answer:
        """Return the answer to a question. It has a curve, unless a user's own planner gave it.

        The curve ends at the goal but for rounding errors. The last of the answer's points is exactly the goal."""
        if self._own is not None:
            return self._own.serve(question)
        over = Limit(question.seconds, self._world.iterations)
        wish = msgspec.msgpack.decode(question.more, type=Wish)
        start = (question.start.x, question.start.y, wish.yaw)
        goal = question.goal
        reason = self._amiss(question, wish)
        if reason:
            return Answer(question.number, (), reason)
        seen = named(question.scene, self._ground.body, (start[0], start[1]), self._ground.clearance)
        terrain = self._ground.around(start, (goal.x, goal.y), seen)
        if terrain.inside:
            return Answer(question.number, (), f"the car is in {terrain.inside}")
        headings = self._headings(start, question.goal, wish)
        free = tuple(h for h in headings if terrain.slack(goal.x, goal.y, h) >= PAD)
        if not free:
            blocker = terrain.obstacle(goal.x, goal.y, headings[0])
            return Answer(question.number, (), f"the goal is too near to {blocker}")
        task = Task(start, (goal.x, goal.y), free, wish.gear)
        curve = self._found(task, terrain, over, over.later(wish.time_limit))
        if curve is None or not terrain.clear(curve, 0.0):
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

    def _found(self, task: Task, terrain: Terrain, over: Limit, end: Limit) -> Curve | None:
        """Return the best path found until the limit `over` is reached; None if there is none.

        If no path was found by then, return the first one that is found before the limit `end` is reached."""
        if math.dist(task.start[:2], task.goal) < 1e-3:
            return None
        search, name = self._search, self._name
        if (curve := search.direct(task, terrain)) is not None or name == "straight":
            return curve
        if name == "rrt-star":
            return search.grown(task, terrain, over)
        best = None
        for found in search.paths(task, terrain):
            best = best if found is None else found
            late, spent = over(), end()
            if spent or (best is not None and (late or name == "rrt")):
                break
        return best


@cache
def _warm_up() -> None:
    """Search a path around a wall once, before the first question.

    The first calls of numpy take about 20 ms longer than later ones; the time limit of a question is too short for
    that."""
    wall = Block(Point(1.9, -1.0, 0.0), Point(2.1, 2.5, 1.0))
    place = ground(
        World(
            Box(Point(0.0, 0.0, 0.0), Point(4.0, 4.0, 1.0)), (wall,), clearance=0.1, flies=False,
            footprint=(0.5, 0.28), overhang=0.085, height=0.25, turning_radius=0.9,
        )
    )  # fmt: skip
    task = Task((1.0, 1.0, 0.0), (3.0, 1.0), (0.0,))
    paths = Search(0.9, True, place.area, 0).paths(task, place.around(task.start, task.goal))
    next((path for path in paths if path is not None), None)
