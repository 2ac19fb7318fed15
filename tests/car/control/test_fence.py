"""The geofence ahead: at every speed the car is braked before it would leave, and what leads away from it is driven."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point
from targets.car.base.bicycle import BicycleState, advance
from targets.car.control.fence import beyond, stops_inside
from targets.car.control.mpc import STEP, Command
from tests.car.platform.world import FENCE, TestBody, World

WHEELBASE, DECELERATION = 0.33, 3.0
LARGE = Box(Point(-20.0, -20.0, 0.0), Point(20.0, 20.0, 1.0))


def brakes(state: BicycleState, command: Command, fence: Box = FENCE) -> bool:
    return not stops_inside(fence, state, command, DECELERATION, WHEELBASE)


def farthest(speed: float, steering: float, yaw: float) -> tuple[float, float]:
    """How far out a car gets, metres, that drives at a speed until it is braked; and how far from the fence it stands
    then. Its motor follows with a lag of 0.1 s; it brakes with DECELERATION. (The bicycle model.)"""
    state = BicycleState(0.0, 0.0, yaw, speed, steering)
    out, braking = -math.inf, False
    for _ in range(4000):
        braking = braking or brakes(state, Command(speed, steering), LARGE)
        for _ in range(10):
            if braking:
                slower = min(abs(state.speed) * (STEP / 10) / 0.1, DECELERATION * STEP / 10)
                state = replace(state, speed=math.copysign(max(0.0, abs(state.speed) - slower), speed))
            state = advance(state, STEP / 10, WHEELBASE)
            out = max(out, beyond(LARGE, state.x, state.y))
        if braking and abs(state.speed) < 1e-3:
            return out, -beyond(LARGE, state.x, state.y)
    raise AssertionError("it never met the fence")


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, -0.5, -1.5, -3.0])
@pytest.mark.parametrize(("steering", "yaw"), [(0.0, 0.0), (0.0, 0.7), (0.01, 2.0), (-0.005, -1.2)])
def test_it_stops_inside_at_every_speed_and_not_far_from_it(speed: float, steering: float, yaw: float) -> None:
    out, left = farthest(speed, steering, yaw)
    assert out <= 0.0
    assert left < 0.05 + 0.15 * abs(speed), "it brakes far too early"


def test_it_may_turn_before_the_fence_and_drive_along_it() -> None:
    along = BicycleState(0.0, 4.98, 0.0, 3.0)
    assert not brakes(along, Command(3.0, 0.0))
    assert brakes(along, Command(3.0, 0.1))
    assert not brakes(BicycleState(5.0, 0.0, 0.0, 1.0), Command(1.0, 0.4)), "its circle of 0.8 m has room"
    assert brakes(BicycleState(5.7, 0.0, 0.0, 1.0), Command(1.0, 0.0))


def test_the_present_speed_counts_as_the_commanded_one_does() -> None:
    assert brakes(BicycleState(5.5, 0.0, 0.0, 2.0), Command(0.1, 0.0))
    assert brakes(BicycleState(5.9, 0.0, 0.0, 0.0), Command(1.0, 0.0))
    assert not brakes(BicycleState(5.5, 0.0, 0.0, 0.0), Command(-2.0, 0.0))


def test_a_car_outside_may_come_back_and_not_go_on() -> None:
    outside = BicycleState(6.2, 0.0, 0.0)
    assert brakes(outside, Command(0.3, 0.0))
    assert not brakes(outside, Command(-0.3, 0.0))


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_not_finite_is_not_driven(wrong: float) -> None:
    assert brakes(BicycleState(0.0, 0.0, 0.0), Command(wrong, 0.0))
    assert brakes(BicycleState(0.0, 0.0, 0.0), Command(0.1, wrong))
    assert brakes(BicycleState(wrong, 0.0, 0.0), Command(0.1, 0.0))


def test_corners_in_any_order() -> None:
    box = Box(FENCE.hi, FENCE.lo)
    assert beyond(box, 0.0, 0.0) == -5.0 and beyond(box, 7.0, 0.0) == 1.0
    assert beyond(box, 0.0, -8.0) == 3.0


@pytest.mark.parametrize("speed", [1.0, 2.0, 3.0])
def test_a_navigator_gone_mad_does_not_get_the_car_out(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(TestBody(0.0, 0.0, 0.1), max_speed=speed).begin()
    navigator = world.car._navigator
    assert navigator is not None
    monkeypatch.setattr(navigator, "step", lambda state, standing, now: Command(speed, 0.0))
    world.car.command({"Motion.target": Point(5.0, 0.0)}, world.now)
    said = set()

    def look() -> None:
        truth = world.body.truth
        assert beyond(FENCE, truth.x, truth.y) < 0.0
        said.add(world.car.progress)

    world.run(9.0, look)
    assert "braking: the geofence is ahead" in said
    assert world.body.truth.x > 4.0
