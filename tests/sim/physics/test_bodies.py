"""Bodies against closed forms: falling, hovering, the air, motors, the bicycle's circle, the wind; contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.trace.schema import Wind
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics import quadrotor
from targets.sim.physics.car import SimulatedCar
from targets.sim.physics.first_order import MAX_ACCELERATION, VELOCITY_LAG, SimpleCarBody, SimpleQuadrotor
from targets.sim.physics.quadrotor import Quadrotors, SimulatedQuadrotor
from targets.sim.physics.rigid import rotations, turn
from targets.sim.physics.world import GRAVITY, STEP, SimulatedWorld
from tests.sim.physics.engines import ENGINES

WALL = Block(Point(1.0, -2.0, 0.0), Point(1.2, 2.0, 3.0))


@pytest.fixture(params=ENGINES)
def world(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    made = SimulatedWorld(engine=request.param)
    yield made
    made.close()


def run(world: SimulatedWorld, seconds: float) -> None:
    for _ in range(round(seconds / STEP)):
        world.step()


def flying(world: SimulatedWorld, place: Vector = (0.0, 0.0, 5.0), yaw: float = 0.0) -> SimulatedQuadrotor:
    """Hovering."""
    quad = SimulatedQuadrotor(world, place, yaw)
    quad.motors(True)
    run(world, 2.0)
    quad.rigid.throw((0.0, 0.0, 0.0))
    return quad


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_a_rotation_matrix_turns_as_its_quaternion(parts: tuple[float, float, float, float]) -> None:
    size = math.hypot(*parts)
    x, y, z, w = (part / size for part in parts)
    (matrix,) = np.moveaxis(rotations(np.array([[x], [y], [z], [w]])), 2, 0)
    assert np.allclose(matrix @ matrix.T, np.eye(3)) and np.linalg.det(matrix) == pytest.approx(1.0)
    axis = np.array([x, y, z])
    assert np.allclose(matrix @ axis, axis)
    assert np.trace(matrix) == pytest.approx(4 * w * w - 1)


def test_a_spin_turns_by_its_angle_about_its_axis() -> None:
    orientation = np.array([[0.0], [0.0], [0.0], [1.0]])
    for _ in range(240):
        turn(orientation, np.array([[0.0], [1.5], [0.0]]), STEP)
    assert orientation[1, 0] == pytest.approx(math.sin(0.75), abs=1e-5)
    assert orientation[3, 0] == pytest.approx(math.cos(0.75), abs=1e-5)


def test_it_falls_as_gravity_and_the_air_let_it(world: SimulatedWorld) -> None:
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 900.0), 0.0)
    for seconds in (1.0, 3.0, 10.0):
        run(world, seconds - world.time)
        k = quadrotor.DRAG
        assert quad.state().velocity[2] == pytest.approx(-GRAVITY / k * (1 - math.exp(-k * seconds)), rel=2e-3)
        fallen = GRAVITY / k * (seconds - (1 - math.exp(-k * seconds)) / k)
        assert 900.0 - quad.state().position[2] == pytest.approx(fallen, rel=1e-2)
    run(world, 15.0)
    assert quad.state().velocity[2] == pytest.approx(-GRAVITY / quadrotor.DRAG, rel=0.01), "its terminal speed"


def test_it_hovers_where_its_thrust_is_its_weight(world: SimulatedWorld) -> None:
    quad = flying(world)
    height = quad.state().position[2]
    run(world, 5.0)
    assert quad.state().position[2] == pytest.approx(height, abs=1e-3)
    ((motors,),) = [kind.motors.T for kind in world._kinds.values() if isinstance(kind, Quadrotors)]
    assert (motors**2).sum() / 4 * quadrotor.MAX_THRUST == pytest.approx(quadrotor.MASS * GRAVITY, rel=1e-6)


def test_tilted_against_the_wind_it_keeps_its_place() -> None:
    world = SimulatedWorld(Wind((3.0, 0.0, 0.0)))
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 5.0), 0.0)
    quad.motors(True)
    quad.accelerate((-3.0 * quadrotor.DRAG, 0.0, 0.0), 0.0)
    run(world, 3.0)
    before = quad.state().velocity
    run(world, 2.0)
    assert quad.state().velocity[:2] == pytest.approx(before[:2], abs=0.02)
    world.blow(Wind())
    run(world, 2.0)
    assert quad.state().velocity[0] < before[0] - 0.5
    world.close()


def test_left_alone_it_is_carried_off_by_the_wind() -> None:
    world = SimulatedWorld(Wind((3.0, -1.0, 0.0)))
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 5.0), 0.0)
    quad.motors(True)
    run(world, 30.0)
    assert quad.state().velocity[:2] == pytest.approx((3.0, -1.0), abs=0.02)
    world.close()


def test_gusts_have_the_strength_and_the_memory_that_were_asked_for() -> None:
    from targets.sim.physics.wind import Air

    air = Air(Wind((1.0, 0.0, 0.0), 0.8, 0.5), 3, 40)
    blown = np.array([air.step(STEP) for _ in range(4800)])
    assert blown[:, 0].mean() == pytest.approx(1.0, abs=0.1) and blown[:, 1].mean() == pytest.approx(0.0, abs=0.1)
    assert blown[1000:, 2].std() == pytest.approx(0.8, rel=0.05)
    later = round(0.5 / STEP)
    kept = (blown[1000:-later, 1] * blown[1000 + later :, 1]).mean() / 0.8**2
    assert kept == pytest.approx(math.exp(-1), abs=0.06)
    again = Air(Wind((1.0, 0.0, 0.0), 0.8, 0.5), 3, 40)
    assert all((again.step(STEP) == told).all() for told in blown[:10])


def test_motors_need_their_time(world: SimulatedWorld) -> None:
    quad = flying(world)
    quad.accelerate((0.0, 0.0, 2.0), 0.0)
    run(world, quadrotor.MOTOR_LAG)
    gained = quad.state().velocity[2]
    run(world, STEP)
    now = (quad.state().velocity[2] - gained) / STEP
    hover, wanted = math.sqrt(GRAVITY), math.sqrt(GRAVITY + 2.0)
    speed = wanted + (hover - wanted) * math.exp(-(quadrotor.MOTOR_LAG + STEP) / quadrotor.MOTOR_LAG)
    assert now == pytest.approx(speed**2 - GRAVITY, abs=0.05)


def test_it_turns_at_the_rate_that_was_asked_for_and_stays_level(world: SimulatedWorld) -> None:
    quad = flying(world, yaw=0.3)
    quad.accelerate((0.0, 0.0, 0.0), 1.2)
    run(world, 1.5)
    assert quad.state().yaw_rate == pytest.approx(1.2, rel=0.01)
    assert quad.motion().up[2] > 0.9999 and math.hypot(*quad.state().velocity) < 0.01
    before = quad.state().yaw
    run(world, 0.5)
    assert quad.state().yaw - before == pytest.approx(0.6, rel=0.02)


def test_thrown_about_it_rights_itself(world: SimulatedWorld) -> None:
    quad = flying(world, (0.0, 0.0, 60.0))
    quad.rigid.throw((0.0, 0.0, 0.0), (12.0, -9.0, 3.0))
    run(world, 3.0)
    assert quad.motion().up[2] > 0.999 and math.hypot(*quad.motion().spin) < 0.05


def test_a_simple_quad_follows_a_velocity_with_its_lag(world: SimulatedWorld) -> None:
    quad = SimpleQuadrotor(world, (0.0, 0.0, 5.0), 0.2)
    quad.motors(True)
    quad.fly((0.6, 0.0, -0.3), 0.5)  # gently: its acceleration has a limit
    run(world, VELOCITY_LAG)
    reached = 1 - math.exp(-1)
    assert quad.state().velocity == pytest.approx((0.6 * reached, 0.0, -0.3 * reached), rel=1e-6)
    run(world, 2.0)
    assert quad.state().velocity == pytest.approx((0.6, 0.0, -0.3), abs=1e-4)
    assert quad.state().yaw == pytest.approx(0.2 + 0.5 * (2.0 + VELOCITY_LAG - 0.1), abs=0.01)
    quad.fly((20.0, 0.0, 0.0), 0.0)
    before = quad.state().velocity
    run(world, 0.1)
    assert math.dist(quad.state().velocity, before) == pytest.approx(0.1 * MAX_ACCELERATION, rel=0.01)
    quad.motors(False)
    before = quad.state().velocity
    run(world, 0.5)
    assert quad.state().velocity[2] - before[2] == pytest.approx(-GRAVITY * 0.5, rel=1e-6)


@pytest.mark.parametrize("speed", [1.0, -0.7])
def test_a_simple_car_drives_the_bicycles_circle(world: SimulatedWorld, speed: float) -> None:
    car = SimpleCarBody(world, (1.0, 2.0, 0.0), 0.5, 0.33, 0.4)
    car.drive(speed, 0.3)
    run(world, 2.0)
    first, radius = car.state(), 0.33 / math.tan(0.3)
    middle = _left_of(first, radius)
    for _ in range(400):
        world.step()
        assert math.dist(car.state().position[:2], middle) == pytest.approx(radius, rel=1e-3)
    assert car.state().yaw_rate == pytest.approx(speed / radius, rel=1e-3)
    car.brake(2.0)
    before = math.hypot(*car.state().velocity)
    run(world, 0.2)
    assert before - math.hypot(*car.state().velocity) == pytest.approx(0.4, rel=0.03)
    run(world, 1.0)
    assert math.hypot(*car.state().velocity) < 1e-9


def _left_of(state: BodyState, radius: float) -> tuple[float, float]:
    x, y, _ = state.position
    return x - radius * math.sin(state.yaw), y + radius * math.cos(state.yaw)


@pytest.mark.parametrize("make", [SimulatedQuadrotor, SimpleQuadrotor])
def test_a_quad_that_flies_into_a_wall_hits_it_and_stays_outside(
    world: SimulatedWorld, make: type[SimulatedQuadrotor] | type[SimpleQuadrotor]
) -> None:
    world.obstacle(WALL)
    quad = make(world, (0.0, 0.0, 1.0), 0.0)
    quad.motors(True)
    quad.rigid.throw((2.0, 0.0, 0.0))
    ask(quad, (2.0, 0.0, 0.0))
    hit, furthest = None, 0.0
    for _ in range(240):
        world.step()
        furthest = max(furthest, quad.state().position[0])
        if world.touched().obstacles and hit is None:
            hit = world.time
    assert world.touched().bodies == frozenset()
    assert hit is not None and hit == pytest.approx((1.0 - quadrotor.RADIUS) / 2.0, abs=0.1)
    assert furthest < 1.0 - quadrotor.RADIUS + 0.03


def ask(quad: SimulatedQuadrotor | SimpleQuadrotor, towards: Vector) -> None:
    """An acceleration of one, the velocity of the other."""
    if isinstance(quad, SimpleQuadrotor):
        quad.fly(towards, 0.0)
    else:
        quad.accelerate(towards, 0.0)


@pytest.mark.parametrize("make", [SimulatedQuadrotor, SimpleQuadrotor])
def test_two_quads_that_meet_collide_and_momentum_stays(
    world: SimulatedWorld, make: type[SimulatedQuadrotor] | type[SimpleQuadrotor]
) -> None:
    one, other = make(world, (-1.0, 0.0, 5.0), 0.0), make(world, (1.0, 0.02, 5.0), 0.0)
    one.rigid.throw((1.5, 0.0, 0.0))
    other.rigid.throw((-1.0, 0.0, 0.0))
    met = False
    while not met and world.time < 1.5:
        world.step()
        met = (0, 1) in world.touched().bodies
    assert met
    run(world, 3 * STEP)
    assert one.state().velocity[0] + other.state().velocity[0] == pytest.approx(
        0.5 * _slowed(one, world.time), abs=0.01
    )
    assert other.state().position[0] - one.state().position[0] == pytest.approx(2 * quadrotor.RADIUS, abs=0.03)
    assert one.state().velocity[0] < other.state().velocity[0] + 0.05, "they do not go through one another"


def _slowed(quad: SimulatedQuadrotor | SimpleQuadrotor, seconds: float) -> float:
    """What the air leaves of a speed."""
    return math.exp(-quadrotor.DRAG * seconds) if isinstance(quad, SimulatedQuadrotor) else 1.0


@pytest.mark.parametrize("make", [SimulatedQuadrotor, SimpleQuadrotor])
def test_a_quad_lands_and_stays_where_it_landed(
    world: SimulatedWorld, make: type[SimulatedQuadrotor] | type[SimpleQuadrotor]
) -> None:
    quad = make(world, (0.0, 0.0, 0.5), 0.0)
    quad.motors(True)
    quad.rigid.throw((0.0, 0.0, -0.4))
    run(world, 0.2)
    assert not world.grounded(quad.rigid)
    ask(quad, (0.0, 0.0, -0.5))
    run(world, 1.5)
    assert world.grounded(quad.rigid)
    quad.motors(False)
    run(world, 1.0)
    assert world.grounded(quad.rigid) and math.hypot(*quad.state().velocity) < 1e-3
    assert quad.state().position == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


@pytest.mark.parametrize("make", [SimulatedCar, SimpleCarBody])
def test_a_car_that_rams_a_box_stops_there_and_can_back_off(
    world: SimulatedWorld, make: type[SimulatedCar] | type[SimpleCarBody]
) -> None:
    box = world.obstacle(Block(Point(1.0, -0.1, 0.0), Point(1.3, 0.3, 0.3)))
    car = make(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    car.drive(2.0, 0.0)
    bumped = False
    for _ in range(360):
        world.step()
        bumped = bumped or (0, box) in world.touched().obstacles
        assert car.state().position[0] + 0.415 < 1.02
    assert bumped
    car.drive(-1.0, 0.0)
    run(world, 2.0)
    assert car.state().position[0] < -0.3
    assert not world._rows, "far from everything no engine is asked"


def test_wind_blows_no_car_away_and_a_slippery_floor_is_one() -> None:
    for friction, farther in ((1.0, 0.0), (0.2, 1.0)):
        world = SimulatedWorld(Wind((5.0, 5.0, 0.0)), friction)
        car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
        run(world, 0.5)
        assert car.state().position == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        car.rigid.throw((3.0, 0.0, 0.0))
        car.brake(6.0)
        run(world, 3.0)
        assert car.state().position[0] == pytest.approx(9.0 / (2 * 0.9 * friction * GRAVITY), rel=0.1), farther
        world.close()


def swarm(engine: str, far: bool) -> list[list[BodyState]]:
    """A crowd with gusts, walls and collisions; and the same with a bystander who is looked at from time to time."""
    world = SimulatedWorld(Wind((0.5, 0.0, 0.0), 0.5, 1.0), seed=5, engine=engine)
    world.obstacle(WALL)
    quads = [SimulatedQuadrotor(world, (0.5 * k - 1.5, 0.3 * k, 0.0), 0.1 * k) for k in range(4)]
    simple = [SimpleQuadrotor(world, (0.5 * k - 1.5, -1.0, 0.5), 0.0) for k in range(3)]
    cars = [SimulatedCar(world, (-3.0 + k, 2.5, 0.0), 0.0, 0.33, 0.4) for k in range(2)]
    seen = []
    for quad in quads:
        quad.motors(True)
    for plain in simple:
        plain.motors(True)
    for k in range(720):
        for i, body in enumerate(quads):
            body.accelerate((math.sin(k / 60 + i), 0.4, 0.5 if k < 200 else -0.3), 0.1 * i)
        for i, other in enumerate(simple):
            other.fly((0.5, 0.1 * i, 0.0), 0.3)
        for car in cars:
            car.drive(1.5 if car is cars[0] else 0.0, 0.0)
        world.step()
        if far or k % 7 == 0:
            seen.append([b.state() for b in quads] + [b.state() for b in simple] + [b.state() for b in cars])
    world.close()
    return seen[::7] if far else seen


@pytest.mark.parametrize("engine", ENGINES)
def test_the_same_commands_give_the_same_motion_to_the_last_bit(engine: str) -> None:
    first = swarm(engine, True)
    assert first == swarm(engine, True) == swarm(engine, False), "looking changes nothing"
