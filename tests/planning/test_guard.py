"""The distance that commanded and planned ways keep, from a place that is too near to an obstacle as well."""

from __future__ import annotations

from benchmarks.fixtures.quad_rig import FENCE
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.planning.guard import Guard
from targets.planning.room import fixed, room
from targets.planning.world import Scene, World

WALL = Block(Point(0.0, -5.0, 0.0), Point(1.0, 5.0, 3.0))
PARTS = {"radius": 0.2, "tracking_error": 0.1, "position_error": 0.05}


def beside(away: float, y: float = 0.0) -> Point:
    """A place so many metres from the wall."""
    return Point(-away, y, 1.5)


def test_a_body_that_is_too_near_may_leave_but_come_no_nearer() -> None:
    guard = Guard((WALL,), PARTS)
    assert guard.trouble(beside(0.3), (beside(1.0, 2.0),)) == ""
    assert guard.trouble(beside(0.3), (beside(0.29, 2.0),)) == "", "a twentieth is noise"
    assert "comes within 0.28 m of obstacle 0; 0.35 m are kept" in guard.trouble(beside(0.3), (beside(0.28, 2.0),))
    assert guard.trouble(beside(0.4), (beside(0.34, 2.0),)) != ""


def test_small_steps_do_not_add_up() -> None:
    guard, away = Guard((WALL,), PARTS), 0.4
    for _ in range(50):
        if guard.trouble(beside(away), (beside(0.97 * away),)) == "":
            away *= 0.97
    assert away > 0.32


def test_a_body_that_was_pushed_nearer_may_go_back_to_where_it_was() -> None:
    guard = Guard((WALL,), PARTS)
    assert guard.trouble(beside(0.34), (beside(0.34, 1.0),)) == ""
    assert guard.trouble(beside(0.25), (beside(0.25, 1.0),)) != ""
    assert guard.trouble(beside(0.25), (beside(0.25), beside(0.34, 1.0), beside(0.34, 2.0))) == ""


def test_ways_planned_again_and_again_keep_the_least_distance() -> None:
    world = World(FENCE, (WALL,), clearance=0.3, radius=0.2, error=0.15)
    away = 0.5
    for _ in range(50):
        start, nearer = beside(away), beside(0.96 * away)
        if room(world, fixed(world.obstacles), Scene(), start).clear(start, nearer):
            away *= 0.96
    assert away >= 0.35


def test_a_clearance_below_the_errors_is_raised_to_them() -> None:
    world = World(FENCE, (WALL,), clearance=0.1, radius=0.2, error=0.15)
    here = room(world, fixed(world.obstacles), Scene(), beside(1.0))
    assert here.clear(beside(1.0), beside(0.36)) and not here.clear(beside(1.0), beside(0.34))
