"""Legs that begin where the vehicle is: after holds, gaps in the agent's time, pushes and restarts; and no progress."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.quad_rig import Rig, at, settings
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.values.obstacles import Block, Obstacle
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready
from targets.planning.exact import solid_distance
from targets.planning.process import Inside
from targets.planning.standstill import NO_PROGRESS
from targets.quad.platform.platform import Quad
from targets.quad.platform.simple import SimpleQuad
from targets.sim.base.bodies import Vector

WALL = Block(Point(2.0, -5.0, 0.0), Point(2.2, 2.0, 3.8))
AROUND = (Point(1.0, -2.0, 1.5), Point(1.4, 2.6, 1.5), Point(2.8, 2.6, 1.5), Point(3.4, -2.0, 1.5))
RADIUS = 0.2  # m, of the body


class Flight:
    """A quad among obstacles that is ready to be commanded; `gap` is how near it came to any of them."""

    def __init__(self, *obstacles: Block, safety: Safety | None = None, position: Vector = (1.0, -2.0, 0.0)) -> None:
        self.rig = Rig(position=position)
        self._obstacles: tuple[Obstacle, ...] = obstacles
        self._safety = safety or Safety()
        self.rig.quad = self.agent()
        self.gap = math.inf
        step = self.rig.body.step

        def watched(dt: float) -> None:
            step(dt)
            self.gap = min([self.gap, *(solid_distance(o, at(self.rig), at(self.rig)) for o in obstacles)])

        self.rig.body.step = watched  # type: ignore[method-assign]
        self.rig.fly()

    def agent(self) -> Quad:
        rig = self.rig
        made = msgspec.structs.replace(settings(), obstacles=self._obstacles, safety=self._safety)
        return Quad(
            made, None, connect=lambda url: rig.wire, clock=lambda: rig.now, sleep=rig.pass_time, planning=Inside
        )

    def follow(self, *points: Point) -> None:
        self.rig.quad.command({"Motion.path": points}, self.rig.now)

    def pinned(self) -> None:
        """From now on nothing moves it."""
        here = list(self.rig.body.position)

        def stays(dt: float) -> None:
            self.rig.body.position[:], self.rig.body.velocity[:] = here, [0.0, 0.0, 0.0]

        self.rig.body.step = stays  # type: ignore[method-assign]


@pytest.mark.parametrize("at_time", [2.0, 4.5, 5.5, 6.5, 8.0])
def test_an_agent_that_was_frozen_goes_on_along_its_path_and_touches_nothing(at_time: float) -> None:
    flight = Flight(WALL)
    flight.follow(*AROUND)
    flight.rig.run(at_time)
    flight.rig.pass_time(2.5)
    assert flight.rig.run(30.0, flight.rig.reached) and distance(at(flight.rig), AROUND[-1]) < 0.3
    assert flight.gap > RADIUS


def test_no_velocity_is_sent_that_leads_into_an_obstacle() -> None:
    flight = Flight(WALL)
    flight.rig.quad.command({"Motion.target": Point(1.45, -2.0, 1.5)}, flight.rig.now)
    flight.rig.run(0.9)
    flight.rig.pass_time(4.0)  # the autopilot runs on for 3 s
    assert flight.gap > RADIUS
    assert flight.rig.run(20.0, flight.rig.reached)


class Carried:
    """A simple quad that flies as it is asked to at once, and that can be carried to another place."""

    def __init__(self, *obstacles: Block) -> None:
        self.position, self.velocity, self.yaw = (1.0, -2.0, 0.0), (0.0, 0.0, 0.0), 0.0
        made = msgspec.structs.replace(settings(), obstacles=obstacles)
        self.quad = SimpleQuad(made, None, self, planning=Inside)
        self._obstacles = obstacles
        self.now, self.gap = 1000.0, math.inf
        self.quad.start(self.now)
        assert self.run(10.0, lambda: self.quad.ready)

    def state(self) -> Carried:
        return self

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        self.velocity = velocity

    def motors(self, on: bool) -> None: ...

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            x, y, z = (p + 0.05 * v for p, v in zip(self.position, self.velocity, strict=True))
            self.position = x, y, z
            self.gap = min(self.gap, *(solid_distance(o, Point(x, y, z), Point(x, y, z)) for o in self._obstacles))
            self.quad.poll(self.now)
            if until():
                return True
        return False

    def reached(self) -> bool:
        return bool(self.quad.sense(self.now).values["Motion.reached"])

    def carry(self, x: float, y: float) -> None:
        """While its safety layer holds it."""
        self.quad.hold(True, self.now)
        self.run(1.0)
        self.position, self.gap = (x, y, 1.5), math.inf
        self.run(1.0)
        self.quad.hold(False, self.now)


BACK = (Point(1.0, -2.0, 1.5), Point(1.0, 1.0, 1.5))


def test_a_vehicle_that_was_carried_behind_a_wall_flies_around_it() -> None:
    quad = Carried(WALL, Block(Point(5.5, 4.5, 0.0), Point(6.0, 5.0, 1.0)))
    quad.quad.command({"Motion.path": BACK}, quad.now)
    quad.run(2.0)
    quad.carry(3.2, -1.0)
    assert quad.run(40.0, quad.reached) and distance(Point(*quad.position), BACK[-1]) < 0.3
    assert quad.gap > RADIUS


def test_a_vehicle_without_a_clear_way_back_holds_and_says_so() -> None:
    quad = Carried(Block(Point(2.0, -5.0, 0.0), Point(2.2, 5.0, 4.0)), WALL)
    quad.quad.command({"Motion.path": BACK}, quad.now)
    quad.run(2.0)
    quad.carry(3.2, -1.0)
    quad.run(10.0)
    assert quad.quad.stall.startswith("no clear way from (3.2")
    assert quad.quad.stall.endswith("back to (1.00, 1.00, 1.50): holding")
    assert distance(Point(*quad.position), Point(3.2, -1.0, 1.5)) < 0.3
    quad.position = (1.0, -1.0, 1.5)
    assert quad.run(20.0, quad.reached), "there is a way again"
    assert quad.quad.stall == ""


def test_a_vehicle_that_takes_off_near_a_wall_hovers_there() -> None:
    flight = Flight(WALL, position=(1.68, -2.0, 0.0))
    flight.rig.run(5.0)
    assert distance(at(flight.rig), Point(1.68, -2.0, 1.5)) < 0.1


def test_a_short_hold_far_from_obstacles_is_no_stop() -> None:
    flight = Flight()
    flight.follow(Point(1.0, -2.0, 1.5), Point(1.0, 4.0, 1.5))
    flight.rig.run(3.0)
    flight.rig.quad.hold(True, flight.rig.now)
    flight.rig.run(0.1)
    flight.rig.quad.hold(False, flight.rig.now)
    slowest: list[float] = []
    flight.rig.watch = lambda: slowest.append(flight.rig.body.velocity[1])
    flight.rig.run(2.0)
    assert min(slowest) > 0.3


def test_a_new_agent_goes_on_amid_the_path() -> None:
    flight = Flight(WALL)
    flight.follow(*AROUND)
    flight.rig.run(20.0, lambda: at(flight.rig).x > 3.0)
    flight.rig.quad = flight.agent()
    flight.rig.quad.start(flight.rig.now)
    flight.rig.run(2.0, lambda: flight.rig.quad.ready)
    flight.rig.quad.resume({"Motion.path": AROUND}, flight.rig.now)
    north: list[float] = []
    flight.rig.watch = lambda: north.append(at(flight.rig).y)
    assert flight.rig.run(30.0, flight.rig.reached) and distance(at(flight.rig), AROUND[-1]) < 0.3
    assert flight.gap > RADIUS and max(north[40:]) < 3.0
    flight.follow(*AROUND)
    assert flight.rig.reached(), "the same path again is no new command"


def stalled(**safety: Any) -> Flight:
    flight = Flight(WALL, safety=Safety(**safety))
    flight.follow(*AROUND)
    flight.rig.run(3.0)
    flight.pinned()
    return flight


def test_a_vehicle_that_makes_no_progress_says_so_and_holds() -> None:
    flight = stalled()
    flight.rig.run(NO_PROGRESS + 3.0)
    (line,) = flight.rig.quad.log_lines()
    assert line.startswith("no progress for 8 s at (1.") and line.endswith("braking, and looking for another path")
    flight.rig.run(NO_PROGRESS + 3.0)
    (line,) = flight.rig.quad.log_lines()
    assert line.endswith("twice: holding until the next command") and line == flight.rig.quad.stall
    flight.rig.run(2 * NO_PROGRESS)
    assert flight.rig.quad.log_lines() == []


def test_a_vehicle_that_makes_no_progress_lands_where_the_fleet_file_says_rest() -> None:
    flight = stalled(missed_action="stop")
    with pytest.raises(Unready, match="no progress for 8 s"):
        flight.rig.run(3 * NO_PROGRESS)


def test_a_vehicle_that_hovers_at_its_target_is_not_stalled() -> None:
    flight = Flight(WALL)
    flight.rig.run(3 * NO_PROGRESS)
    flight.follow(Point(1.0, -1.0, 1.5))
    flight.rig.run(3 * NO_PROGRESS)
    assert flight.rig.quad.log_lines() == []
