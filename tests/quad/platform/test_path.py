"""A quad on a commanded path, and its callable port."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.quad_rig import Rig, settings
from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Grid, Point, distance
from koordgen.runtime.vehicle.platform import Finding, Unready
from targets.planning.exact import solid_distance
from targets.planning.process import Inside
from targets.quad.platform.platform import Quad

PATH = (Point(3.0, -2.0, 1.5), Point(3.0, 2.0, 2.5), Point(-1.0, 2.0, 1.5))


def at(rig: Rig) -> Point:
    return Point(*rig.body.position)


def test_a_path_is_flown_point_by_point_and_reached_at_its_end_only() -> None:
    rig = Rig()
    rig.fly()
    nearest = [math.inf] * len(PATH)
    early: list[float] = []

    def watch() -> None:
        for i, p in enumerate(PATH):
            nearest[i] = min(nearest[i], distance(at(rig), p))
        if rig.reached() and distance(at(rig), PATH[-1]) > 0.2:
            early.append(rig.now)

    rig.quad.command({"Motion.path": PATH}, rig.now)
    rig.watch = watch
    assert rig.run(30.0, rig.reached)
    assert not early
    assert distance(at(rig), PATH[-1]) < 0.2
    assert all(d < 0.25 for d in nearest), nearest  # 0.1 m by the reference, the rest by the vehicle


def test_an_empty_path_means_stay() -> None:
    rig = Rig()
    rig.fly()
    rig.quad.command({"Motion.path": PATH}, rig.now)
    rig.run(2.0)
    rig.quad.command({"Motion.path": ()}, rig.now)
    assert rig.reached()
    rig.run(4.0)
    here = at(rig)
    rig.run(4.0)
    assert distance(at(rig), here) < 0.05


def test_the_planner_answers_from_the_present_place_and_refuses_the_ground() -> None:
    rig = Rig()
    rig.fly()
    goal = Point(4.0, 0.0, 1.5)
    path = rig.quad.call("Motion.planner", (goal,))
    assert path[-1] == goal and distance(path[0], at(rig)) < 0.1
    assert rig.quad.call("Motion.planner", (Point(4.0, 0.0, 0.0),)) == ()
    assert rig.quad.call("Motion.planner", (Point(40.0, 0.0, 1.5),)) == ()
    wall = tuple(Grid(10, j, 0.25) for j in range(-12, 8))
    assert len(rig.quad.call("Motion.planner", (goal, wall))) > 2


def rig_with(obstacle: Block, noise: float = 0.0, **body: Any) -> Rig:
    rig = Rig(noise=noise)
    rig.quad = Quad(
        msgspec.structs.replace(settings(**body), obstacles=(obstacle,)), None, connect=lambda url: rig.wire,
        clock=lambda: rig.now, sleep=rig.pass_time, planning=Inside,
    )  # fmt: skip
    return rig


WALL = Block(Point(2.0, -5.0, 0.0), Point(2.2, 2.0, 3.8))


def test_the_fleet_files_obstacles_and_the_others_are_planned_around() -> None:
    rig = rig_with(WALL)
    rig.fly()
    goal = Point(4.0, -2.0, 1.0)
    path = rig.quad.call("Motion.planner", (goal,))
    assert path[-1] == goal and len(path) > 2
    assert all(p.z >= 1.5 for p in path[1:-1]), "not below the flight height, where nobody flies"
    rig.quad.others({1: (Point(3.0, 3.5, 2.0), Point(1.0, 3.5, 2.0))})
    others = rig.quad.call("Motion.planner", (goal,))
    assert path_distance(others[:-1], (Point(3.0, 3.5, 2.0), Point(1.0, 3.5, 2.0))) >= 0.7


def test_a_way_into_an_obstacle_is_not_flown_and_told() -> None:
    rig = rig_with(WALL)
    rig.fly()
    rig.run(3.0)
    here = at(rig)
    through = Point(4.0, -2.0, 1.5)
    for _ in range(40):
        rig.quad.command({"Motion.target": through}, rig.now)
        rig.run(0.1)
        assert not rig.reached(), "it is not there"
    assert distance(at(rig), here) < 0.1
    (told,) = rig.quad.log_lines()
    assert told.startswith("the commanded path is not flown, holding instead: the path from (1.0")
    rule = "0.35 m are kept: radius 0.2 + tracking_error 0.1 + position_error 0.05"
    assert f"comes within 0.00 m of obstacle 0; {rule}" in told
    rig.quad.command({"Motion.path": (Point(1.0, 3.0, 1.5), Point(4.0, 3.0, 1.5))}, rig.now)
    assert rig.run(20.0, rig.reached) and distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.3
    assert rig.quad.log_lines() == []


PILLAR = Block(Point(-0.2, -0.2, 0.0), Point(0.2, 0.2, 3.8))


@pytest.mark.parametrize(("away", "flown"), [(0.3, False), (0.4, True)])
def test_a_commanded_way_keeps_the_errors_of_tracking_and_position(away: float, flown: bool) -> None:
    rig = rig_with(PILLAR)
    rig.fly()
    rig.quad.command({"Motion.target": Point(0.2 + away, -2.0, 1.5)}, rig.now)
    rig.run(3.0)
    rig.quad.command({"Motion.target": Point(0.2 + away, 2.0, 1.5)}, rig.now)
    assert bool(rig.quad.stall) is not flown
    rig.quad = rig_with(PILLAR, tracking_error=0.05, position_error=0.02).quad
    rig.quad.command({"Motion.target": Point(0.2 + away, 2.0, 1.5)}, rig.now)
    assert rig.quad.stall == ""


def nearest(rig: Rig, obstacle: Block) -> list[float]:
    """The distances of the quad from an obstacle, from now on."""
    found: list[float] = []
    rig.watch = lambda: found.append(solid_distance(obstacle, at(rig), at(rig)))
    return found


@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_a_target_that_creeps_into_an_obstacle_is_not_followed_there(noise: float) -> None:
    """Each step of it is a small part of the distance that is left."""
    rig = rig_with(PILLAR, noise=noise)
    rig.fly()
    rig.go(1.0, 0.0)
    rig.run(6.0)
    gaps, away = nearest(rig, PILLAR), 0.8
    for _ in range(80):
        rig.quad.command({"Motion.target": Point(0.2 + away, 0.0, 1.5)}, rig.now)
        rig.run(0.1)
        away *= 0.97
    assert 0.25 < min(gaps) < 0.4
    assert "comes within" in rig.quad.stall


def test_a_quad_in_motion_does_not_turn_into_an_obstacle() -> None:
    """The straight way to the new target is clear; the bow, on which a quad turns that flies at 1 m/s, is not."""
    rig = rig_with(PILLAR)
    rig.fly()
    rig.quad.command({"Motion.path": (Point(-2.0, -1.0, 1.5), Point(4.0, -1.0, 1.5))}, rig.now)
    assert rig.run(20.0, lambda: at(rig).x > -0.9 and rig.body.velocity[0] > 0.9)
    gaps = nearest(rig, PILLAR)
    back = Point(-0.9, 2.0, 1.5)
    rig.quad.command({"Motion.target": back}, rig.now)
    assert rig.run(15.0, rig.reached) and distance(at(rig), back) < 0.2
    assert min(gaps) > 0.3


def test_a_quad_waits_for_its_planner_and_does_not_start_without_one() -> None:
    rig = rig_with(WALL, planner="nowhere:Nobody")
    with pytest.raises(Unready, match="the planner nowhere:Nobody cannot be created"):
        rig.quad.start(rig.now)


def test_the_doctor_makes_the_planner() -> None:
    def finding(**body: Any) -> Finding:
        quad = rig_with(WALL, **body).quad
        return next(found for found in quad.diagnose() if found.name == "planner")

    assert finding(planner="rrt-star") == Finding("planner", "ok", "rrt-star is ready")
    bad = finding(planner="nowhere:Nobody")
    assert bad.state == "fail" and "nowhere:Nobody cannot be created: ModuleNotFoundError" in bad.found
