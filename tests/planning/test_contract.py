"""What every planner must keep, those that come along and a user's own: asked as platforms ask them."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from itertools import pairwise

import pytest

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Grid, Point, distance
from targets.planning.ask import NAMES, PlannerJudge
from targets.planning.exact import solid_distance
from targets.planning.mesh import Surface
from targets.planning.world import Path, Scene, World

ARENA = Box(Point(-5.0, -4.0, 0.5), Point(5.0, 4.0, 3.0))
RADIUS, CLEARANCE = 0.2, 0.1
KEPT = RADIUS + CLEARANCE
OWN = "benchmarks.fixtures.lattice_planner:Lattice"
ALL = (*NAMES, OWN)
AROUND = tuple(name for name in ALL if name != "straight")
START, GOAL = Point(-4.0, 0.0, 1.5), Point(4.0, 0.0, 1.5)
SECONDS = 0.05
WALL = Block(Point(-0.2, -4.0, 0.0), Point(0.2, 2.0, 3.0))
every = pytest.mark.parametrize("name", ALL)


def asked(name: str, *obstacles: Obstacle) -> PlannerJudge:
    return PlannerJudge(name, World(ARENA, obstacles, CLEARANCE, RADIUS))


def plan(name: str, *obstacles: Obstacle, start: Point = START, goal: Point = GOAL, scene: Scene = Scene()) -> Path:  # noqa: B008
    return asked(name, *obstacles).answer(start, goal, scene, SECONDS)[0]


def gap(body: Obstacle, path: Path) -> float:
    """The least distance of a path from an obstacle, exactly."""
    measure: Callable[[Point, Point], float]
    if isinstance(body, Mesh):
        measure = Surface(body).distance
    else:
        solid = body

        def measure(a: Point, b: Point) -> float:
            return solid_distance(solid, a, b)

    return min(measure(a, b) for a, b in pairwise(path))


def keeps(path: Path, start: Point, goal: Point) -> None:
    assert path[0] == start and path[-1] == goal and len(path) >= 2
    for p in path[1:]:
        assert all(
            low - 1e-9 <= v <= high + 1e-9
            for low, v, high in zip((-5.0, -4.0, 0.5), (p.x, p.y, p.z), (5.0, 4.0, 3.0), strict=True)
        )


@every
def test_free_space_is_crossed_from_start_to_goal(name: str) -> None:
    path = plan(name)
    keeps(path, START, GOAL)
    if name != OWN:
        assert path == (START, GOAL)


@pytest.mark.parametrize("name", AROUND)
@pytest.mark.parametrize(
    "body",
    [
        WALL,
        Sphere(Point(0.0, 0.0, 1.5), 1.0),
        Cylinder(Point(0.0, 0.1, 0.0), 0.7, 4.0),
        Mesh((Point(0, -4, 0), Point(0, 1, 0), Point(0, 1, 3), Point(0, -4, 3)), ((0, 1, 2), (0, 2, 3))),
    ],
    ids=["box", "sphere", "cylinder", "mesh"],
)
def test_an_obstacle_of_any_kind_is_gone_around(name: str, body: Obstacle) -> None:
    path = plan(name, body)
    keeps(path, START, GOAL)
    assert gap(body, path) >= KEPT


@pytest.mark.parametrize("name", AROUND)
def test_a_wall_that_does_not_reach_up_may_be_flown_over(name: str) -> None:
    low = Block(Point(-0.2, -4.5, 0.0), Point(0.2, 4.5, 2.0))
    path = plan(name, low)
    keeps(path, START, GOAL)
    assert gap(low, path) >= KEPT and max(p.z for p in path) > 2.2


@every
@pytest.mark.parametrize(
    ("goal", "obstacles", "said"),
    [
        (Point(6.0, 0.0, 1.5), (), "outside the arena"),
        (Point(4.0, 0.0, 4.0), (), "outside the arena"),
        (Point(4.0, 0.0, 0.0), (), "not above the ground"),
        (Point(4.0, 0.0, -1.0), (), "not above the ground"),
        (Point(0.0, 0.0, 1.5), (WALL,), "too near to obstacle 0"),
        (Point(0.45, 0.0, 1.5), (WALL,), "too near to obstacle 0"),
        (Point(math.nan, 0.0, 1.5), (), "not finite"),
        (Point(math.inf, 0.0, 1.5), (), "not finite"),
    ],
)
def test_what_is_infeasible_has_no_path(name: str, goal: Point, obstacles: tuple[Obstacle, ...], said: str) -> None:
    path, why = asked(name, *obstacles).answer(START, goal, Scene(), SECONDS)
    assert path == () and said in why


@every
def test_behind_a_wall_without_a_gap_there_is_no_path(name: str) -> None:
    assert plan(name, Block(Point(-0.2, -5.0, 0.0), Point(0.2, 5.0, 4.0))) == ()


@every
def test_a_tight_place_may_be_left(name: str) -> None:
    near = Point(-0.3, 0.0, 1.5)  # a tenth of a metre from the wall
    path = plan(name, WALL, start=near, goal=Point(-4.0, 0.0, 1.5))
    keeps(path, near, Point(-4.0, 0.0, 1.5))
    assert gap(WALL, path) >= 0.09, "no nearer to the wall than at the start"


@every
def test_from_within_an_obstacle_nothing_is_planned(name: str) -> None:
    path, why = asked(name, WALL).answer(Point(0.0, 0.0, 1.5), GOAL, Scene(), SECONDS)
    assert path == () and "in obstacle 0" in why


@pytest.mark.parametrize("name", AROUND)
def test_grids_and_points_are_as_high_as_anything(name: str) -> None:
    cells = tuple(Grid(0, j, 0.25) for j in range(-16, 9))
    path = plan(name, scene=Scene(grids=cells))
    keeps(path, START, GOAL)
    square = Block(Point(0.0, -4.0, -9.0), Point(0.25, 2.25, 9.0))
    assert gap(square, path) >= KEPT
    post = Point(0.0, 0.05, 0.0)
    path = plan(name, scene=Scene(points=(post,)))
    assert gap(Cylinder(Point(0.0, 0.05, -9.0), 0.0, 18.0), path) >= KEPT - 1e-9


@pytest.mark.parametrize("name", AROUND)
def test_another_robots_path_is_kept_away_from_by_two_radii(name: str) -> None:
    theirs = (Point(0.0, -3.0, 1.5), Point(0.0, 3.0, 1.5))
    path = plan(name, scene=Scene(others=(theirs,)))
    keeps(path, START, GOAL)
    assert gap(Block(*theirs), path) >= RADIUS + KEPT - 1e-9
    standing = plan(name, scene=Scene(others=((Point(0.0, 0.0, 1.5),),)))
    assert gap(Sphere(Point(0.0, 0.0, 1.5), 0.0), standing) >= RADIUS + KEPT - 1e-9


def test_on_the_ground_paths_stay_there() -> None:
    world = World(Box(Point(-5.0, -4.0, -0.5), Point(5.0, 4.0, 3.0)), (WALL,), CLEARANCE, RADIUS, flies=False)
    start, goal = Point(-4.0, 0.0, 0.0), Point(4.0, 0.0, 0.0)
    path, _ = PlannerJudge("rrt-smoothed", world).answer(start, goal, Scene(), SECONDS)
    assert path[0] == start and path[-1] == goal and {p.z for p in path} == {0.0}
    assert PlannerJudge("rrt-smoothed", world).answer(start, GOAL, Scene(), SECONDS)[0] == ()


@pytest.mark.parametrize("name", ["rrt", "rrt-smoothed", "rrt-star"])
def test_with_a_seed_and_a_bound_of_iterations_an_answer_is_the_same_again(name: str) -> None:
    world = World(ARENA, (WALL,), CLEARANCE, RADIUS, seed=7, iterations=2000)
    first = PlannerJudge(name, world).answer(START, GOAL, Scene(), 0.0)
    again = PlannerJudge(name, world)
    assert first == again.answer(START, GOAL, Scene(), 5.0) == again.answer(START, GOAL, Scene(), 1.0)
    assert first[0]


def clutter(source: random.Random) -> tuple[Obstacle, ...]:
    found: list[Obstacle] = []
    for _ in range(source.randint(8, 20)):
        x, y, size = source.uniform(-3.5, 3.5), source.uniform(-3.5, 3.5), source.uniform(0.1, 0.5)
        high = source.uniform(1.0, 3.5)
        found.append(
            source.choice(
                (
                    Block(Point(x - size, y - size, 0.0), Point(x + size, y + size, high)),
                    Sphere(Point(x, y, high / 2), size),
                    Cylinder(Point(x, y, 0.0), size, high),
                )
            )
        )
    return tuple(found)


@pytest.mark.parametrize("name", AROUND)
def test_no_path_through_clutter_collides(name: str) -> None:
    source, found = random.Random(5), 0
    for _ in range(15):
        bodies = clutter(source)
        start, goal = Point(-4.8, source.uniform(-3, 3), 1.5), Point(4.8, source.uniform(-3, 3), 1.5)
        path = plan(name, *bodies, start=start, goal=goal)
        found += bool(path)
        if path:
            keeps(path, start, goal)
            assert min(gap(body, path) for body in bodies) >= KEPT
    assert found >= 14


def test_smoothed_paths_are_short() -> None:
    path = plan("rrt-smoothed", WALL)
    around = distance(START, Point(-0.2, 2.3, 1.5)) + 0.4 + distance(Point(0.2, 2.3, 1.5), GOAL)
    assert sum(distance(p, q) for p, q in pairwise(path)) < 1.03 * around


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("through", "within 0.000 m of obstacle 0"),
        ("nan", "no tuple of finite Points"),
        ("elsewhere", "does not lead from start to goal"),
        ("short", "has 1 points"),
        ("outside", "is outside the arena"),
        ("text", "no tuple of finite Points"),
        ("none_", "no tuple of finite Points"),
        ("raises", "RuntimeError: no map"),
    ],
)
def test_an_answer_that_is_no_way_is_refused(answer: str, said: str) -> None:
    path, why = asked(f"tests.planning.own:{answer.capitalize()}", WALL).answer(START, GOAL, Scene(), SECONDS)
    assert path == () and said in why


def test_ompl_has_what_is_relied_on() -> None:
    """What the docstring of ompl_trees.py lists; the rest of it is used by the tests above."""
    from ompl import base, geometric, util

    util.RNG.setSeed(1)
    space = base.RealVectorStateSpace(3)
    state = space.allocState()
    state[2] = 1.5
    assert state[2] == 1.5
    assert {"RRTConnect", "RRTstar"} <= set(dir(geometric))
    seen: list[tuple[float, float]] = []

    class Lines(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: object, b: object) -> bool:
            seen.append((a[0], b[0]))  # type: ignore[index]
            return True

    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, 2.0)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda s: True)
    lines = Lines(information)
    information.setMotionValidator(lines)
    information.setup()
    other = space.allocState()
    state[0], other[0] = 0.5, 1.0
    assert information.checkMotion(state, other) and seen == [(0.5, 1.0)]
