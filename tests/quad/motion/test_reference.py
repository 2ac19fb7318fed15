"""The reference in time: targets that move, pauses, a vehicle that falls behind, and beginning anew."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.points import Point, distance
from targets.quad.motion.reference import Reference
from targets.quad.motion.trajectory import CORNER, ZERO, MotionLimits, norm

BOX = Box(Point(-6, -5, 0), Point(6, 5, 4))
LIMITS = MotionLimits(1.0, 0.7, 1.0, BOX)
TICK = 0.05
inner = st.builds(Point, st.floats(-6, 6), st.floats(-5, 5), st.floats(0, 4))


class Run:
    """A reference whose vehicle is wherever it is to be, unless `vehicle` says otherwise."""

    def __init__(self, at: Point = ZERO, limits: MotionLimits = LIMITS) -> None:
        self.reference = Reference(limits)
        self.now = 100.0
        self.vehicle: Point | None = None
        self.reference.start(at, Point(), self.now)
        self.track = [self.reference.at(0.0)]

    def tick(self, seconds: float = TICK) -> None:
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.reference.advance(self.vehicle or self.reference.at(0.0).position, self.now)
            self.track.append(self.reference.at(0.0))

    @property
    def at(self) -> Point:
        return self.track[-1].position


def assert_smooth(run: Run, limits: MotionLimits = LIMITS) -> None:
    for a, b in zip(run.track, run.track[1:], strict=False):
        assert norm(b.velocity) <= limits.speed + 1e-6 and abs(b.velocity.z) <= limits.climb + 1e-6
        assert distance(a.velocity, b.velocity) <= limits.acceleration * TICK + 1e-6
        assert distance(a.position, b.position) <= limits.speed * TICK + 1e-6


@given(st.lists(st.tuples(inner, st.integers(1, 40)), min_size=1, max_size=12))
@settings(deadline=None, max_examples=60)
def test_any_targets_at_any_times(changes: list[tuple[Point, int]]) -> None:
    """Smooth, within the box, and at the last one in the end."""
    run = Run(Point(0, 0, 1))
    for target, ticks in changes:
        run.reference.follow((target,), run.now)
        run.tick(ticks * TICK)
    run.tick(40.0)
    assert distance(run.at, changes[-1][0]) < 1e-6 and run.reference.stood >= 0 and run.reference.final
    assert_smooth(run)
    for state in run.track:
        assert distance(state.position, Point(*map(_held, _axes(state.position), _axes(BOX.lo), _axes(BOX.hi)))) < 1e-6


def _waits(run: Run) -> bool:
    return run.reference.waits


def _axes(p: Point) -> tuple[float, float, float]:
    return p.x, p.y, p.z


def _held(v: float, lo: float, hi: float) -> float:
    return max(lo, min(v, hi))


@pytest.mark.parametrize("every", [1, 2, 4, 10])
def test_a_target_that_moves_every_round_is_accompanied(every: int) -> None:
    """No stop for each round, no lag; where it stops, the reference comes back to."""
    run = Run()
    for i in range(200):
        if i % every == 0:
            run.reference.follow((Point(0.5 * i * TICK),), run.now)
        run.tick()
    last = 0.5 * (199 // every) * every * TICK
    late = run.track[100:]
    assert min(norm(s.velocity) for s in late) > 0.45 and max(norm(s.velocity) for s in late) < 0.6
    assert abs(run.at.x - 0.5 * 200 * TICK) < 0.03
    assert_smooth(run)
    run.tick(10.0)
    assert run.at == Point(last) and run.reference.stood >= 0
    assert (
        max(s.position.x for s in run.track) < last + 0.5 * (1.6 * max(every * TICK, 0.07) + TICK) + 0.5**2 / 2 + 0.01
    )


def test_a_target_on_a_circle_is_accompanied_and_foreseen() -> None:
    run = Run(Point(2.0))
    errors = []
    for i in range(400):
        turn = 0.4 * i * TICK
        run.reference.follow((Point(2 * math.cos(turn), 2 * math.sin(turn)),), run.now)
        if i > 200:
            errors.append(distance(run.reference.at(0.0).position, Point(2 * math.cos(turn), 2 * math.sin(turn))))
            ahead = turn + 0.4 * 0.6
            seen = run.reference.at(0.6).velocity
            assert distance(seen, Point(-0.8 * math.sin(ahead), 0.8 * math.cos(ahead))) < 0.06
        run.tick()
    assert max(errors) < 0.03


def test_jumps_are_not_a_motion() -> None:
    """Far targets, one after the other: each is made for as if it were the last."""
    run = Run()
    for i in range(20):
        run.reference.follow((Point(3.0 if i % 2 else -3.0),), run.now)
        run.tick(0.2)
        assert run.reference._pursuit.velocity == Point()
    run.tick(10.0)
    assert run.at == Point(3.0)


def test_the_waypoints_of_a_path_are_passed_in_order_and_a_pause_changes_nothing_of_it() -> None:
    path = (Point(2.0), Point(2.0, 2.0), Point(0.0, 2.0), Point(0.0, 0.0))
    run = Run()
    run.reference.follow(path, run.now)
    run.tick(3.0)
    before = run.reference.final
    run.reference.pause(True, run.now)
    run.tick(2.0)
    standing = run.at
    assert run.track[-1].velocity == Point() and distance(standing, Point(2.0, 0.6)) < 1.5
    run.reference.pause(False, run.now)
    run.tick(15.0)
    assert run.at == path[-1] and (before, run.reference.final) == (False, True) and run.reference.stood >= 0
    for p in path:
        assert min(distance(s.position, p) for s in run.track) < CORNER + TICK


def test_points_passed_before_a_pause_stay_passed() -> None:
    """After a pause on the last leg the reference goes on along that leg, and not to the first point again."""
    path = (Point(2.0), Point(2.0, 2.0), Point(0.0, 2.0))
    run = Run()
    run.reference.follow(path, run.now)
    while not run.reference.final:
        run.tick()
    run.tick(0.5)
    run.reference.pause(True, run.now)
    run.tick(2.0)
    before = len(run.track)
    run.reference.pause(False, run.now)
    assert run.reference.final
    run.tick(10.0)
    assert run.at == path[-1]
    assert all(abs(s.position.y - 2.0) < CORNER for s in run.track[before:])


def test_a_pause_before_the_start_and_another_pause_do_not_lose_the_passed_points() -> None:
    run = Run()
    run.reference.follow((Point(2.0), Point(2.0, 2.0), Point(0.0, 2.0)), run.now)
    while not run.reference.final:
        run.tick()
    run.reference.pause(True, run.now)
    run.tick(1.0)
    run.reference.drop(run.now)
    run.reference.pause(False, run.now)
    run.reference.pause(True, run.now)
    run.reference.start(run.at, Point(), run.now)
    run.reference.pause(False, run.now)
    assert run.reference.final


def test_a_pause_ahead_of_everything_and_a_target_meanwhile() -> None:
    run = Run()
    run.reference.pause(True, run.now)
    run.reference.follow((Point(2.0),), run.now)
    run.tick(2.0)
    assert run.at == Point()
    run.reference.pause(False, run.now)
    run.tick(5.0)
    assert run.at == Point(2.0)


def test_no_points_mean_stop() -> None:
    run = Run()
    run.reference.follow((Point(5.0),), run.now)
    run.tick(3.0)
    before = run.at
    run.reference.follow((), run.now)
    run.tick(3.0)
    assert run.reference.stood >= 0 and distance(run.at, before) == pytest.approx(0.5, abs=0.01)
    assert_smooth(run)


def test_it_waits_for_a_vehicle_that_falls_behind_and_goes_on_with_it() -> None:
    run = Run()
    run.vehicle = Point()
    run.reference.follow((Point(5.0),), run.now)
    run.tick(10.0)
    assert _waits(run) and 0.5 < run.at.x < 1.1 and norm(run.track[-1].velocity) == 0.0
    run.vehicle = None
    run.tick(10.0)
    assert run.at == Point(5.0) and not _waits(run)


def test_beginning_anew_is_where_the_vehicle_is_and_goes_on_with_the_path() -> None:
    run = Run()
    run.reference.follow((Point(2.0), Point(2.0, 3.0)), run.now)
    run.tick(3.5)
    assert run.reference.final
    halt = run.reference.drop(run.now)
    assert halt is not None and distance(halt, run.at) <= 0.5 and not run.reference.started
    run.reference.start(Point(-1.0, 1.0, 9.0), Point(0.1), run.now + 5.0)
    assert run.reference.at(0.0).position == Point(-1.0, 1.0, 4.0)  # within the box, and standing
    run.now += 5.0
    run.tick(15.0)
    assert run.at == Point(2.0, 3.0) and min(distance(s.position, Point(2.0)) for s in run.track[80:]) > 0.5


def test_a_poll_that_comes_late_is_no_leap() -> None:
    run = Run()
    run.reference.follow((Point(5.0),), run.now)
    run.tick(2.0)
    run.now += 10.0
    run.reference.advance(run.at, run.now)
    assert distance(run.reference.at(0.0).position, run.at) <= 0.5 + 1e-9
