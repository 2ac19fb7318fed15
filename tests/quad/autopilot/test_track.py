"""Samples as one motion: the velocity is right and without lag, jumps are refused, drop-outs are none."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.values.points import Point, Pose, distance
from targets.quad.autopilot.track import GUSTS, SLACK, WHILE, PositionTrack

RATE = 0.02


def flown(track: PositionTrack, seconds: float, speed: float = 0.0, noise: float = 0.0, begin: float = 100.0) -> float:
    """Samples along x at 50 Hz; when the last was."""
    draw, now = random.Random(3), begin
    for i in range(round(seconds / RATE)):
        now = begin + i * RATE
        error = [draw.gauss(0.0, noise) for _ in range(3)]
        assert track.add(Pose(Point(speed * i * RATE + error[0], error[1], error[2]), 0.3), now)
    return now


@pytest.mark.parametrize("speed", [0.0, 1.0, -4.0])
def test_velocity_is_free_of_lag(speed: float) -> None:
    track = PositionTrack(5.0)
    flown(track, 1.0, speed)
    assert distance(track.velocity, Point(speed, 0.0, 0.0)) < 1e-3


def test_velocity_is_quieter_than_differences_are() -> None:
    track, squares = PositionTrack(1.0), []
    flown(track, 1.0, noise=0.005)
    for k in range(20):
        flown(track, 0.2, noise=0.005, begin=200.0 + k)
        squares.append(track.velocity.x**2 + track.velocity.y**2 + track.velocity.z**2)
    assert math.sqrt(sum(squares) / 60) < 0.03  # in one direction; the differences of two samples: 0.35


def test_an_acceleration_lags_as_is_said() -> None:
    track = PositionTrack(5.0)
    for i in range(100):
        t = i * RATE
        track.add(Pose(Point(t * t / 2, 0.0, 0.0)), 100.0 + t)
    assert 99 * RATE - track.velocity.x == pytest.approx(0.11, abs=0.01)


@pytest.mark.parametrize("jump", [Point(0.4, 0, 0), Point(0, 0, -1.0), Point(30.0, -40.0, 2.0)])
def test_a_jump_is_refused_however_long_it_lasts(jump: Point) -> None:
    track = PositionTrack(1.0)
    now = flown(track, 1.0)
    for i in range(1, 500):
        assert not track.add(Pose(jump, 0.3), now + i * RATE)
    assert track.jumps == 499 and track.refused(now + 10.0) == pytest.approx(9.98)
    assert track.add(Pose(Point(), 0.3), now + 10.0) and track.refused(now + 11.0) == 0.0


def test_what_a_fast_vehicle_does_is_no_jump() -> None:
    """It turns back at 4 m/s within 0.4 s, and single samples of its way are jumps."""
    track, x = PositionTrack(4.0), 0.0
    for i in range(150):
        v = 4.0 * max(-1.0, min(1.0, (2.0 - i * RATE) / 0.2))
        x += v * RATE
        wrong = i % 10 == 9
        assert track.add(Pose(Point(x + (2.0 if wrong else 0.0), 0, 0)), 100.0 + i * RATE) is not wrong


def test_a_turn_that_no_vehicle_makes_is_a_jump() -> None:
    track = PositionTrack(1.0)
    now = flown(track, 1.0)
    assert not track.add(Pose(Point(), 0.3 + math.pi), now + RATE)
    assert track.add(Pose(Point(), 0.3 + math.tau + 0.1), now + 2 * RATE) and track.jumps == 1
    assert track.refused(now + 1.0) == 0.0


def test_after_a_dropout_it_goes_on_where_the_vehicle_may_be_by_then() -> None:
    track = PositionTrack(1.0)
    now = flown(track, 1.0, 1.0)
    assert track.add(Pose(Point(1.9, 0, 0), 0.3), now + 0.9)
    far = 1.9 + (track.velocity.x + 1.0 + GUSTS) * WHILE + SLACK
    assert not track.add(Pose(Point(far + 0.01, 0, 0), 0.3), now + 30.0)
    assert track.add(Pose(Point(far - 0.05, 0, 0), 0.3), now + 60.0)


def test_what_is_not_newer_is_no_jump() -> None:
    track = PositionTrack(1.0)
    now = flown(track, 1.0)
    assert not track.add(Pose(Point(9.0, 0, 0)), now) and not track.add(Pose(Point(9.0, 0, 0)), now - 1.0)
    assert track.jumps == 0


def test_a_vehicle_that_was_carried_is_believed_anew() -> None:
    track = PositionTrack(1.0)
    now = flown(track, 1.0)
    assert not track.add(Pose(Point(9.0, 0, 0), 2.0), now + RATE)
    track.forget()
    assert track.add(Pose(Point(9.0, 0, 0), 2.0), now + 2 * RATE) and track.velocity == Point()


def test_where_it_is_at_another_time() -> None:
    track = PositionTrack(1.0)
    assert track.at(5.0) is None
    now = flown(track, 1.0, 1.0)
    there = track.at(now + 0.1)
    assert there is not None and there.x == pytest.approx(0.98 + 0.1, abs=1e-3)
    far = track.at(now + 100.0)
    assert far is not None and far.x == pytest.approx(0.98 + WHILE, abs=2e-3)


_number = st.floats(-1e5, 1e5)


@given(st.lists(st.tuples(_number, _number, _number, _number, st.floats(-1, 10)), max_size=30))
def test_nothing_yields_what_is_not_finite(samples: list[tuple[float, float, float, float, float]]) -> None:
    track, now = PositionTrack(1.0), 1000.0
    for x, y, z, yaw, later in samples:
        now += later
        track.add(Pose(Point(x, y, z), yaw), now)
        v = track.velocity
        assert all(map(math.isfinite, (v.x, v.y, v.z)))
