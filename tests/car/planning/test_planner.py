"""Planned ways: drivable, clear of everything by the exact checker, inside the arena, ending at the goal."""

from __future__ import annotations

import math
import random
import time
from itertools import pairwise

import pytest

from benchmarks.fixtures.car_checker import collisions, gap, infeasible, outline, poses
from benchmarks.fixtures.car_scenes import CAR, ROOM, ask, case, curve, world
from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Grid, Point
from targets.car.base.bicycle import wrap
from targets.car.planning.ask import CarJudge
from targets.car.planning.curves import Curve, Triple, along, dubins, reeds_shepp
from targets.car.planning.planner import NEAR_POINTS, arc, points, price, segments
from targets.planning.ask import NAMES
from targets.planning.world import Scene

RADIUS = CAR.planned_radius
START, GOAL = (1.0, 4.0, 0.0), Point(6.0, 4.0, 0.0)
WALL = Block(Point(3.4, 0.0, 0.0), Point(3.6, 5.5, 1.0))
ACROSS = Block(Point(3.4, -1.0, 0.0), Point(3.6, 9.0, 1.0))


def random_poses(count: int) -> list[tuple[Triple, Triple]]:
    dice = random.Random(1)
    found = []
    for _ in range(count):
        reach = dice.choice([0.05, 0.5, 2.0, 8.0])

        def pose(reach: float = reach) -> Triple:
            return dice.uniform(-reach, reach), dice.uniform(-reach, reach), dice.uniform(-7, 7)

        found.append((pose(), pose()))
    return found


@pytest.mark.parametrize("kind", ["ReedsSheppStateSpace", "DubinsStateSpace"])
def test_curves_are_as_short_as_ompl_says_and_end_where_they_should(kind: str) -> None:
    from ompl import base

    space = getattr(base, kind)(RADIUS)
    a, b = space.allocState(), space.allocState()
    solve = reeds_shepp if kind.startswith("Reeds") else dubins
    for start, goal in random_poses(600):
        for state, pose in ((a, start), (b, goal)):
            state.setXY(pose[0], pose[1])
            state.setYaw(wrap(pose[2]))
        length = space.distance(a, b)
        for found in (solve(start, goal, RADIUS), solve(start, goal, RADIUS, length)):
            assert found.length == pytest.approx(length, abs=1e-6)
            assert math.dist(found.end[:2], goal[:2]) < 1e-9 and abs(wrap(found.end[2] - goal[2])) < 1e-9
            if solve is dubins:
                assert all(way > 0 for _, way in found.pieces)


def test_a_part_of_a_curve_is_a_curve() -> None:
    for start, goal in random_poses(50):
        whole = reeds_shepp(start, goal, RADIUS)
        begin, end = 0.3 * whole.length, 0.8 * whole.length
        part = Curve(whole.at(begin), whole.between(begin, end))
        assert part.length == pytest.approx(end - begin) and part.end == pytest.approx(whole.at(end))


def test_segments_are_a_curve_as_the_tracker_takes_it() -> None:
    for start, goal in random_poses(100):
        whole = reeds_shepp(start, goal, RADIUS)
        path = segments(whole)
        assert not infeasible(world(), path)
        assert math.dist((path[-1].poses[-1].x, path[-1].poses[-1].y), goal[:2]) < 1e-3
        assert sum(part.length for part in path) == pytest.approx(whole.length, abs=1e-3)


def test_points_stand_for_a_curve() -> None:
    for start, goal in random_poses(60):
        whole = reeds_shepp(start, goal, RADIUS)
        few = points(whole)
        assert few[0] == start[:2] and math.dist(few[-1], goal[:2]) < 1e-9
        tips = [sum(abs(way) for _, way in whole.pieces[:i]) for i in range(len(whole.pieces))]
        for station in [*tips, *(whole.length * i / 500 for i in range(501))]:
            p = whole.at(station)[:2]
            assert min(_off(a, b, p) for a, b in pairwise(few)) <= NEAR_POINTS + 1e-9


