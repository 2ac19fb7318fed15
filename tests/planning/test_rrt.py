"""Paths of the planners that come along, from where the arena does not reach."""

from __future__ import annotations

import pytest

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.planning.process import Inside
from targets.planning.world import Scene, World

ARENA = Box(Point(-6.0, -5.0, 1.5), Point(6.0, 5.0, 4.0))
WALL = Block(Point(2.5, -3.0, 0.0), Point(2.7, 2.0, 4.0))


@pytest.mark.parametrize("planner", ["rrt", "rrt-smoothed"])
def test_a_quad_that_is_still_climbing_gets_a_path_that_stays_in_the_arena(planner: str) -> None:
    """Short cuts once began on the line into the arena, below it, and the path was refused."""
    start, goal = Point(1.0, -2.0, 1.3), Point(4.0, 0.0, 1.5)
    for seed in range(30):
        planning = Inside(planner, World(ARENA, (WALL,), 0.1, 0.2, seed=seed, iterations=100), 1.0)
        planning.start()
        path = planning.plan(start, goal, Scene((), ()))
        assert path[:1] == (start,) and path[-1:] == (goal,), seed
