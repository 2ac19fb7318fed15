"""Judge of a planner: rejects infeasible questions, and checks paths against all obstacles.

The check is exact. No path is returned without a check, whichever planner computed the path."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import pairwise
from typing import Any, Protocol

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point
from targets.planning import own_trees
from targets.planning.pipe import Answer, Question
from targets.planning.room import InRoom, Room, fixed, room
from targets.planning.world import Path, Planner, Scene, World

MOST_POINTS = 1000  # maximum number of points of a path
ROUNDING = 1e-9  # metres by which a point may be outside of the arena because of rounding

NAMES = ("rrt", "rrt-smoothed", "rrt-star", "straight")  # built-in planners; users name theirs "module:Class"


class BadPlanner(Exception):
    """Raised if a planner cannot be created. The message gives the reason."""


class Judge(Protocol):
    """Interface of a judge, which calls a planner and checks its paths.

    A judge is created with the planner's name and a World. The creation may raise BadPlanner."""

    def serve(self, question: Question) -> Answer: ...


def judging(judge: str, name: str, world: World) -> Judge:
    """Create the judge `module:Class` with the planner of this name. Raises BadPlanner."""
    module, _, member = judge.partition(":")
    try:
        made: Judge = getattr(import_module(module), member)(name, world)
    except ImportError as error:
        raise BadPlanner(f"a package is missing: {error}; install the bundle's requirements.txt") from None
    return made


def make(name: str, world: World) -> Planner:
    """Create the planner of this name: a built-in one, or "module:Class". Raises BadPlanner."""
    if name in NAMES:
        if name == "rrt-star" and own_trees.is_needed():
            raise BadPlanner(own_trees.NEEDS_OMPL)
        from targets.planning.rrt import PLANNERS  # imported here, so that only planner processes load OMPL

        return PLANNERS[name](world)
    module, _, member = name.partition(":")
    try:
        found: Any = getattr(import_module(module), member)(world)
    except Exception as error:
        raise BadPlanner(f"the planner {name} cannot be created: {type(error).__name__}: {error}") from None
    if not callable(getattr(found, "plan", None)):
        raise BadPlanner(f"the planner {name} has no method plan")
    planner: Planner = found
    return planner


class PlannerJudge:
    """Judge that calls a planner and checks its paths. The creation may raise BadPlanner.

    `answer` raises no exception of the planner."""

    def __init__(self, name: str, world: World) -> None:
        self._world = world
        self._standing = fixed(world.obstacles)
        self._planner = make(name, world)

    def serve(self, question: Question) -> Answer:
        """Return the answer to a question that the planner's process received."""
        path, reason = self.answer(question.start, question.goal, question.scene, question.seconds)
        return Answer(question.number, path, reason)

    def answer(self, start: Point, goal: Point, scene: Scene, seconds: float) -> tuple[Path, str]:
        """Return a path and "", or () and the reason in words.

        If the planner found no path and gave no reason, the result is () and ""."""
        world = self._world
        if not world.flies:
            start, goal = Point(start.x, start.y, 0.0), goal
        here = room(world, self._standing, scene, start)
        reason = infeasible(world, here, start, goal)
        if reason:
            return (), reason
        try:
            path = self._planned(here, start, goal, scene, seconds)
        except Exception as error:
            return (), f"the planner failed: {type(error).__name__}: {error}"
        if path == ():
            return (), ""
        reason = misled(world, here, start, goal, path)
        return ((), f"the planner's path was refused: {reason}") if reason else (tuple(path), "")

    def _planned(self, here: Room, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        if isinstance(self._planner, InRoom):  # built-in planners reuse the Room: a large scene is prepared only once
            return self._planner.plan_in(here, start, goal, seconds)
        return self._planner.plan(start, goal, scene, seconds)


def infeasible(world: World, here: Room, start: Point, goal: Point) -> str:
    """Return the reason why there can be no path, in words; "" if there may be one."""
    if not finite(start) or not finite(goal):
        return "start or goal is not finite"
    if world.flies and goal.z <= 0.0:
        return "the goal is not above the ground"
    if not world.flies and goal.z != 0.0:
        return "the goal is not on the ground"
    if not within(world.arena, goal):
        return "the goal is outside the arena"
    if here.inside:
        return f"the robot is in {here.inside}"
    if not here.clear(goal, goal):
        return f"the goal is too near to {here.nearest(goal, goal)[1]}"
    return ""


def misled(world: World, here: Room, start: Point, goal: Point, path: Any) -> str:
    """Return the fault of a planner's path, in words; "" if the path may be followed."""
    if not isinstance(path, (tuple, list)) or not all(isinstance(p, Point) and finite(p) for p in path):
        return "the path is no tuple of finite Points"
    if not 2 <= len(path) <= MOST_POINTS:
        return f"the path has {len(path)} points"
    if path[0] != start or path[-1] != goal:
        return "the path does not lead from start to goal"
    outside = [p for p in path[1:] if not within(world.arena, p)]
    if outside:
        return f"({outside[0].x:.2f}, {outside[0].y:.2f}, {outside[0].z:.2f}) is outside the arena"
    for a, b in pairwise(path):
        away, name = here.nearest(a, b)
        if name:
            return f"the path comes within {away:.3f} m of {name}"
    return ""


def finite(p: Point) -> bool:
    return all(map(math.isfinite, (p.x, p.y, p.z)))


def within(arena: Box, p: Point) -> bool:
    lo, hi = arena.lo, arena.hi
    return all(
        min(a, b) - ROUNDING <= v <= max(a, b) + ROUNDING
        for a, v, b in ((lo.x, p.x, hi.x), (lo.y, p.y, hi.y), (lo.z, p.z, hi.z))
    )
