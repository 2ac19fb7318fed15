"""The car among obstacles: targets around them, planned paths driven as planned, others refused, planning beside it."""

from __future__ import annotations

import math

import msgspec
import pytest

from benchmarks.fixtures import car_scenes as scenes
from benchmarks.fixtures.car_checker import gap, outline
from koordgen.runtime.values.obstacles import Block, Cylinder, Obstacle
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.car.planning.avoidance import MakePlanning
from targets.car.planning.ground import PAD, ground
from targets.car.platform.platform import Car
from targets.planning.pipe import Answer
from targets.planning.process import JUDGE, Inside
from targets.planning.world import Scene
from targets.planning.world import World as PlannerWorld
from tests.car.platform.world import KEY, TestBody, World, robot_settings, standing

BOX = Block(Point(1.2, -0.6, 0.0), Point(1.8, 0.6, 1.0))
WALL_WITH_GAP = Block(Point(1.4, -9.0, 0.0), Point(1.6, -0.8, 1.0)), Block(Point(1.4, 0.8, 0.0), Point(1.6, 9.0, 1.0))
WALL = Block(Point(1.4, -9.0, 0.0), Point(1.6, 9.0, 1.0))
BODY = scenes.world()  # whose outline is the car's


def among(
    *obstacles: Obstacle, body: TestBody | None = None, planning: MakePlanning = Inside, **settings: object
) -> World:
    world = World(body)
    made = msgspec.structs.replace(robot_settings(settings), obstacles=obstacles)
    world.car = Car(made, KEY, world.wire, planning)
    return world.begin()


def nearest(world: World, body: Obstacle) -> float:
    truth = world.body.truth
    return gap(outline(BODY, truth.x, truth.y, truth.yaw), body)


def drive(world: World, seconds: float, *bodies: Obstacle) -> float:
    """Run; how near the car came."""
    gaps: list[float] = [math.inf]
    world.run(seconds, lambda: gaps.extend(nearest(world, body) for body in bodies))
    return min(gaps)


def test_a_target_behind_an_obstacle_is_driven_to_around_it() -> None:
    world = among(BOX)
    world.go(3.0, 0.0)
    assert drive(world, 12.0, BOX) > 0.05, "half the clearance is left for errors"
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


def test_the_planners_path_is_driven_as_it_was_planned() -> None:
    world = among(BOX)
    path = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),))
    assert path[-1] == Point(3.0, 0.0, 0.0) and 3 <= len(path) <= 8
    plan = world.car._avoidance.planned(world.car._estimator.state, path)
    assert plan is not None
    way = [plan.at(plan.length * i / 500)[:2] for i in range(501)]
    world.car.command({"Motion.path": path}, world.now)
    off: list[float] = []

    def look() -> None:
        truth = world.body.truth
        off.append(min(math.dist((truth.x, truth.y), place) for place in way))
        world.car.command({"Motion.path": path}, world.now)  # written anew in every round: nothing changes

    world.run(12.0, look)
    assert max(off) < 0.12 and world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


def test_the_planners_path_from_elsewhere_is_driven_point_by_point() -> None:
    world = among(BOX)
    path = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),))
    world.go(0.0, 1.5)
    world.run(8.0)
    world.car.command({"Motion.path": path}, world.now)
    assert drive(world, 15.0, BOX) > 0.05
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


def test_a_path_through_an_obstacle_is_refused_and_told_once() -> None:
    world = among(BOX)
    through = (Point(0.5, 0.0, 0.0), Point(3.0, 0.0, 0.0))
    for _ in range(3):
        world.car.command({"Motion.path": through}, world.now)
        world.run(1.0)
    assert standing(world) and world.distance(0.0, 0.0) < 0.02 and world.value("reached") is False
    (line,) = world.car.log_lines()
    assert line.startswith("not driven, holding instead: the path from (0.50, 0.00, 0.00)") and "obstacle 0" in line
    assert "comes within 0.00 m of obstacle 0" in world.car.progress
    world.car.command({"Motion.path": (Point(0.5, 0.0, 0.0), Point(0.8, 2.0, 0.0))}, world.now)
    world.run(10.0)
    assert world.value("reached") is True and world.distance(0.8, 2.0) < 0.1 and world.car.log_lines() == []


