"""Planned paths: drivable, inside the geofence, ending at the goal."""

from __future__ import annotations

import math
import random
import time
from itertools import pairwise

import pytest

from targets.car.bicycle import turning_radius
from targets.car.planner import SPACING, Area, Planner, Segment, _segments
from targets.car.settings import CarSettings

RADIUS = CarSettings().planned_radius
# What the planner leaves of the steering for corrections must also cover the chord error of its samples.
SHARPEST = 1 / turning_radius(CarSettings().steering_limit, CarSettings().wheelbase)
AREA = Area(-6.0, -5.0, 6.0, 5.0)


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(RADIUS, AREA)


def assert_drivable(path: list[Segment], start: tuple[float, float, float], area: Area = AREA) -> None:
    """The path is one unbroken curve from the start that a bicycle with the steering limit can follow."""
    at = path[0].poses[0]
    assert (at.x, at.y, at.yaw) == pytest.approx(start, abs=1e-9)
    for before, after in pairwise(path):
        assert after.direction == -before.direction
        a, b = before.poses[-1], after.poses[0]
        assert math.dist((a.x, a.y), (b.x, b.y)) < 2e-3 and abs(a.yaw - b.yaw) < 5e-3
    for part in path:
        assert all(area.contains(p.x, p.y) and abs(p.curvature) <= SHARPEST for p in part.poses)
        for a, b in pairwise(part.poses):
            way = math.dist((a.x, a.y), (b.x, b.y))
            assert 0 < way <= SPACING * 1.001
            assert abs(b.yaw - a.yaw) <= SHARPEST * way + 1e-9
            middle = (a.yaw + b.yaw) / 2 + (0 if part.direction == 1 else math.pi)
            off = math.remainder(math.atan2(b.y - a.y, b.x - a.x) - middle, 2 * math.pi)
            assert abs(off) * way < 1e-3, "the car would have to slip sideways"


def test_random_goals_are_reached_by_drivable_paths(planner: Planner) -> None:
    dice = random.Random(1)
    for _ in range(400):
        start = (dice.uniform(-5, 5), dice.uniform(-4, 4), dice.uniform(-7, 7))
        reach, bearing = dice.choice([0.05, 0.1, 0.3, 1.0, 4.0]), dice.uniform(0, 7)
        goal = (start[0] + reach * math.cos(bearing), start[1] + reach * math.sin(bearing))
        path = planner.plan(start, goal, dice.choice([-1, 0, 1]))
        if not AREA.contains(*goal):
            assert path == []
            continue
        assert path, f"no path from {start} to {goal}"
        assert_drivable(path, start)
        end = path[-1].poses[-1]
        assert math.dist((end.x, end.y), goal) < 2e-3


def test_forward_is_preferred_when_nearly_as_short(planner: Planner) -> None:
    assert [s.direction for s in planner.plan((0, 0, 0), (3, 0.1))] == [1]
    assert [s.direction for s in planner.plan((0, 0, 0), (0.5, 2.5))] == [1]
    assert [s.direction for s in planner.plan((0, 0, 0), (-0.6, 0))] == [-1]


def test_a_straight_way_is_driven_straight(planner: Planner) -> None:
    (part,) = planner.plan((0, 0, 0.3), (3 * math.cos(0.3), 3 * math.sin(0.3)))
    assert part.length == pytest.approx(3.0, abs=1e-3)
    assert max(abs(p.curvature) for p in part.poses) < 1e-3


def test_a_goal_ahead_takes_one_turn_and_a_straight_line(planner: Planner) -> None:
    for x, y in ((3.0, 1.0), (2.0, -2.0), (4.0, 0.3)):
        (part,) = planner.plan((0, 0, 0), (x, y))
        # The tangent from the goal to the turning circle, and the arc up to where it touches.
        away = math.hypot(x, abs(y) - RADIUS)
        straight = math.sqrt(away**2 - RADIUS**2)
        arc = RADIUS * (math.atan2(x, RADIUS - abs(y)) - math.acos(RADIUS / away))
        assert part.length == pytest.approx(straight + arc, abs=2e-3)
        assert all(abs(p.curvature) < 1e-3 for p in part.poses[-10:])