def _off(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    square = dx * dx + dy * dy
    share = max(0.0, min(1.0, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square)) if square else 0.0
    return math.dist(p, (a[0] + share * dx, a[1] + share * dy))


@pytest.mark.parametrize("name", NAMES)
def test_free_ground_is_crossed_by_a_single_curve(name: str) -> None:
    answer = ask(CarJudge(name, world()), START, GOAL)
    assert answer.path == (Point(1.0, 4.0, 0.0), GOAL)
    (piece,) = curve(answer).pieces
    assert piece == pytest.approx((0.0, 5.0))


@pytest.mark.parametrize("name", ["rrt", "rrt-smoothed", "rrt-star"])
@pytest.mark.parametrize("reverse", [True, False])
def test_a_wall_is_driven_around(name: str, reverse: bool) -> None:
    place = world((WALL,), reverse, seed=3)
    answer = ask(CarJudge(name, place), START, GOAL, seconds=0.5)
    assert answer.path[0] == Point(1.0, 4.0, 0.0) and answer.path[-1] == GOAL
    path = segments(curve(answer))
    assert not collisions(place, path) and not infeasible(place, path)
    assert reverse or {part.direction for part in path} == {1}


def test_straight_is_a_single_curve_or_nothing() -> None:
    assert ask(CarJudge("straight", world((WALL,))), START, GOAL).path == ()


@pytest.mark.parametrize("seed", range(12))
def test_ways_through_clutter_are_drivable_and_collide_nowhere(seed: int) -> None:
    scene = case(seed)
    place = scene.world(seed=seed)
    goal = Point(scene.goal[0], scene.goal[1], 0.0)
    for heading in (scene.goal[2], None):
        answer = ask(CarJudge("rrt-smoothed", place), scene.start, goal, seconds=0.02, heading=heading)
        assert answer.path, answer.reason
        found = curve(answer)
        path = segments(found)
        assert not collisions(place, path) and not infeasible(place, path)
        assert math.dist(found.end[:2], scene.goal[:2]) < 1e-6
        assert heading is None or abs(wrap(found.end[2] - heading)) < 1e-6


def test_with_a_seed_and_a_bound_of_iterations_an_answer_is_the_same_again() -> None:
    place = world((WALL,), seed=7, iterations=200)
    first = ask(CarJudge("rrt-smoothed", place), START, GOAL, seconds=0.0, patience=0.0)
    again = CarJudge("rrt-smoothed", place)
    assert first.path and first == ask(again, START, GOAL, seconds=1.0) == ask(again, START, GOAL, seconds=5.0)


@pytest.mark.parametrize(
    ("start", "goal", "bodies", "said"),
    [
        (START, Point(6.0, 4.0, 1.0), (), "the goal is not on the ground"),
        (START, Point(6.0, 9.0, 0.0), (), "the goal is outside the arena"),
        (START, Point(math.nan, 4.0, 0.0), (), "start or goal is not finite"),
        ((math.inf, 0.0, 0.0), GOAL, (), "start or goal is not finite"),
        (START, Point(3.5, 4.0, 0.0), (WALL,), "the goal is too near to obstacle 0"),
        (START, Point(3.3, 4.0, 0.0), (WALL,), "the goal is too near to obstacle 0"),
        ((3.0, 4.0, 0.0), GOAL, (WALL,), "the car is in obstacle 0"),
        ((3.5, 4.0, 0.0), GOAL, (WALL,), "the car is in obstacle 0"),
    ],
)
@pytest.mark.parametrize("name", NAMES)
def test_what_is_infeasible_has_no_way(
    name: str, start: Triple, goal: Point, bodies: tuple[Obstacle, ...], said: str
) -> None:
    answer = ask(CarJudge(name, world(bodies)), start, goal)
    assert answer.path == () and said in answer.reason


@pytest.mark.parametrize("name", NAMES)
def test_behind_a_wall_without_a_gap_there_is_no_way(name: str) -> None:
    answer = ask(CarJudge(name, world((ACROSS,))), START, GOAL, seconds=0.05, patience=0.05)
    assert answer.path == () and answer.reason == ""


def test_a_tight_place_may_be_left_but_no_nearer_to_what_is_there() -> None:
    start = (3.35 - (CAR.length - CAR.overhang), 4.0, 0.0)  # its nose 5 cm from the wall
    place = world((WALL,))
    answer = ask(CarJudge("rrt-smoothed", place), start, Point(1.0, 2.0, 0.0))
    assert answer.path
    nearest = min(gap(outline(place, *pose), WALL) for pose in poses(segments(curve(answer))))
    assert 0.9 * 0.05 < nearest <= 0.05 + 1e-9


def test_what_hangs_above_or_lies_below_is_not_in_the_way() -> None:
    above = Block(Point(3.0, -1.0, CAR.height + 0.01), Point(4.0, 9.0, 2.0))
    ball = Sphere(Point(3.5, 4.0, 1.0), 0.7)
    assert len(curve(ask(CarJudge("rrt", world((above, ball))), START, GOAL)).pieces) == 1
    low = Sphere(Point(3.5, 4.0, 0.8), 0.7)  # 0.43 m wide at the car's height
    place = world((low,))
    path = segments(curve(ask(CarJudge("rrt", place), START, GOAL)))
    section = Cylinder(Point(3.5, 4.0, 0.0), math.sqrt(0.49 - 0.55**2), 1.0)
    assert not collisions(world((section,)), path)


def test_a_mesh_is_driven_around() -> None:
    corners = (Point(3.5, -1.0, 0.0), Point(3.5, 5.5, 0.0), Point(3.5, 5.5, 1.0), Point(3.5, -1.0, 1.0))
    place = world((Mesh(corners, ((0, 1, 2), (0, 2, 3))),), seed=1)
    path = segments(curve(ask(CarJudge("rrt", place), START, GOAL)))
    thin = Block(Point(3.5, -1.0, 0.0), Point(3.5 + 1e-9, 5.5, 1.0))
    assert not collisions(world((thin,)), path)


def test_cells_points_and_others_ways_are_driven_around() -> None:
    cells = tuple(Grid(14, j, 0.25) for j in range(22))
    place = world(seed=5)
    path = segments(curve(ask(CarJudge("rrt", place), START, GOAL, Scene(grids=cells))))
    assert not collisions(world((Block(Point(3.5, 0.0, 0.0), Point(3.75, 5.5, 1.0)),)), path)
    posts = tuple(Point(3.5, 0.2 * j, 0.0) for j in range(28))
    path = segments(curve(ask(CarJudge("rrt", place), START, GOAL, Scene(points=posts))))
    assert not collisions(world(tuple(Cylinder(p, 0.0, 1.0) for p in posts)), path)
    theirs = (Point(3.5, 0.0, 0.0), Point(3.5, 5.0, 0.0))
    path = segments(curve(ask(CarJudge("rrt", place), START, GOAL, Scene(others=(theirs,)))))
    reach = math.hypot(CAR.length - CAR.overhang, CAR.width / 2)
    for at in (0.0, 2.5, 5.0):
        assert not collisions(world((Cylinder(Point(3.5, at, 0.0), reach, 1.0),)), path)


@pytest.mark.parametrize(("height", "around"), [(0.0, True), (0.8, True), (1.0, False)])
def test_ways_that_lead_over_the_car_are_not_in_its_way(height: float, around: bool) -> None:
    theirs = (Point(3.5, 0.0, height), Point(3.5, 5.0, height))
    path = segments(curve(ask(CarJudge("rrt", world(seed=5)), START, GOAL, Scene(others=(theirs,)))))
    assert bool(collisions(world((Cylinder(Point(3.5, 4.0, 0.0), 0.1, 1.0),)), path)) is not around


def test_what_a_program_names_where_the_car_is_was_seen_wrongly() -> None:
    seen = Scene(points=(Point(1.1, 4.0, 0.0),), others=((Point(1.0, 4.0, 0.0), Point(1.0, 6.0, 0.0)),))
    assert ask(CarJudge("rrt", world()), START, GOAL, seen).path


def test_the_cheaper_way_is_taken_and_a_rolling_car_keeps_its_gear_when_it_can() -> None:
    planner = CarJudge("rrt-smoothed", world())
    ways = {(0.3, 3.0): [1], (-0.6, 0.0): [-1], (3.0, 0.1): [1]}
    for (ahead, aside), gears in ways.items():
        found = segments(curve(ask(planner, (3.5, 4.0, 0.0), Point(3.5 + ahead, 4.0 + aside, 0.0))))
        assert [part.direction for part in found] == gears
    for gear in (1, -1):
        found = segments(curve(ask(planner, (3.5, 4.0, 0.0), Point(3.5, 4.5, 0.0), gear=gear)))
        assert found[0].direction == gear
    beside = segments(curve(ask(planner, (3.5, 4.0, 0.0), Point(3.5, 4.2, 0.0))))
    assert [part.direction for part in beside] in ([-1, 1], [1, -1])


def test_the_arena_is_kept_and_who_noise_put_outside_comes_back() -> None:
    planner = CarJudge("rrt-smoothed", world(seed=2))
    corner = (6.9, 7.9, math.pi / 4)
    path = segments(curve(ask(planner, corner, Point(6.0, 7.95, 0.0))))
    assert not collisions(world(), path)
    found = curve(ask(planner, (7.02, 4.0, 0.0), Point(5.0, 4.0, 0.0)))
    assert found.pieces[0][1] < 0 and max(found.at(s / 10)[0] for s in range(20)) <= 7.02
    lane = Box(Point(0.0, 3.95, 0.0), Point(7.0, 4.05, 1.0))
    assert (
        ask(CarJudge("rrt", world(arena=lane)), (1.0, 4.0, math.pi / 2), GOAL, seconds=0.05, patience=0.05).path == ()
    )
    assert world().arena == ROOM


@pytest.mark.parametrize("gear", [-1, 0, 1])
def test_an_arc_to_a_near_goal_is_drivable_and_close_enough(gear: int) -> None:
    dice, found = random.Random(2), 0
    for _ in range(300):
        start = (dice.uniform(-4, 4), dice.uniform(-4, 4), dice.uniform(-7, 7))
        goal = (start[0] + dice.uniform(-0.3, 0.3), start[1] + dice.uniform(-0.3, 0.3))
        way = arc(RADIUS, start, goal, gear, 0.04)
        if way is not None:
            found += 1
            assert not infeasible(world(), segments(way)) and math.dist(way.end[:2], goal) <= 0.04
            assert gear * way.pieces[0][1] >= 0
    assert found > 20


def test_a_price_counts_reverse_and_changes_of_gear() -> None:
    assert price(((0.0, 1.0), (0.5, 1.0))) == 2.0
    assert price(((0.0, 1.0), (0.5, -1.0))) == 1.0 + 0.5 + 1.1
    assert price(((0.0, -1.0),), gear=1) == 0.5 + 1.1
    assert along((0.0, 0.0, 0.0), 0.0, -1.0) == (-1.0, 0.0, 0.0)


def test_ompl_has_what_is_relied_on() -> None:
    """What the docstring of ompl_space.py lists; the rest of it is used by the tests above."""
    from ompl import base, geometric

    space = base.ReedsSheppStateSpace(1.0)
    state = space.allocState()
    state.setXY(1.0, 2.0)
    state.setYaw(0.5)
    assert (state.getX(), state.getY(), state.getYaw()) == (1.0, 2.0, 0.5)
    information = base.SpaceInformation(space)
    goals = base.GoalStates(information)
    goals.addState(state)
    assert goals.getStateCount() == 1
    problem = base.ProblemDefinition(information)
    problem.addStartState(state)
    problem.setGoal(goals)
    tree = geometric.RRT(information)
    tree.setRange(1.5)
    tree.setGoalBias(0.3)
    assert (tree.getRange(), tree.getGoalBias()) == (1.5, 0.3)


def test_a_map_of_many_cells_is_planned_in_soon() -> None:
    cells = tuple(Grid(i, j, 0.05) for i in range(64, 76) for j in range(110)) + tuple(
        Grid(i, j, 0.05) for i in range(140) for j in (0, 1, 158, 159)
    )
    place = world(seed=1)
    began = time.process_time()
    answer = ask(CarJudge("rrt", place), START, GOAL, Scene(grids=cells))
    assert time.process_time() - began < 1.0
    assert not collisions(world((Block(Point(3.2, 0.0, 0.0), Point(3.8, 5.5, 1.0)),)), segments(curve(answer)))
