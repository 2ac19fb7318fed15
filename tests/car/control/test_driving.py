"""The car on its way: to points, after targets that move, and standing where it was sent."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import msgspec
import pytest

from koordgen.runtime.values.points import Point
from targets.car.drive import vesc
from targets.car.platform.platform import Car
from targets.planning.process import Inside
from tests.car.platform.world import FENCE, KEY, TestBody, World, robot_settings, standing


@pytest.mark.parametrize("goal", [(3.0, 1.0), (-2.0, 0.0), (0.0, 0.25), (-3.0, -3.0), (5.95, -4.95)])
def test_it_drives_to_a_point_and_says_when_it_is_there(goal: tuple[float, float]) -> None:
    world = World().begin()
    world.go(*goal)
    assert world.value("reached") is False
    reached_at: list[float] = []

    def look() -> None:
        t = world.body.truth
        assert FENCE.lo.x <= t.x <= FENCE.hi.x and FENCE.lo.y <= t.y <= FENCE.hi.y
        if world.value("reached"):
            assert standing(world), "reached while moving"
            reached_at.append(world.now)

    world.run(15.0, look)
    assert reached_at, world.car.progress
    assert world.distance(*goal) < 0.08  # 0.05 of it, in a corner, is the margin to the fence
    assert standing(world) and world.value("reached") is True
    position = world.value("position")
    assert position.z == 0.0 and math.hypot(position.x - goal[0], position.y - goal[1]) < 0.08


def test_reached_takes_the_dwell_time_and_a_new_target_clears_it() -> None:
    world = World(reached_dwell=2.0).begin()
    world.go(1.0, 0.0)
    world.run(5.0)
    assert standing(world) and world.distance(1, 0) < 0.1
    since: list[float] = []
    world.run(3.0, lambda: since.append(world.now) if not world.value("reached") else None)
    assert world.value("reached") is True
    world.go(1.02, 0.0)
    assert world.value("reached") is False
    world.run(1.0)
    assert world.value("reached") is False
    world.run(1.5)
    assert world.value("reached") is True, "it stands within the radius of the new target"
    world.go(1.02, 0.0)
    assert world.value("reached") is True, "the same target is no new one"


def test_what_was_reached_stays_so_until_a_new_target_comes() -> None:
    world = World().begin()
    world.go(1.0, 0.0)
    world.run(6.0)
    assert world.value("reached") is True
    world.body.truth = replace(world.body.truth, y=world.body.truth.y + 0.12)
    world.run(3.0, lambda: None if world.value("reached") else pytest.fail("no longer reached"))
    world.go(3.0, 0.0)
    assert world.value("reached") is False


def test_velocity_and_position_are_true_while_it_drives() -> None:
    world = World().begin()
    world.go(5.0, 2.0)
    world.run(3.0)
    truth, velocity, position = world.body.truth, world.value("velocity"), world.value("position")
    assert truth.speed > 0.8
    assert velocity.x == pytest.approx(truth.speed * math.cos(truth.yaw), abs=0.1)
    assert velocity.y == pytest.approx(truth.speed * math.sin(truth.yaw), abs=0.1)
    assert math.hypot(position.x - truth.x, position.y - truth.y) < 0.04


@pytest.mark.parametrize("start", [(-3.0, 2.5, -0.6), (0.5, 3.2, 0.4), (-2.0, -0.9, 3.0)])
def test_a_target_that_creeps_as_in_lineform_is_followed_without_stop_and_go(
    start: tuple[float, float, float],
) -> None:
    world = World(TestBody(*start)).begin()
    x, y = start[:2]
    turns: list[int] = []
    stops = 0
    moving = False

    def look() -> None:
        nonlocal moving, stops
        speed = world.body.truth.speed
        gear = (speed > 0.15) - (speed < -0.15)
        if gear and (not turns or turns[-1] != gear):
            turns.append(gear)
        stops += moving and abs(speed) < 0.02
        moving = abs(speed) > 0.05 or (moving and abs(speed) >= 0.02)

    for _ in range(250):
        x, y = x + 0.03 * (-2.0 - x), y + 0.03 * (-0.75 - y)
        world.go(x, y)
        world.run(0.1, look)
    assert len(turns) <= 3 and stops <= 5, (turns, stops)
    world.run(3.0)  # should it stand a hair outside the radius, it goes on
    assert world.distance(-2.0, -0.75) < 0.11  # the radius, and the noise of the estimate
    before = world.body.truth
    world.run(3.0)
    assert world.distance(before.x, before.y) < 0.005, "it still creeps"


@pytest.mark.parametrize(("step", "gap"), [(0.02, 0.12), (0.03, 0.14), (0.06, 0.28)])
def test_while_a_target_moves_steadily_the_car_stays_close_behind(step: float, gap: float) -> None:
    dice = random.Random(5)
    world = World(TestBody(-4.0, 0.0, 0.0)).begin()
    gaps = []
    for k in range(round(8.0 / step)):
        x = -4.0 + step * k
        y = 0.3 * math.sin(x)
        world.go(x + dice.gauss(0, 0.003), y + dice.gauss(0, 0.003))
        world.run(0.1)
        if k > 60:
            gaps.append(world.distance(x, y))
            course = math.atan(0.3 * math.cos(x))
            assert abs(math.remainder(world.body.truth.yaw - course, 2 * math.pi)) < 0.5, "it sways"
            assert world.body.truth.speed > 0.1, "stop-and-go"
    assert max(gaps) < gap


@pytest.mark.parametrize(
    ("x", "y", "dx", "dy"),
    [(0.18, -0.67, -0.0082, 0.0008), (-0.36, -0.5, 0.0068, -0.0021), (-0.36, 0.69, 0.018, -0.005)],
)
def test_a_target_that_drifts_by_beside_is_not_chased_by_endless_changes_of_gear(
    x: float, y: float, dx: float, dy: float
) -> None:
    world = World().begin()
    nearest = math.inf
    for _ in range(120):
        x, y = x + dx, y + dy
        world.go(x, y)
        world.run(0.1)
        nearest = min(nearest, world.distance(x, y))
    assert nearest < 0.15


def test_noise_does_not_wake_a_car_that_has_arrived_but_a_move_does() -> None:
    world = World().begin()
    world.go(1.0, 0.0)
    world.run(6.0)
    at = world.body.truth
    for k in range(100):
        world.go(1.0 + 0.03 * math.sin(k), 0.03 * math.cos(k))
        world.run(0.1)
    assert world.distance(at.x, at.y) < 0.002
    world.go(at.x + 0.13, at.y)  # within 1.5 radii: after a while
    world.run(0.5)
    assert world.distance(at.x, at.y) < 0.002
    world.run(3.0)
    assert world.distance(at.x + 0.13, at.y) < 0.10
    world.go(at.x + 0.5, at.y)
    world.run(0.5)
    assert world.distance(at.x, at.y) > 0.1


def test_it_stops_short_of_no_target_by_much_whatever_its_lag() -> None:
    for lag, error in ((0.05, 0.03), (0.1, 0.03), (0.15, 0.03)):
        world = World(TestBody(lag=lag), noise=0.0).begin()
        world.go(2.5, 0.0)
        world.run(6.0)
        assert world.distance(2.5, 0.0) < error, lag


def test_an_unreachable_target_is_said_and_the_car_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("targets.car.planning.avoidance.PATIENCE", 0.05)
    # Nose to the wall in a lane too narrow to turn in.
    settings = msgspec.structs.replace(
        robot_settings({}), geofence=type(FENCE)(Point(-3.0, -0.04, -1.0), Point(3.0, 0.04, 1.0))
    )
    world = World(TestBody(0.0, 0.0, math.pi / 2))
    world.car = Car(settings, KEY, world.wire, Inside)
    world.begin()
    world.go(2.0, 0.0)
    world.run(2.0)
    assert "no path inside the geofence leads there: (2.00, 0.00)" in world.car.progress
    assert standing(world) and world.distance(0, 0) < 0.01 and world.value("reached") is False


def test_a_car_that_is_stuck_says_so() -> None:
    world = World().begin()
    world.body.drive = lambda speed, steering: None  # type: ignore[method-assign]
    world.go(2.0, 0.0)
    world.run(4.0)
    assert "has not moved for" in world.car.progress
    sent = [m for m in vesc.Decoder().feed(world.wire.to_drive) if isinstance(m, vesc.SetErpm)]
    assert all(abs(m.erpm) <= 0.6 * 4614 for m in sent), "it winds up"
