"""The MPC and the tracker on a bicycle whose servo and motor lag: errors, limits, and what a failed solve leads to."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from targets.car.base.bicycle import BicycleState, advance, turning_radius
from targets.car.control.mpc import BLIND_STEPS, STEP, STEPS, Command, ControlLimits, Mpc, choose
from targets.car.control.tracker import TrackedPath, Tracker
from targets.car.planning.planner import PathPose, Segment
from tests.car.platform.world import TestBody

LIMITS = ControlLimits(wheelbase=0.33, speed=1.0, acceleration=1.5, steering=0.387, steering_rate=3.0)
PHYSICS = 12


@pytest.fixture(scope="module")
def mpc() -> Mpc:
    return Mpc(LIMITS)


def curve(
    bend: Callable[[float], float], length: float, direction: int = 1, start: BicycleState | None = None
) -> Segment:
    """A segment with the curvature `bend(station)`."""
    at = start or BicycleState(0.0, 0.0, 0.0)
    poses = [PathPose(at.x, at.y, at.yaw, bend(0.0))]
    count = round(length / 0.05)
    for i in range(1, count + 1):
        kappa = bend((i - 0.5) * length / count)
        at = BicycleState(at.x, at.y, at.yaw, direction * length / count, math.atan(LIMITS.wheelbase * kappa))
        at = advance(at, 1.0, LIMITS.wheelbase)
        poses.append(PathPose(at.x, at.y, at.yaw, kappa))
    return Segment(direction, tuple(poses), length)


def drive(mpc: Mpc, path: list[Segment], body: TestBody, noise: float = 0.0) -> tuple[float, int]:
    """Drive a path to its end: the largest distance of the true car from it, and the control steps it took."""
    dice = random.Random(4)
    tracker = Tracker(LIMITS, mpc)
    tracker.stop()
    tracker.set_path(path)
    last, worst, steps = Command(0.0, 0.0), 0.0, 0
    while not tracker.done and steps < 1200:
        truth = body.truth
        x, y = truth.x + dice.gauss(0, noise), truth.y + dice.gauss(0, noise)
        command = tracker.step(BicycleState(x, y, truth.yaw + dice.gauss(0, noise), last.speed, last.steering))
        assert tracker.failures == 0
        assert abs(command.speed) <= LIMITS.speed and abs(command.steering) <= LIMITS.steering
        assert abs(command.speed - last.speed) <= LIMITS.acceleration * STEP * 1.05 + 1e-3
        assert abs(command.steering - last.steering) <= LIMITS.steering_rate * STEP * 1.05 + 1e-3
        last = command
        body.drive(command.speed, command.steering)
        for _ in range(PHYSICS):
            body.step(STEP / PHYSICS)
        near = min(math.dist((body.truth.x, body.truth.y), (p.x, p.y)) for s in path for p in s.poses)
        worst, steps = max(worst, near), steps + 1
    assert tracker.done
    for _ in range(240):  # braked
        body.drive(0.0, last.steering)
        body.step(1 / 240)
    return worst, steps


def slalom(station: float) -> float:
    return 0.9 * math.sin(2 * math.pi * station / 3.0)


# The distance is to samples 5 cm apart, so 2.5 cm along the way belong to the measure.
@pytest.mark.parametrize(("lag", "noise", "error"), [(0.02, 0.0, 0.035), (0.1, 0.0, 0.045), (0.1, 0.003, 0.05)])
def test_slalom(mpc: Mpc, lag: float, noise: float, error: float) -> None:
    path = [curve(slalom, 12.0)]
    body = TestBody(lag=lag)
    worst, steps = drive(mpc, path, body, noise)
    assert worst < error
    assert steps * STEP < 18.0, "it dawdles"
    end = path[0].poses[-1]
    assert math.dist((body.truth.x, body.truth.y), (end.x, end.y)) < 0.04


def test_it_parks_at_the_end_of_a_curve_in_reverse(mpc: Mpc) -> None:
    sharp = 1 / turning_radius(0.34, LIMITS.wheelbase)
    forward = curve(lambda s: sharp if s < 0.6 else 0.0, 1.5)
    end = forward.poses[-1]
    reverse = curve(lambda s: -sharp, 0.9, -1, BicycleState(end.x, end.y, end.yaw))
    body = TestBody()
    worst, _ = drive(mpc, [forward, reverse], body)
    last = reverse.poses[-1]
    assert worst < 0.06
    assert math.dist((body.truth.x, body.truth.y), (last.x, last.y)) < 0.05
    assert abs(math.remainder(body.truth.yaw - last.yaw, 2 * math.pi)) < 0.1
    assert abs(body.truth.speed) < 0.01


def test_it_comes_back_to_the_path_from_beside_it(mpc: Mpc) -> None:
    body = TestBody(0.0, 0.15, 0.2)
    drive(mpc, [curve(lambda s: 0.0, 4.0)], body)
    assert abs(body.truth.y) < 0.03


def test_yaw_is_taken_the_short_way_round(mpc: Mpc) -> None:
    start = BicycleState(0.0, 0.0, 3.1)
    body = TestBody(0.0, 0.0, -math.pi + 0.01)  # nearly the same heading, a turn apart in numbers
    worst, _ = drive(mpc, [curve(lambda s: 0.0, 3.0, 1, start)], body)
    assert worst < 0.06


def test_speed_falls_for_curves_and_to_zero_at_the_end() -> None:
    fast = ControlLimits(0.33, 3.0, 1.5, 0.387, 3.0)
    track = TrackedPath(curve(lambda s: 1.0 if 4.0 < s < 6.0 else 0.0, 10.0), fast)

    def allowed(station: float) -> float:
        track.station = station
        return track.reference(3.0, 0.0)[0].speed

    assert allowed(0.5) > 2.0
    assert allowed(5.0) == pytest.approx(math.sqrt(0.6 * 1.5), rel=0.01)
    assert allowed(9.0) < 1.4, "it could not stop with what braking is planned for"
    assert allowed(9.95) < 0.35
    assert allowed(10.0) == 0.0


def test_the_reference_gathers_speed_and_never_passes_the_end() -> None:
    track = TrackedPath(curve(lambda s: 0.0, 0.5), LIMITS)
    wished = track.reference(0.0, 0.0)
    assert len(wished) == STEPS
    assert wished[0].speed == pytest.approx(LIMITS.acceleration * STEP)
    assert max(w.x for w in wished) <= 0.5 + 1e-9 and wished[-1].x > 0.4


numbers = st.one_of(st.floats(-20, 20), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e12, 0.0]))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers, numbers, numbers), min_size=2, max_size=5))
def test_whatever_it_is_told_its_commands_are_finite_and_within_limits(
    mpc: Mpc, values: list[tuple[float, float, float, float, float]]
) -> None:
    mpc.reset()
    for value in values[1:]:
        command = mpc.follow(BicycleState(*value), [BicycleState(*values[0])] * STEPS)
        assert math.isfinite(command.speed) and abs(command.speed) <= LIMITS.speed
        assert math.isfinite(command.steering) and abs(command.steering) <= LIMITS.steering


def straight(speed: float) -> list[BicycleState]:
    return [BicycleState(speed * STEP * (k + 1), 0.0, 0.0, speed, 0.0) for k in range(STEPS)]


class Flaky:
    """A solver that answers as told, otherwise rightly."""

    def __init__(self) -> None:
        self._real, _ = choose(LIMITS)
        self.answer: list[float] | None = None
        self.failing = False
        self.seconds = 0.0
        self.time = 0.0

    def clock(self) -> float:
        return self.time

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        self.time += self.seconds
        return self.answer if self.failing else self._real(present, wished, inputs)


@pytest.mark.parametrize(
    ("answer", "seconds", "reason"),
    [
        (None, 0.0, "the solver finds no plan to follow the path"),
        ([math.nan] * 2 * STEPS, 0.0, "the solver finds no plan to follow the path"),
        ([0.0] * 2 * STEPS, 0.08, "the solver took 80 ms, 50 ms are allowed"),
    ],
)
def test_ten_failed_or_late_solves_are_bridged_by_the_plan_before_then_the_car_brakes(
    answer: list[float] | None, seconds: float, reason: str
) -> None:
    solver = Flaky()
    mpc = Mpc(LIMITS, solver, solver.clock)
    state = BicycleState(0.0, 0.0, 0.0, 0.5, 0.0)
    mpc.follow(state, straight(0.9))
    planned = list(mpc._plan)
    assert planned[1].speed > planned[0].speed > 0.5 and mpc.trouble == ""
    solver.failing, solver.answer, solver.seconds = True, answer, seconds
    last = planned[0]
    for k in range(10):
        command = mpc.follow(BicycleState(0.0, 0.0, 0.0, last.speed, last.steering), straight(0.9))
        assert (mpc.failures, mpc.trouble) == (k + 1, reason)
        if k < BLIND_STEPS:
            assert command.speed == pytest.approx(planned[k + 1].speed), "the shifted plan"
        else:
            assert command.speed == pytest.approx(max(0.0, last.speed - LIMITS.acceleration * STEP)), "braking"
        assert command.steering == pytest.approx(0.0, abs=1e-6)
        last = command
    solver.failing, solver.seconds = False, 0.0
    assert mpc.follow(BicycleState(0.0, 0.0, 0.0), straight(0.9)).speed > 0
    assert (mpc.failures, mpc.trouble) == (0, "")


@pytest.mark.parametrize("what", ["state", "speed", "path", "short"])
def test_what_is_no_number_is_refused_and_the_plan_before_stands_in(mpc: Mpc, what: str) -> None:
    mpc.reset()
    first = mpc.follow(BicycleState(0.0, 0.0, 0.0, 0.5, 0.0), straight(0.9))
    second = mpc._plan[1]
    nan = BicycleState(0.0, math.nan, 0.0, first.speed, 0.0)
    state = {"state": nan, "speed": BicycleState(0.0, 0.0, 0.0, math.nan, 0.0)}.get(
        what, BicycleState(0.02, 0, 0, first.speed, 0)
    )
    path = {"path": [*straight(0.9)[:-1], nan], "short": straight(0.9)[:-1]}.get(what, straight(0.9))
    assert mpc.follow(state, path) == second
    own = what in ("state", "speed")
    wrong = "the car's state is not finite" if own else "the path's reference states are not finite"
    assert mpc.trouble == wrong


@pytest.mark.parametrize("wild", [1e6, -1e6])
def test_a_command_is_in_reach_of_the_one_before_whatever_the_solver_says(wild: float) -> None:
    mpc = Mpc(LIMITS, lambda present, wished, inputs: [wild] * 2 * STEPS)
    speed, steering = 0.0, 0.0
    for _ in range(40):
        command = mpc.follow(BicycleState(0.0, 0.0, 0.0, speed, steering), straight(0.9))
        assert abs(command.speed - speed) <= LIMITS.acceleration * STEP + 1e-12
        assert abs(command.steering - steering) <= LIMITS.steering_rate * STEP + 1e-12
        speed, steering = command.speed, command.steering
    assert (abs(speed), abs(steering)) == (LIMITS.speed, LIMITS.steering)


def test_it_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    mpc = Mpc(LIMITS)
    mpc.follow(BicycleState(0.0, 0.0, 0.0), [BicycleState(1e9, -1e9, 40.0, 1.0, 0.3)] * STEPS)
    assert capfd.readouterr() == ("", "")