@pytest.mark.parametrize(
    ("obstacle", "x", "said"),
    [
        (BOX, 1.5, "standing: the goal is too near to obstacle 0: (1.50, 0.00)"),
        (WALL, 3.0, "standing: no path inside the geofence leads there: (3.00, 0.00)"),
        (Block(Point(0.1, -0.1, 0.0), Point(0.3, 0.1, 1.0)), 3.0, "standing: the car is in obstacle 0: (3.00, 0.00)"),
    ],
)
def test_where_no_way_leads_the_car_stands_and_says_why(
    obstacle: Obstacle, x: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("targets.car.planning.avoidance.PATIENCE", 0.05)
    world = among(obstacle)
    world.go(x, 0.0)
    world.run(2.0)
    assert world.car.progress == said
    assert standing(world) and world.distance(0.0, 0.0) < 0.02 and world.value("reached") is False


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        (Point(3.0, 0.0, 0.5), "no path: the goal is not on the ground"),
        (Point(9.0, 0.0, 0.0), "no path: the goal is outside the arena"),
        (Point(1.5, 0.0, 0.0), "no path: the goal is too near to obstacle 0"),
    ],
)
def test_what_the_program_asks_for_in_vain_is_told(goal: Point, said: str) -> None:
    world = among(BOX)
    assert world.car.call("Motion.planner", (goal,)) == () and world.car.log_lines() == [said]


def test_other_robots_paths_are_driven_around() -> None:
    world = among()
    theirs = (Point(1.5, -2.0, 0.0), Point(1.5, 1.0, 0.0))
    world.car.others({1: theirs})
    line = Block(Point(1.5, -2.0, 0.0), Point(1.5 + 1e-9, 1.0, 1.0))
    path = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),))
    assert len(path) > 2
    world.go(3.0, 0.0)
    assert drive(world, 14.0, line) > 0.4, "the others' length"
    assert world.value("reached") is True


class Late(Inside):
    """One whose answers take some polls."""

    polls = 6  # 0.3 s

    def __init__(self, name: str, world: PlannerWorld, budget: float, judge: str = JUDGE) -> None:
        super().__init__(name, world, budget, judge)
        self._left = 0

    def ask(self, start: Point, goal: Point, scene: Scene, more: bytes, seconds: float) -> bool:
        if self.waiting:
            return False
        self._left, self.waiting = self.polls, True
        return super().ask(start, goal, scene, more, seconds)

    def poll(self) -> None:
        self._left = max(0, self._left - 1)

    def answer(self) -> Answer | None:
        if self._left:
            return None
        self.waiting = False
        return super().answer()


def test_while_a_way_is_planned_the_car_goes_on_and_does_not_stop() -> None:
    world = among(body=TestBody(-4.0, 0.0, 0.0), planning=Late)
    slowest = math.inf
    for k in range(100):
        world.go(-2.5 + 0.06 * k, 0.5 * math.sin(0.06 * k))
        world.run(0.1)
        if k > 20:
            slowest = min(slowest, world.body.truth.speed)
    assert slowest > 0.25 and world.distance(-2.5 + 0.06 * 99, 0.5 * math.sin(0.06 * 99)) < 1.6


@pytest.mark.parametrize(
    ("target", "when", "speed", "planning"),
    [
        (Point(-2.2, -4.2, 0.0), -1.4, 2.0, Inside),  # the way back begins in reverse
        (Point(-2.2, -4.2, 0.0), -1.9, 2.0, Late),
        (Point(-2.5, 0.5, 0.0), -1.6, 2.0, Inside),  # it begins with a turn that the car is too fast for
        (Point(-2.5, 0.5, 0.0), -1.6, 1.0, Late),  # it begins where the car no longer is
    ],
)
def test_a_car_that_is_called_away_before_an_obstacle_does_not_touch_it(
    target: Point, when: float, speed: float, planning: MakePlanning
) -> None:
    pillar = Cylinder(Point(0.0, 0.0, 0.0), 0.18, 1.0)
    world = among(pillar, body=TestBody(-1.03, -3.25, 1.29), planning=planning, max_speed=speed)
    world.go(0.54, 0.2)
    while world.body.truth.y < when:
        world.run(0.05)
    world.go(target.x, target.y)
    assert drive(world, 6.0, pillar) > 0.02


@pytest.mark.parametrize("away", [0.015, 0.03])
def test_a_car_that_stands_beside_an_obstacle_leaves_it(away: float) -> None:
    world = among(BOX, body=TestBody(1.4, 0.6 + BODY.radius + away, 0.0))
    world.go(3.5, 1.5)
    assert drive(world, 10.0, BOX) > 0.0 and world.value("reached") is True, world.car.progress


