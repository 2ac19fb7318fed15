"""The reference trajectory: its limits, its corridor, its end, and that it may be changed at any moment."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.safety import clamp
from targets.quad.motion.trajectory import CLOSE, CORNER, ZERO, MotionLimits, MotionState, Trajectory, norm, plan

BOX = Box(Point(-6, -5, 0), Point(6, 5, 4))
LIMITS = MotionLimits(1.0, 0.7, 1.0, BOX)
coordinates = st.floats(-6, 6) | st.sampled_from((-1.0, 0.0, 1.0, 1.0 + CLOSE / 2))
points = st.builds(lambda *c: clamp(BOX, Point(*c)), coordinates, coordinates, st.floats(0, 4) | st.just(1.5))
paths = st.lists(points, min_size=1, max_size=6)
limits = st.builds(MotionLimits, st.floats(0.1, 5), st.floats(0.1, 2), st.floats(0.1, 5), st.just(BOX))
starts = st.builds(MotionState, points)


def moments(trajectory: Trajectory, n: int = 200) -> list[MotionState]:
    return [trajectory.at(trajectory.seconds * i / n) for i in range(n + 1)]


def to_segment(p: Point, a: Point, b: Point) -> float:
    d, e = b - a, p - a
    length = d.x**2 + d.y**2 + d.z**2
    t = 0.0 if length == 0 else max(0.0, min(1.0, (d.x * e.x + d.y * e.y + d.z * e.z) / length))
    return distance(p, a + d * t)


def off_path(p: Point, path: list[Point]) -> float:
    return min((to_segment(p, a, b) for a, b in itertools.pairwise(path)), default=distance(p, path[0]))


def assert_kept(trajectory: Trajectory, limit: MotionLimits) -> None:
    """Limits, and a velocity that never jumps."""
    ends = [piece.at(piece.seconds) for piece in trajectory.pieces]
    for piece, end in zip(trajectory.pieces, ends, strict=True):
        assert norm(piece.acceleration) <= limit.acceleration * (1 + 1e-6)
        for state in (piece.start, end):  # the speed is largest at one of a piece's ends
            assert norm(state.velocity) <= limit.speed * (1 + 1e-6) + 1e-9
            assert abs(state.velocity.z) <= limit.climb * (1 + 1e-6) + 1e-9
    begins = [*(piece.start for piece in trajectory.pieces[1:]), trajectory.end][: len(ends)]
    for end, after in zip(ends, begins, strict=True):
        assert distance(end.position, after.position) < 2 * CLOSE * CLOSE + 1e-6
        assert distance(end.velocity, after.velocity) < 1e-5


def test_from_rest_to_rest_takes_the_time_of_the_formula() -> None:
    step = plan(MotionState(ZERO), [Point(1.0)], LIMITS)
    assert step.seconds == pytest.approx(2.0) and norm(step.at(1.0).velocity) == pytest.approx(1.0)
    far = plan(MotionState(ZERO), [Point(4.0)], LIMITS)
    assert far.seconds == pytest.approx(5.0)  # a second each for starting and braking, three at full speed
    up = plan(MotionState(ZERO), [Point(0.0, 0.0, 1.4)], LIMITS)
    assert up.seconds == pytest.approx(1.4 / 0.7 + 0.7)


def test_a_corner_is_passed_at_speed_and_within_its_tolerance() -> None:
    corner = plan(MotionState(ZERO), [Point(3.0), Point(3.0, 3.0)], LIMITS)
    nearest = min(moments(corner, 2000), key=lambda s: distance(s.position, Point(3.0)))
    assert distance(nearest.position, Point(3.0)) == pytest.approx(CORNER, abs=1e-3)
    assert norm(nearest.velocity) > 0.4
    assert corner.seconds < 2 * plan(MotionState(ZERO), [Point(3.0)], LIMITS).seconds - 0.5


@given(starts, paths, limits)
@settings(deadline=None)
def test_a_path_from_rest(start: MotionState, path: list[Point], limit: MotionLimits) -> None:
    trajectory = plan(start, path, limit)
    assert_kept(trajectory, limit)
    assert trajectory.end == MotionState(path[-1]) and trajectory.at(trajectory.seconds + 1.0) == MotionState(path[-1])
    line = [start.position, *path]
    for state in moments(trajectory):
        assert off_path(state.position, line) <= CORNER + CLOSE
        assert off_path(limit.stop(state), line) <= CORNER + CLOSE  # also when it is paused there
    for p in path:
        assert min(distance(s.position, p) for s in moments(trajectory, 2000)) < CORNER + 0.02 * limit.speed + CLOSE


@given(starts, st.lists(st.tuples(paths, st.floats(0, 4)), min_size=2, max_size=6), limits)
@settings(deadline=None, max_examples=200)
def test_it_may_be_changed_at_any_moment(
    start: MotionState, changes: list[tuple[list[Point], float]], limit: MotionLimits
) -> None:
    """Whatever it is changed to, braking never leads out of the box by more than a corner's tolerance."""
    state = start
    for path, after in changes:
        trajectory = plan(state, path, limit)
        assert_kept(trajectory, limit)
        if trajectory.pieces:
            assert distance(trajectory.at(0.0).velocity, state.velocity) < 1e-6
            assert distance(trajectory.at(0.0).position, state.position) < 1e-6
        assert trajectory.end == MotionState(path[-1])
        for moment in moments(trajectory, 60):
            stop = limit.stop(moment)
            assert distance(stop, clamp(BOX, stop)) <= CORNER + 0.01
        state = trajectory.at(after)


