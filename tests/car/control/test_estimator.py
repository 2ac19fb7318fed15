"""The bicycle's arcs and the filter that runs on them."""

from __future__ import annotations

import math
import random

import pytest

from koordgen.runtime.values.points import Point, Pose
from targets.car.base.bicycle import BicycleState, advance, turning_radius, wrap
from targets.car.control.estimator import Estimator

WHEELBASE = 0.33


@pytest.mark.parametrize(("speed", "steering"), [(1.0, 0.3), (-0.7, 0.3), (1.0, 0.0), (0.5, -0.38), (0.0, 0.2)])
def test_an_arc_is_what_many_small_steps_come_to(speed: float, steering: float) -> None:
    begin = BicycleState(1.0, -2.0, 0.5, speed, steering)
    x, y, yaw = begin.x, begin.y, begin.yaw
    for _ in range(20_000):
        dt = 2.0 / 20_000
        x, y = x + speed * math.cos(yaw) * dt, y + speed * math.sin(yaw) * dt
        yaw += speed * math.tan(steering) / WHEELBASE * dt
    end = advance(begin, 2.0, WHEELBASE)
    assert (end.x, end.y, end.yaw) == pytest.approx((x, y, yaw), abs=1e-3)


def test_a_full_circle_has_the_turning_radius() -> None:
    radius = turning_radius(0.3, WHEELBASE)
    begin = BicycleState(0.0, 0.0, 0.0, 1.0, 0.3)
    half = advance(begin, math.pi * radius, WHEELBASE)
    assert (half.x, half.y) == pytest.approx((0.0, 2 * radius))
    assert abs(wrap(half.yaw - math.pi)) < 1e-9


def pose(x: float, y: float, yaw: float) -> Pose:
    return Pose(Point(x, y, 0.0), yaw)


def test_the_first_sample_is_believed_and_a_jump_is_not() -> None:
    estimator = Estimator(WHEELBASE)
    estimator.predict(1.0, 0.0)
    assert estimator.correct(pose(3.0, 4.0, 1.0), 1.0, 1.0)
    assert (estimator.state.x, estimator.state.y, estimator.state.yaw) == (3.0, 4.0, 1.0)
    for now in (1.02, 1.1, 2.0):
        estimator.predict(now, 0.0)
        assert not estimator.correct(pose(-3.0, 4.0, 1.0), now, now)
    assert estimator.state.x == 3.0 and estimator.time == 1.0
    assert estimator.refused(2.0) == pytest.approx(0.98) and estimator.jumped == pytest.approx(6.0)
    estimator.begin_anew()
    assert estimator.time == 1.0, "until a sample has come, the last believed is the last known"
    assert estimator.correct(pose(-3.0, 4.0, 1.0), 2.02, 2.02)
    assert estimator.state.x == -3.0 and estimator.refused(2.02) == 0.0


def test_a_heading_that_flips_is_a_jump() -> None:
    estimator = Estimator(WHEELBASE)
    estimator.correct(pose(0.0, 0.0, 0.1), 0.0, 0.0)
    assert not estimator.correct(pose(0.0, 0.0, 0.1 + math.pi), 0.02, 0.02)
    assert estimator.correct(pose(0.0, 0.0, 0.3), 0.04, 0.04)


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0])
def test_no_motion_that_a_car_can_make_is_a_jump(speed: float) -> None:
    """Not even after the longest gap that does not brake it, without a word from its wheels."""
    estimator = Estimator(WHEELBASE, speed)
    truth = BicycleState(0.0, 0.0, 0.0, speed, 0.4)
    for i in range(40):
        truth = advance(truth, 0.3, WHEELBASE)
        estimator.predict(0.3 * i, 0.0)
        assert estimator.correct(pose(truth.x, truth.y, wrap(truth.yaw)), 0.3 * i, 0.3 * i)


def test_noise_is_smoothed_without_lag_while_driving() -> None:
    dice = random.Random(6)
    estimator = Estimator(WHEELBASE)
    truth = BicycleState(0.0, 0.0, 3.0, 1.0, 0.2)  # its yaw passes pi
    errors = []
    for i in range(500):
        now = i * 0.02
        estimator.wheels(1.0, now)
        estimator.predict(now, 0.2)
        x, y, yaw = (value + dice.gauss(0, 0.02) for value in (truth.x, truth.y, truth.yaw))
        estimator.correct(pose(x, y, wrap(yaw)), now, now)
        if i > 50:
            errors.append((estimator.state.x - truth.x, estimator.state.y - truth.y))
            assert abs(wrap(estimator.state.yaw - truth.yaw)) < 0.06
        truth = advance(truth, 0.02, WHEELBASE)
    assert math.sqrt(sum(x * x + y * y for x, y in errors) / len(errors)) < 0.02 * math.sqrt(2) * 0.6
    assert abs(sum(x for x, _ in errors) / len(errors)) < 0.003


def test_an_old_sample_is_brought_to_the_present() -> None:
    estimator = Estimator(WHEELBASE)
    for i in range(200):
        now = 1.0 + i * 0.02
        estimator.wheels(1.0, now)
        estimator.predict(now, 0.0)
        estimator.correct(pose(now - 0.1, 0.0, 0.0), now - 0.1, now)
    assert estimator.state.x == pytest.approx(now, abs=0.005)


def test_without_wheels_speed_comes_from_positions_and_ends_with_them() -> None:
    estimator = Estimator(WHEELBASE)
    assert estimator.speed(0.0) is None
    for i in range(100):
        now = i * 0.02
        estimator.predict(now, 0.0)
        estimator.correct(pose(-0.6 * now, 0.0, 0.0), now, now)
    assert estimator.speed(now) == pytest.approx(-0.6, abs=0.02)
    estimator.wheels(-0.5, now)
    assert estimator.speed(now + 0.2) == -0.5
    assert estimator.speed(now + 0.4) is None


def test_a_car_that_stands_is_seen_to_stand_though_positions_are_noisy() -> None:
    dice = random.Random(9)
    estimator = Estimator(WHEELBASE)
    speeds = []
    for i in range(1000):
        now = 0.02 * i
        estimator.predict(now, 0.0)
        x, y, yaw = dice.gauss(0, 0.005), dice.gauss(0, 0.005), dice.gauss(0, 0.02)
        estimator.correct(pose(x, y, yaw), now, now)
        speeds.append(abs(estimator.speed(now) or 0.0))
    assert sum(speed > 0.05 for speed in speeds[20:]) < 10


def test_a_speed_that_is_no_number_is_no_speed() -> None:
    estimator = Estimator(WHEELBASE)
    estimator.wheels(math.nan, 0.0)
    assert estimator.speed(0.0) is None
