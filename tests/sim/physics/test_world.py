"""The world and its bodies: repeatable, within their limits, solid."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.physics import quadrotor
from targets.sim.physics.car import SimulatedCar
from targets.sim.physics.contacts import Touched
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import GRAVITY, SimulatedWorld
from tests.sim.physics.engines import ENGINES


@pytest.fixture(params=ENGINES)
def world(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    made = SimulatedWorld(engine=request.param)
    yield made
    made.close()


def run(world: SimulatedWorld, seconds: float) -> None:
    for _ in range(round(seconds * 240)):
        world.step()


def flown(engine: str) -> list[object]:
    """A scripted run with a collision in it."""
    world = SimulatedWorld(engine=engine)
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 0.0), 0.4)
    car = SimulatedCar(world, (-2.0, 0.05, 0.0), 0.0, 0.33, 0.4)
    other = SimulatedCar(world, (2.0, 0.0, 0.0), math.pi, 0.33, 0.4)
    quad.motors(True)
    seen: list[object] = []
    for k in range(960):
        quad.accelerate((math.sin(k / 50), 0.5, 0.6 if k < 300 else -0.4), 0.2)
        car.drive(1.5, 0.05)
        other.drive(1.5, 0.0)
        world.step()
        seen.append((quad.state(), car.state(), other.state(), world.touched()))
    world.close()
    return seen


@pytest.mark.parametrize("engine", ENGINES)
def test_a_fresh_world_repeats_itself_to_the_last_bit(engine: str) -> None:
    assert flown(engine) == flown(engine)


def test_a_quadrotor_without_motors_stays_down_and_falls(world: SimulatedWorld) -> None:
    low = SimulatedQuadrotor(world, (0.0, 0.0, 0.0), 0.0)
    high = SimulatedQuadrotor(world, (3.0, 0.0, 20.0), 0.0)
    for quad in (low, high):
        quad.accelerate((1.0, 0.0, 3.0), 0.0)
    run(world, 1.0)
    assert low.state().position == pytest.approx((0.0, 0.0, 0.0), abs=0.005)
    assert world.grounded(low.rigid) and not world.grounded(high.rigid)
    assert -GRAVITY < high.state().velocity[2] < -0.85 * GRAVITY


def test_a_quadrotor_follows_an_acceleration_after_a_lag(world: SimulatedWorld) -> None:
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 5.0), 0.0)
    quad.motors(True)
    quad.accelerate((0.0, 0.0, 0.0), 0.0)
    run(world, 1.0)
    quad.accelerate((1.0, -0.5, 0.0), 0.0)
    run(world, 1 / 60)
    before = quad.state().velocity
    assert math.hypot(before[0], before[1]) < 0.005  # it has not tilted yet
    run(world, 1.0)
    vx, vy, vz = quad.state().velocity
    assert 0.7 < vx < 1.0 and -0.5 < vy < -0.35  # 1 s less the lag and the air's drag
    assert abs(vz - before[2]) < 0.1


@pytest.mark.parametrize("asked", [(50.0, 0.0, 0.0), (0.0, -50.0, 30.0), (40.0, 40.0, -50.0)])
def test_a_quadrotor_keeps_its_limits_whatever_is_asked(world: SimulatedWorld, asked: Vector) -> None:
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 50.0), 0.0)
    quad.motors(True)
    quad.accelerate(asked, 90.0)
    steepest = fastest = 0.0
    for _ in range(480):
        before = quad.state()
        world.step()
        after = quad.state()
        steepest = max(steepest, math.acos(min(1.0, quad.motion().up[2])))
        gained = [(b - a) * 240 for a, b in zip(before.velocity, after.velocity, strict=True)]
        fastest = max(fastest, math.hypot(gained[0], gained[1], gained[2] + GRAVITY))
    assert steepest < quadrotor.MAX_TILT + 0.1
    assert fastest < 2.2 * GRAVITY + 4  # thrust and drag
    assert abs(quad.state().yaw_rate) < quadrotor.MAX_YAW_RATE + 0.1


def test_a_car_drives_the_bicycles_circle(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (1.0, 2.0, 0.0), 0.5, 0.33, 0.4)
    assert car.state().position == pytest.approx((1.0, 2.0, 0.0), abs=1e-6)
    car.drive(1.0, 0.3)
    run(world, 2.0)
    first, radius = car.state(), 0.33 / math.tan(0.3)
    run(world, math.tau * radius)
    assert math.dist(first.position, car.state().position) < 0.02
    assert car.state().yaw_rate == pytest.approx(1 / radius, rel=0.01)
    assert math.hypot(*car.state().velocity[:2]) == pytest.approx(1.0, rel=0.01)


def test_a_car_needs_time_and_has_limits(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    car.drive(100.0, 3.0)
    run(world, 0.05)
    assert 0.05 < car.state().velocity[0] < 0.5
    car.drive(1.0, 3.0)
    run(world, 3.0)
    assert car.state().yaw_rate == pytest.approx(math.tan(0.4) / 0.33, rel=0.01)
    car.drive(0.0, 0.0)
    run(world, 2.0)
    assert math.hypot(*car.state().velocity) < 0.01


def test_a_command_that_is_no_number_is_a_mistake(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    quad = SimulatedQuadrotor(world, (2.0, 0.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="speed"):
        car.drive(math.nan, 0.0)
    with pytest.raises(ValueError, match="acceleration"):
        quad.accelerate((0.0, math.inf, 0.0), 0.0)


def test_cars_do_not_drive_through_one_another(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    parked = SimulatedCar(world, (1.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    car.drive(1.0, 0.0)
    touched = False
    for _ in range(600):
        world.step()
        touched = touched or (0, 1) in world.touched().bodies
    assert touched
    assert parked.state().position[0] - car.state().position[0] > 0.45  # a car's length


def test_a_car_on_its_side_has_no_wheels_on_the_floor(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (0.0, 0.0, 0.5), 0.0, 0.33, 0.4)  # dropped
    car.drive(2.0, 0.0)
    run(world, 0.1)
    assert abs(car.state().velocity[0]) < 0.01


def test_obstacles_are_no_work_for_the_physics(world: SimulatedWorld) -> None:
    for k in range(3):
        world.obstacle(Block(Point(0.5 * k, 0.0, 0.0), Point(0.5 * k + 0.7, 1.0, 1.0)))  # into one another
    run(world, 0.1)
    SimulatedQuadrotor(world, (0.5, 0.5, 1.005), 0.0)
    world.step()
    assert not world.touched().bodies


def test_a_car_does_not_drive_through_an_obstacle(world: SimulatedWorld) -> None:
    wall = world.obstacle(Block(Point(1.0, -1.0, 0.0), Point(1.1, 1.0, 1.0)))
    beside = world.obstacle(Block(Point(-1.0, 0.15, 0.0), Point(1.05, 1.0, 1.0)))  # 1 cm beside the car
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    car.drive(1.0, 0.0)
    run(world, 0.3)
    assert world.touched() == Touched(), "neither obstacles with each other nor with what they nearly touch"
    run(world, 2.0)
    assert world.touched() == Touched(obstacles=frozenset({(0, wall)})) and (wall, beside) == (0, 1)
    assert car.state().position[0] + 0.415 == pytest.approx(1.0, abs=0.01)