@given(starts, points, st.tuples(*[st.floats(-1, 1)] * 3), st.tuples(*[st.floats(-1, 1)] * 3), limits)
@settings(deadline=None, max_examples=200)
def test_a_goal_that_drifts_is_met_and_accompanied(
    start: MotionState, goal: Point, moving: tuple[float, ...], going: tuple[float, ...], limit: MotionLimits
) -> None:
    wide = MotionLimits(
        limit.speed, limit.climb, limit.acceleration, Box(Point(-1e4, -1e4, -1e4), Point(1e4, 1e4, 1e4))
    )
    drift, velocity = wide.limited(Point(*moving)) * 0.7, wide.limited(Point(*going))
    trajectory = plan(MotionState(start.position, velocity), [goal], wide, drift)
    assert_kept(trajectory, wide)
    late = trajectory.at(trajectory.seconds + 2.0)
    assert distance(late.position, goal + drift * (trajectory.seconds + 2.0)) < 1e-5 and late.velocity == drift


@given(paths, limits)
def test_the_waypoint_ahead_only_grows(path: list[Point], limit: MotionLimits) -> None:
    trajectory = plan(MotionState(ZERO), path, limit)
    seen = [trajectory.ahead(trajectory.seconds * i / 50) for i in range(51)]
    assert seen == sorted(seen) and trajectory.ahead(trajectory.seconds + 1e-6) == len(path)


def test_a_target_behind_is_turned_to_without_a_stop_and_one_too_near_is_passed_and_met() -> None:
    behind = plan(MotionState(ZERO, Point(1.0)), [Point(-3.0)], LIMITS)
    assert len(behind.pieces) <= 3  # braking and speeding up are one
    near = plan(MotionState(ZERO, Point(1.0)), [Point(0.2)], LIMITS)
    assert max(s.position.x for s in moments(near)) == pytest.approx(0.5, abs=0.01) and near.end.position.x == 0.2


def test_repeated_points_are_no_stops() -> None:
    once = plan(MotionState(ZERO), [Point(2.0), Point(4.0)], LIMITS)
    often = plan(MotionState(ZERO), [ZERO, ZERO, Point(2.0), Point(2.0), Point(2.0), Point(4.0), Point(4.0)], LIMITS)
    assert often.seconds == pytest.approx(once.seconds) == pytest.approx(5.0)
    assert math.isfinite(often.seconds)
