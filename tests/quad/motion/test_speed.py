"""`max_speed` and `max_climb` are limits of the vehicle's own speed: on each leg, at a take-over, in the take-off."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import PointMass, Rig
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import SimulatedWorld

MORE = 1.05  # a vehicle may be so much faster than its limit: its own controller's overshoot


class Simulated(PointMass):
    """The simulator's quadrotor, whose motors and attitude loop lag."""

    def __init__(self, position: Vector) -> None:
        super().__init__(position)
        self._world = SimulatedWorld()
        self._quadrotor = SimulatedQuadrotor(self._world, position, 0.0)
        self.accelerate, self.motors = self._quadrotor.accelerate, self._quadrotor.motors  # type: ignore[method-assign]

    def state(self) -> BodyState:
        return self._quadrotor.state()

    def step(self, dt: float) -> None:
        self._world.step()
        self.position, self.velocity = list(self.state().position), list(self.state().velocity)


class SimulatedRig(Rig):
    def vehicle(self, position: Vector) -> PointMass:
        return Simulated(position)


class Fastest:
    """The greatest speeds of the body since `begin`, m/s."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.begin()
        rig.watch = self.look

    def begin(self) -> None:
        self.speed = self.climb = 0.0

    def look(self) -> None:
        velocity = self._rig.body.velocity
        self.speed = max(self.speed, math.hypot(*velocity))
        self.climb = max(self.climb, abs(velocity[2]))


def hurry(rig: Rig, seconds: float, fastest: Fastest) -> None:
    """As `run`, but look at each of the world's steps."""
    step = rig.body.step

    def looked(dt: float) -> None:
        step(dt)
        fastest.look()

    rig.body.step = looked  # type: ignore[method-assign]
    rig.run(seconds)
    rig.body.step = step  # type: ignore[method-assign]


@pytest.mark.parametrize("limit", [0.3, 1.0, 2.0])
def test_no_leg_is_flown_faster_than_the_limit(limit: float) -> None:
    rig = Rig(max_speed=limit)
    rig.fly()
    rig.run(3.0)
    goals = [Point(5.0, -2.0, 1.5), Point(5.0, 3.0, 3.0), Point(-5.0, -4.0, 1.5), Point(-5.0, 4.0, 1.5)]
    for goal in goals[: 2 if limit < 1.0 else 4]:
        fastest = Fastest(rig)
        rig.quad.command({"Motion.target": goal}, rig.now)
        hurry(rig, 18.0 / min(limit, 1.5), fastest)
        assert 0.9 * limit < fastest.speed < MORE * limit, goal
        assert fastest.climb < MORE * 0.7
    assert rig.reached()


def test_no_path_with_corners_is_flown_faster_than_the_limit() -> None:
    rig = Rig()
    rig.fly()
    rig.run(3.0)
    fastest = Fastest(rig)
    path = tuple(Point(x, y, 1.5) for x, y in [(4.0, -2.0), (4.0, 2.0), (0.0, 0.0), (-4.0, 2.0), (-4.0, -3.0)])
    rig.quad.command({"Motion.path": path}, rig.now)
    hurry(rig, 40.0, fastest)
    assert rig.reached() and fastest.speed < MORE


def test_a_target_that_moves_is_not_followed_faster_than_the_limit() -> None:
    """At 0.9 m/s, in front of the vehicle, so that it has to catch up."""
    rig = Rig()
    rig.fly()
    rig.run(3.0)
    fastest = Fastest(rig)
    for tick in range(40):
        rig.go(3.0 - 0.18 * tick, -2.0)
        hurry(rig, 0.2, fastest)
    assert 0.8 < fastest.speed < MORE


@pytest.mark.parametrize("dead", [0.2, 1.0, 2.5, 3.2, 4.0])  # seconds without an agent; after 3 the autopilot brakes
@pytest.mark.parametrize("late", [0.0, 0.3, 1.0])  # seconds from the take-over to the program's first target
def test_a_take_over_is_not_faster_than_the_limit(dead: float, late: float) -> None:
    rig = Rig()
    rig.fly()
    rig.go(-5.0, 4.0)
    rig.run(3.0)
    fastest = Fastest(rig)
    rig.pass_time(dead)
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    hurry(rig, 2.0 + late, fastest)
    rig.go(-5.0, 4.0)
    hurry(rig, 15.0, fastest)
    assert rig.reached() and fastest.speed < MORE


@pytest.mark.parametrize(("firmware", "climb"), [("ardupilot", 0.7), ("ardupilot", 0.3), ("px4", 0.7), ("px4", 0.3)])
def test_the_take_off_climbs_within_the_limit(firmware: str, climb: float) -> None:
    rig = SimulatedRig(harness={"firmware": firmware}, max_climb=climb)
    fastest = Fastest(rig)
    rig.quad.start(rig.now)
    hurry(rig, 12.0, fastest)
    assert rig.quad.ready and 0.8 * min(climb, 0.5) < fastest.climb < MORE * climb


def test_the_simulators_quadrotor_keeps_the_limit_on_a_leg() -> None:
    rig = SimulatedRig()
    rig.fly()
    rig.go(-5.0, 4.0)
    fastest = Fastest(rig)
    hurry(rig, 13.0, fastest)
    assert rig.reached() and 0.9 < fastest.speed < MORE


def test_a_take_off_whose_climb_is_not_limited_is_told() -> None:
    """The autopilot does not know the command. It takes off all the same."""
    rig = Rig()
    command = rig.autopilot.copter.command  # type: ignore[union-attr]
    unknown = mavlink.MAV_CMD_DO_CHANGE_SPEED
    rig.autopilot.copter.command = (  # type: ignore[union-attr, method-assign]
        lambda message, now: None if message.command == unknown else command(message, now)
    )
    rig.fly()
    assert any("the autopilot does not limit its climb to 0.7 m/s" in said for said in rig.progress)
