"""Planned paths keep their distance from obstacles, stay inside the fence, and are found where there is room."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from koordgen.runtime.settings import Box
from koordgen.runtime.values import Grid, Point
from targets.planning.planner import Planner, Square
from targets.planning.route import Route

FENCE = Box(Point(-5.0, -4.0, 0.0), Point(5.0, 4.0, 3.0))
CLEARANCE = 0.3


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(FENCE, CLEARANCE)


def wall(x: float, south: float, north: float, size: float = 0.25) -> list[Grid]:
    return [Grid(math.floor(x / size), j, size) for j in range(math.floor(south / size), math.ceil(north / size))]


def nearest(path: tuple[Point, ...], obstacles: list[Grid]) -> float:
    """The least distance of a path to obstacles, looked at each 5 mm: independent of the planner's own look."""
    squares = [Square(g.x * g.size, g.y * g.size, (g.x + 1) * g.size, (g.y + 1) * g.size) for g in obstacles]
    least = math.inf
    for a, b in pairwise(path):
        steps = max(1, math.ceil(math.dist((a.x, a.y), (b.x, b.y)) / 0.005))
        for i in range(steps + 1):
            x, y = a.x + (b.x - a.x) * i / steps, a.y + (b.y - a.y) * i / steps
            least = min(least, *(s.distance(x, y) for s in squares))
    return least


def test_free_space_is_crossed_in_a_straight_line(planner: Planner) -> None:
    start, goal = Point(-3.0, 0.0, 0.0), Point(3.0, 1.0, 1.5)
    assert planner.plan(start, goal) == (start, goal)


def test_a_wall_is_gone_around(planner: Planner) -> None:
    obstacles = wall(0.0, -4.0, 2.0)
    start, goal = Point(-3.0, 0.0, 0.0), Point(3.0, 0.0, 0.0)
    path = planner.plan(start, goal, obstacles)
    assert path[0] == start and path[-1] == goal and len(path) > 2
    assert nearest(path, obstacles) >= CLEARANCE - 1e-3
    assert all(-5.0 <= p.x <= 5.0 and -4.0 <= p.y <= 4.0 for p in path)


@pytest.mark.parametrize(
    ("goal", "obstacles"),
    [
        (Point(6.0, 0.0, 0.0), []),  # outside
        (Point(3.0, 0.0, 0.0), wall(0.0, -4.0, 4.0)),  # behind a wall without a gap
        (Point(3.0, 0.0, 0.0), [Grid(12, 0, 0.25)]),  # too near to an obstacle
        (Point(math.nan, 0.0, 0.0), []),
    ],
)
def test_what_cannot_be_reached_has_no_path(planner: Planner, goal: Point, obstacles: list[Grid]) -> None:
    assert planner.plan(Point(-3.0, 0.0, 0.0), goal, obstacles) == ()


def test_points_are_obstacles_too(planner: Planner) -> None:
    path = planner.plan(Point(-3.0, 0.0, 0.0), Point(3.0, 0.0, 0.0), [Point(0.0, 0.05, 0.0)])
    assert len(path) > 2
    squares = [Square(0.0, 0.05, 0.0, 0.05)]
    assert min(s.distance(p.x, p.y) for s in squares for p in path) >= CLEARANCE


def test_a_robot_that_stands_too_near_to_an_obstacle_may_leave(planner: Planner) -> None:
    obstacles = wall(0.0, -2.0, 2.0)
    start, goal = Point(-0.1, 0.0, 0.0), Point(-3.0, 0.0, 0.0)
    assert planner.plan(start, goal, obstacles) == (start, goal)


def test_random_clutter(planner: Planner) -> None:
    source = random.Random(3)
    found = 0
    for _ in range(40):
        middles = [(source.uniform(-4, 4), source.uniform(-3, 3)) for _ in range(8)]
        obstacles = [
            Grid(math.floor(x * 4) + i, math.floor(y * 4) + j, 0.25) for x, y in middles for i in (0, 1) for j in (0, 1)
        ]
        path = planner.plan(Point(-4.9, source.uniform(-3, 3), 0.0), Point(4.9, source.uniform(-3, 3), 0.0), obstacles)
        found += bool(path)
        if path:
            assert nearest(path, obstacles) >= CLEARANCE - 0.005
    assert found >= 30


def test_a_route_gives_its_points_one_after_the_other() -> None:
    route = Route()
    a, b = Point(1.0, 0.0, 0.0), Point(2.0, 0.0, 0.0)

    def now() -> tuple[Point | None, bool]:
        return route.goal, route.last

    assert now() == (None, True)
    assert route.take((a, b))
    assert now() == (a, False)
    assert route.passed() == b
    assert route.passed() == b, "the last one stays"
    assert now() == (b, True)
    assert not route.take((a, b)), "it is being followed already"
    assert route.take(())
    assert now() == (None, True)