def test_a_gear_change_beside_a_sample_leaves_no_sliver() -> None:
    for beside in (0.0, 1e-9, 1e-6, 1e-4, 0.0499999, 0.049):
        step = 0.05
        cusp = 0.3 + beside
        way = [i * step for i in range(13)]
        points = [(s if s <= cusp else 2 * cusp - s, 0.0, 0.0) for s in way]
        forward = [max(0.0, min(step, cusp - s)) if s < cusp else 0.0 for s in way[:-1]]
        forward = [step if f > 0.9999999 * step else f for f in forward]
        there, back = _segments(points, forward, step)
        assert there.direction == 1 and back.direction == -1
        assert there.length == pytest.approx(cusp, abs=2e-3)
        assert there.length + back.length == pytest.approx(0.6, abs=4e-3)
        for part in (there, back):
            assert all(math.dist((a.x, a.y), (b.x, b.y)) > 5e-4 for a, b in pairwise(part.poses))


def test_beside_the_car_takes_a_manoeuvre_with_both_gears(planner: Planner) -> None:
    path = planner.plan((0, 0, 0), (0, 0.2))
    assert [s.direction for s in path] in ([-1, 1], [1, -1])
    assert sum(s.length for s in path) < 1.2


def test_a_rolling_car_keeps_its_gear_when_it_can(planner: Planner) -> None:
    goal = (0.0, 0.5)
    assert planner.plan((0, 0, 0), goal, 1)[0].direction == 1
    assert planner.plan((0, 0, 0), goal, -1)[0].direction == -1


def test_no_path_leaves_the_fence_and_none_is_invented(planner: Planner) -> None:
    assert planner.plan((0, 0, 0), (7.0, 0.0)) == []
    assert planner.plan((0, 0, 0), (math.nan, 0.0)) == []
    assert planner.plan((math.nan, 0, 0), (1.0, 0.0)) == []
    lane = Area(-3.0, -0.05, 3.0, 0.05)  # too narrow to turn in
    narrow = Planner(RADIUS, lane)
    assert narrow.plan((0, 0, math.pi / 2), (2.0, 0.0)) == []
    assert_drivable(narrow.plan((0, 0, 0), (2.0, 0.0)), (0, 0, 0), lane)


def test_in_a_corner_it_finds_a_way_that_the_fence_allows(planner: Planner) -> None:
    start = (5.9, 4.9, math.pi / 4)  # nose in the corner
    path = planner.plan(start, (5.0, 4.95))
    assert_drivable(path, start)


def test_a_car_that_noise_put_outside_may_come_back(planner: Planner) -> None:
    start = (6.02, 0.0, 0.0)
    path = planner.plan(start, (4.0, 0.0))
    assert [s.direction for s in path] == [-1]
    assert_drivable(path, start, AREA.with_point(6.02, 0.0))


@pytest.mark.parametrize("gear", [-1, 0, 1])
def test_an_arc_to_a_near_goal_is_drivable_and_close_enough(planner: Planner, gear: int) -> None:
    dice = random.Random(2)
    found = 0
    for _ in range(300):
        start = (dice.uniform(-4, 4), dice.uniform(-4, 4), dice.uniform(-7, 7))
        goal = (start[0] + dice.uniform(-0.3, 0.3), start[1] + dice.uniform(-0.3, 0.3))
        path = planner.arc(start, goal, gear, 0.04)
        if path:
            found += 1
            assert_drivable(path, start)
            end = path[0].poses[-1]
            assert math.dist((end.x, end.y), goal) <= 0.04
            assert gear in (0, path[0].direction)
    assert found > 20


def test_arcs_keep_inside_the_fence(planner: Planner) -> None:
    assert planner.arc((5.9, 0, 0), (6.03, 0.0), 1, 0.04) == []
    assert planner.arc((5.9, 0, 0), (5.99, 0.0), 1, 0.04)


def test_planning_takes_milliseconds(planner: Planner) -> None:
    dice = random.Random(3)
    begin = time.process_time()
    for _ in range(100):
        planner.plan((dice.uniform(-5, 5), dice.uniform(-4, 4), dice.uniform(-3, 3)), (dice.uniform(-5, 5), 0.0))
    assert (time.process_time() - begin) / 100 < 0.010
