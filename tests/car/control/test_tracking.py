"""The tracker where something is in the way, and with the simulated racecar."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from benchmarks.fixtures import racecar
from benchmarks.fixtures.slalom import LIMITS, aside, slalom_path
from targets.car.base.bicycle import BicycleState
from targets.car.control.mpc import BLIND_STEPS, STEP, STEPS, Command, ControlLimits, Mpc
from targets.car.control.tracker import TrackedPath, Tracker
from targets.car.planning.planner import PathPose, Segment
from tests.car.platform.world import TestBody, World

SLOW = ControlLimits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.387, steering_rate=3.0)


def line(length: float) -> Segment:
    poses = tuple(PathPose(0.05 * i, 0.0, 0.0, 0.0) for i in range(round(length / 0.05) + 1))
    return Segment(1, poses, length)


def drive(tracker: Tracker, body: TestBody, clear: Callable[[], float], steps: int) -> list[float]:
    """Drive so many control steps: the speeds commanded."""
    last, speeds = Command(body.truth.speed, 0.0), []
    for _ in range(steps):
        if tracker.done:
            break
        t = body.truth
        last = tracker.step(BicycleState(t.x, t.y, t.yaw, last.speed, last.steering), clear())
        body.drive(last.speed, last.steering)
        for _ in range(12):
            body.step(STEP / 12)
        speeds.append(last.speed)
    return speeds


@pytest.fixture(scope="module")
def mpc() -> Mpc:
    return Mpc(SLOW)


def test_it_stands_before_what_is_in_the_way_and_goes_on_when_it_has_gone(mpc: Mpc) -> None:
    tracker, body = Tracker(SLOW, mpc), TestBody()
    tracker.stop()
    tracker.set_path([line(5.0)])
    speeds = drive(tracker, body, lambda: 2.0 - body.truth.x, 120)
    assert max(speeds) > 0.9
    assert 1.9 < body.truth.x < 2.0
    assert speeds[-1] < 0.02 and tracker.gear == 1, "it waits, the path is not driven yet"
    drive(tracker, body, lambda: math.inf, 120)
    assert tracker.done and abs(body.truth.x - 5.0) < 0.05


def test_its_station_counts_the_segments_that_are_behind(mpc: Mpc) -> None:
    """By it the way that is left is looked at for others' paths."""
    tracker, body = Tracker(SLOW, mpc), TestBody()
    tracker.stop()
    back = Segment(-1, tuple(PathPose(1.0 - 0.05 * i, 0.0, 0.0, 0.0) for i in range(11)), 0.5)
    tracker.set_path([line(1.0), back])
    while tracker.gear == 1 and not tracker.done:
        drive(tracker, body, lambda: math.inf, 1)
    assert tracker.gear == -1 and 0.95 < tracker.station < 1.1
    drive(tracker, body, lambda: math.inf, 15)
    assert abs(tracker.station - (2.0 - body.truth.x)) < 0.05


def test_what_appears_too_near_is_braked_for_as_hard_as_the_limits_allow(mpc: Mpc) -> None:
    tracker, body = Tracker(SLOW, mpc), TestBody()
    tracker.stop()
    tracker.set_path([line(8.0)])
    drive(tracker, body, lambda: math.inf, 30)
    seen = body.truth.x
    speeds = drive(tracker, body, lambda: seen + 0.1 - body.truth.x, 20)
    drops = [a - b for a, b in pairwise(speeds)]
    assert min(drops[:6]) > 0.9 * SLOW.acceleration * STEP
    assert abs(speeds[-1]) < 0.02


@pytest.mark.parametrize("clear", [0.0, -1.0, 0.3, 1.0])
def test_the_reference_stays_before_the_end_of_what_is_clear(clear: float) -> None:
    track = TrackedPath(line(3.0), SLOW)
    for wished in track.reference(0.9, 0.0, clear):
        assert wished.x <= max(0.0, clear) + 1e-9
        assert wished.speed <= math.sqrt(2 * SLOW.acceleration * max(0.0, clear)) + 1e-9


def test_an_obstacle_that_is_no_number_is_one_at_once(mpc: Mpc) -> None:
    track = TrackedPath(line(3.0), SLOW)
    assert max(w.x for w in track.reference(0.9, 0.0, math.nan)) == 0.0


def test_a_path_made_anew_at_each_step_is_driven_without_stopping(mpc: Mpc) -> None:
    """As for a target that moves every round: the plan goes on from path to path."""
    tracker, body = Tracker(SLOW, mpc), TestBody()
    tracker.stop()
    last, slowest = Command(0.0, 0.0), math.inf
    for k in range(160):
        t = body.truth
        ahead = tuple(PathPose(t.x + 0.05 * i, t.y, t.yaw, 0.0) for i in range(17))  # ends 0.8 m ahead, always
        tracker.set_path([Segment(1, ahead, 0.8)])
        last = tracker.step(BicycleState(t.x, t.y, t.yaw, last.speed, last.steering))
        assert not tracker.done and tracker.failures == 0
        body.drive(last.speed, last.steering)
        for _ in range(12):
            body.step(STEP / 12)
        slowest = min(slowest, body.truth.speed) if k > 40 else math.inf
    assert slowest > 0.8


def test_a_solver_that_fails_ten_times_brings_the_car_to_a_stop_and_says_why() -> None:
    tracker, body = Tracker(SLOW, Mpc(SLOW, lambda present, wished, inputs: None)), TestBody()
    body.truth = BicycleState(0.0, 0.0, 0.0, 0.8, 0.0)
    tracker.set_path([line(5.0)])
    speeds = drive(tracker, body, lambda: math.inf, 12)
    assert tracker.failures == 12 > BLIND_STEPS
    assert tracker.trouble == "the solver finds no plan to follow the path"
    assert speeds[-1] == 0.0 and body.truth.x < 0.5


def test_the_slalom_is_as_sharp_and_as_fast_as_it_says() -> None:
    path = slalom_path(4)
    assert {round(abs(p.curvature), 6) for p in path.poses} == {1.0}
    assert TrackedPath(path, LIMITS).reference(1.5, path.poses[0].yaw)[STEPS // 2].speed == pytest.approx(1.5)
    assert aside(path, path.poses[7].x, path.poses[7].y) == pytest.approx(0.0, abs=1e-9)


def test_the_simulated_racecar_keeps_to_the_slalom() -> None:
    figures = racecar.slalom(4)
    assert figures.finished and figures.rms < 0.02 and figures.largest < 0.05 and figures.median_speed > 1.45


@pytest.mark.parametrize("seed", range(20))
def test_the_simulated_racecar_parks_at_a_pose(seed: int) -> None:
    found = racecar.parked(seed)
    assert found.finished and found.away <= 0.05 and found.turned <= 0.15, found


def test_a_car_whose_solver_fails_for_good_stands_and_says_why_and_goes_on_when_it_works_again() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.5)
    assert world.body.truth.speed > 0.5
    navigator = world.car._navigator
    assert navigator is not None
    mpc = navigator._tracker._mpc
    works = mpc._solve
    mpc._solve = lambda present, wished, inputs: None
    told = set()
    world.run(2.5, lambda: told.add(world.car.progress))
    assert abs(world.body.truth.speed) < 0.02
    assert "braking: the solver finds no plan to follow the path" in told
    mpc._solve = works
    world.run(8.0)
    assert world.distance(5.0, 0.0) < 0.1
