"""A car that was carried, restarted or blocked: its next way is planned from where it is; and no progress."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.car_checker import gap, outline
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.car.base.bicycle import BicycleState, advance
from targets.car.control.navigator import STRAYED
from targets.car.platform.platform import Car
from targets.planning.process import Inside
from targets.planning.standstill import NO_PROGRESS
from tests.car.planning.test_avoidance import BODY, BOX, drive, nearest
from tests.car.platform.world import KEY, World, robot_settings, standing

GOAL = Point(3.0, 0.0, 0.0)


def world_with(*obstacles: Block, safety: Safety | None = None, **settings: Any) -> World:
    world = World(**settings)
    world.car = agent(world, *obstacles, safety=safety, **settings)
    return world.begin()


def agent(world: World, *obstacles: Block, safety: Safety | None = None, **settings: Any) -> Car:
    made = msgspec.structs.replace(robot_settings(settings), obstacles=obstacles, safety=safety or Safety())
    return Car(made, KEY, world.wire, Inside)


def planned(world: World) -> tuple[Point, ...]:
    calls = (world.car.call("Motion.planner", (GOAL,)) for _ in range(20))  # the planner's time is the host's
    path: tuple[Point, ...] = next(path for path in calls if path)
    world.car.command({"Motion.path": path}, world.now)
    return path


def test_a_car_that_was_carried_on_hold_has_its_way_planned_anew() -> None:
    world = world_with(BOX)
    planned(world)
    world.run(1.5)
    world.car.hold(True, world.now)
    world.run(2.0)
    world.body.truth = replace(world.body.truth, x=1.5, y=-1.2, yaw=0.0, speed=0.0)
    world.run(2.5)
    world.car.hold(False, world.now)
    assert drive(world, 15.0, BOX) > 0.05
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1


def test_a_car_off_its_way_and_near_to_an_obstacle_brakes_before_its_way_is_planned_anew() -> None:
    world = world_with(BOX)
    planned(world)
    world.run(1.5)
    navigator = world.car._navigator
    assert navigator is not None
    near = BicycleState(1.3, 0.6 + 0.14 + 0.03, 0.0, 0.5)  # half of its width and 3 cm beside the box
    assert world.car._avoidance.strayed(near) and not world.car._avoidance.strayed(replace(near, y=0.9))
    navigator._tracker.step(near)
    assert navigator._tracker.error > STRAYED
    assert navigator.step(near, False, world.now) is None
    assert navigator.progress == "braking: off the path, and near to an obstacle"


def test_a_new_agent_goes_on_amid_the_path() -> None:
    world = world_with(BOX)
    path = planned(world)
    world.run(5.0)
    assert world.body.truth.x > 1.9
    world.car.close()
    world.physics(1.0)
    world.car = agent(world, BOX)
    world.begin()
    world.car.resume({"Motion.path": path}, world.now)
    back: list[float] = []
    world.run(12.0, lambda: back.append(world.body.truth.x))
    assert world.value("reached") is True and world.distance(3.0, 0.0) < 0.1
    assert min(back) > 1.2 and nearest(world, BOX) > 0.05, "it does not drive the path again"


@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_a_car_whose_agent_stops_at_any_moment_is_braked_before_an_obstacle(speed: float) -> None:
    """By the watchdog, after 0.15 s and the motor's lag of 0.1 s, with the steering that it has then."""
    world = world_with(BOX, max_speed=speed)
    planned(world)
    least: list[float] = []

    def stopped() -> None:
        truth, (pace, steering) = world.body.truth, world.body.asked
        way = abs(pace) * 0.25 + pace * pace / (2 * 3.0)
        pieces = math.ceil(way / 0.02) + 1
        end = replace(truth, speed=math.copysign(way / pieces, pace), steering=steering)
        for _ in range(pieces):
            end = advance(end, 1.0, 0.33)
            least.append(gap(outline(BODY, end.x, end.y, end.yaw), BOX))

    world.run(12.0, stopped)
    assert min(least) > 0.0 and world.value("reached") is True


def blocked(**safety: Any) -> World:
    """A car whose wheels turn, and which stays where it is."""
    world = world_with(BOX, safety=Safety(**safety))
    planned(world)
    world.run(1.0)
    truth = world.body.truth

    def stays(seconds: float) -> None:
        world.body.truth = replace(truth, speed=world.body.asked[0])

    world.body.step = stays  # type: ignore[method-assign]
    world.run(NO_PROGRESS + 1.0)
    return world


def test_a_car_that_makes_no_progress_says_so_and_holds() -> None:
    world = blocked()
    (line,) = world.car.log_lines()
    assert line.startswith("no progress for 8 s at (") and line.endswith("braking, and looking for another path")
    world.run(2 * NO_PROGRESS)
    assert "holding until" in world.car.stall, "it stood still twice, or its time for this target is over"
    world.car.log_lines()
    world.run(2 * NO_PROGRESS)
    assert world.car.log_lines() == [] and standing(world)


def test_a_car_that_makes_no_progress_comes_to_rest_where_the_fleet_file_says_so() -> None:
    with pytest.raises(Unready, match="no progress for 8 s"):
        blocked(missed_action="stop")


def test_a_car_that_holds_or_stands_at_its_target_is_not_stalled() -> None:
    world = world_with(BOX)
    planned(world)
    world.run(1.0)
    world.car.hold(True, world.now)
    world.run(2 * NO_PROGRESS)
    world.car.hold(False, world.now)
    world.run(15.0 + 2 * NO_PROGRESS)
    assert world.value("reached") is True and world.car.log_lines() == []
