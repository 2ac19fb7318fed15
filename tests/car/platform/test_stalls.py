"""A car without a way says what is wanted and why there is no way there."""

from __future__ import annotations

import re

import pytest

from koordgen.runtime.values.obstacles import Block, Cylinder
from koordgen.runtime.values.points import Point
from targets.sim.base.fault_state import FaultState
from tests.car.planning.test_avoidance import among
from tests.car.platform.world import TestBody, World

ROOM = (
    Block(Point(1.8, 1.8, 0.0), Point(4.2, 1.9, 1.0)),
    Block(Point(1.8, 4.1, 0.0), Point(4.2, 4.2, 1.0)),
    Block(Point(1.8, 1.8, 0.0), Point(1.9, 4.2, 1.0)),
    Block(Point(4.1, 1.8, 0.0), Point(4.2, 4.2, 1.0)),
)
LANE = (
    Block(Point(-3.0, 0.5, 0.0), Point(3.0, 0.6, 1.0)),
    Block(Point(-3.0, -0.6, 0.0), Point(3.0, -0.5, 1.0)),
)


def test_a_target_inside_an_obstacle() -> None:
    world = among(ROOM[0], Cylinder(Point(3.0, 0.0, 0.0), 0.5, 1.0))
    assert world.car.stall == ""
    world.go(3.1, 0.0)
    world.run(3.0)
    assert world.car.stall == "target (3.10, 0.00) lies inside obstacle 1 (3 tries in 2 s)"
    world.go(3.6, 0.0)
    world.run(2.5)
    assert world.car.stall.startswith("target (3.60, 0.00) is too near to obstacle 1 for the car (clearance 0.1 m)")
    world.go(1.0, 0.0)
    world.run(1.5)
    assert world.car.stall == "" and world.body.truth.speed > 0.1
    world.run(5.0)
    assert world.value("reached") and world.car.stall == ""


def test_a_target_in_a_closed_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("targets.car.planning.avoidance.PATIENCE", 0.04)
    world = among(*ROOM)
    world.go(3.0, 3.0)
    world.run(1.5)
    assert re.match(r"target \(3\.00, 3\.00\) has no path from \(-?0\.0\d, ", world.car.stall), world.car.stall
    world.car.hold(True, world.now)
    world.run(0.1)
    assert world.car.stall == "", "it was told to hold"


def test_another_robots_path_across_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """It waits, and has a way around planned again and again; to wait is no failed approach."""
    monkeypatch.setattr("targets.car.planning.avoidance.PATIENCE", 0.04)
    world = among(*LANE, body=TestBody(-2.5, 0.0, 0.0))
    world.go(2.5, 0.0)
    world.run(1.0)
    world.car.others({1: (Point(0.0, -5.0, 0.0), Point(0.0, 5.0, 0.0))})
    world.run(2.0)
    seen: set[str] = set()
    world.run(25.0, lambda: seen.add(world.car.stall))
    wanted = re.compile(r"target \(2\.50, 0\.00\) .*(robot 1's path|past the paths of 1)")
    assert all(map(wanted.match, seen)), seen
    world.car.others({})
    world.run(12.0)
    assert world.car.stall == "" and world.value("reached") is True


def test_a_target_on_another_robots_path() -> None:
    world = among()
    world.car.others({4: (Point(3.0, -3.0, 0.0), Point(3.0, 3.0, 0.0))})
    world.go(3.0, 0.0)
    world.run(1.5)
    assert world.car.stall.startswith("target (3.00, 0.00) is too near to robot 4's path"), world.car.stall


def test_a_program_whose_planner_finds_no_way_and_that_commands_nothing() -> None:
    world = among(*ROOM)
    assert world.car.call("Motion.planner", (Point(3.0, 3.0, 0.0),)) == ()
    assert world.car.stall.startswith("the planner's goal (3.00, 3.00, 0.00) has no path from ("), world.car.stall
    world.run(6.0)
    assert world.car.stall == "", "the program no longer asks"
    assert world.car.call("Motion.planner", (Point(3.0, 0.0, 1.5),)) == ()
    assert world.car.stall == "", "a goal in the air is another robot's task"
    assert world.car.call("Motion.planner", (Point(3.0, 3.0, 0.0),)) == ()
    world.go(1.0, 0.0)
    assert world.car.stall == ""


def test_a_motor_controller_that_reports_a_fault() -> None:
    world = World().begin()
    world.go(3.0, 0.0)
    assert world.controller is not None
    world.controller._fault_state = FaultState(battery=0.0)
    world.run(3.0)
    assert world.car.stall == "braking: the motor controller reports fault 2 (under-voltage)"