def test_until_the_first_way_is_planned_the_car_stands() -> None:
    world = among(BOX, planning=Late)
    world.go(3.0, 0.0)
    world.run(0.15)
    assert world.car.progress == "standing until a path is planned" and standing(world)
    assert drive(world, 12.0, BOX) > 0.05 and world.value("reached") is True


def test_a_planner_of_the_users_own_answers_points_that_are_driven_one_by_one() -> None:
    world = among(BOX, planner="tests.car.planning.own:Aside")
    path = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),))
    assert path[1] == Point(1.5, 1.5, 0.0)
    world.car.command({"Motion.path": path}, world.now)
    assert drive(world, 15.0, BOX) > 0.05 and world.value("reached") is True
    world = among(planner="tests.planning.own:Raises")
    assert world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),)) == ()
    assert world.car.log_lines() == ["no path: the planner failed: RuntimeError: no map"]
    with pytest.raises(Unready, match="no licence"):
        among(planner="tests.planning.own:Refuses")


def test_without_reverse_it_never_goes_backwards() -> None:
    world = among(BOX, reverse=False)
    world.go(-1.0, 0.5)
    speeds: list[float] = []
    world.run(12.0, lambda: speeds.append(world.body.truth.speed))
    assert min(speeds) > -0.02 and world.value("reached") is True, world.car.progress


@pytest.mark.parametrize(("when", "room"), [(0.9, 0.4), (1.5, 0.0)])
def test_a_car_stops_before_a_path_that_another_publishes_across_its_own_and_goes_on_when_it_is_gone(
    when: float, room: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second comes too late to stop in time: it stops as soon as it can, and stays out of the middle of it."""
    monkeypatch.setattr("targets.car.planning.avoidance.PATIENCE", 0.1)
    world = among(WALL_WITH_GAP[0], WALL_WITH_GAP[1])
    world.go(3.0, 0.0)
    world.run(when)
    assert not standing(world)
    crossing = (Point(2.0, -3.0, 0.0), Point(2.0, 3.0, 0.0))
    world.car.others({1: crossing})
    lane = Block(Point(2.0, -3.0, 0.0), Point(2.0001, 3.0, 1.0))
    assert drive(world, 6.0, lane) > room
    assert standing(world) and world.value("reached") is False
    assert "another robot's path" in world.car.progress or "no path" in world.car.progress
    world.car.others({})
    world.run(12.0)
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


@pytest.mark.parametrize("aside", [0.0, 0.1, 0.3])
def test_a_car_does_not_drive_along_a_lane_in_which_it_stands(aside: float) -> None:
    """Two cars that have published paths through each other's starts would meet."""
    world = among()
    world.car.others({1: (Point(3.0, aside, 0.0), Point(0.0, aside, 0.0))})
    world.go(3.0, 0.0)
    world.run(6.0)
    assert standing(world) and world.distance(0.0, 0.0) < 0.05
    assert world.car.stall.startswith("target (3.00, 0.00) is not approached: the car stands in robot 1's path")
    world.car.others({})
    world.run(8.0)
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


@pytest.mark.parametrize(
    "theirs", [(Point(0.1, -3.0, 0.0), Point(0.1, 3.0, 0.0)), (Point(-3.0, 0.5, 0.0), Point(0.3, 0.1, 0.0))]
)
def test_a_car_leaves_a_lane_that_its_way_soon_leads_out_of(theirs: tuple[Point, Point]) -> None:
    world = among()
    world.car.others({1: theirs})
    world.go(3.0, 0.0)
    world.run(12.0)
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


def test_ways_planned_again_and_again_keep_half_of_the_clearance() -> None:
    """From a place that is too near to an obstacle a way may lead a little nearer: not each time anew."""
    standing, away = ground(scenes.world((BOX,))), 0.099
    for _ in range(50):
        pose = (1.4, 0.6 + BODY.radius + away, 0.0)
        kept = away - standing.around(pose, (9.0, 0.0)).slack(*pose)
        away = min(away, kept + PAD + 1e-9)
    assert away > 0.5 * BODY.clearance


def test_a_clearance_below_the_errors_of_a_car_is_raised_to_them() -> None:
    world = among(BOX, clearance=0.0, tracking_error=0.1, position_error=0.05)
    world.go(1.5, 1.0)
    assert drive(world, 8.0, BOX) > 0.1
    world.go(1.5, 0.8)
    world.run(3.0)
    assert "is too near to obstacle 0 for the car (clearance 0.15 m)" in world.car.stall
