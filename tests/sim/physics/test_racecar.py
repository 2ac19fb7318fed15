"""The simulated racecar: tyres that hold so much and no more, a servo that is late, brakes; and its geofence."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from koordgen.runtime.values.points import Point
from targets.car.base.bicycle import BicycleState
from targets.car.control.fence import beyond
from targets.car.control.mpc import Command
from targets.sim.base.bodies import BodyState
from targets.sim.physics.car import CarDynamics, Chassis, SimulatedCar, impulses
from targets.sim.physics.world import GRAVITY, STEP, SimulatedWorld
from tests.car.platform.world import FENCE, TestBody
from tests.car.platform.world import World as CarWorld


@pytest.fixture
def world() -> Iterator[SimulatedWorld]:
    made = SimulatedWorld()
    yield made
    made.close()


def racecar(world: SimulatedWorld, **running: float) -> SimulatedCar:
    return SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4, CarDynamics(**running))


def run(world: SimulatedWorld, car: SimulatedCar, seconds: float) -> BodyState:
    for _ in range(round(seconds / STEP)):
        world.step()
    return car.state()


@pytest.mark.parametrize("friction", [0.2, 0.9])
def test_a_curve_that_is_too_fast_is_driven_as_wide_as_the_tyres_hold(world: SimulatedWorld, friction: float) -> None:
    car = racecar(world, friction=friction)
    car.drive(4.0, 0.0)
    run(world, car, 2.0)
    car.drive(4.0, 0.4)
    run(world, car, 0.5)
    before = car.state()
    after = run(world, car, 0.25)
    gained = math.dist(before.velocity, after.velocity) / 0.25
    assert 0.6 * friction * GRAVITY < gained < 1.05 * friction * GRAVITY
    assert abs(after.yaw_rate) < 0.8 * 4.0 * math.tan(0.4) / 0.33, "on rails it would turn as the bicycle"


def test_within_its_grip_friction_makes_no_difference(world: SimulatedWorld) -> None:
    car = racecar(world, friction=0.5)
    car.drive(1.0, 0.3)
    assert run(world, car, 3.0).yaw_rate == pytest.approx(math.tan(0.3) / 0.33, rel=0.01)


@pytest.mark.parametrize(("asked", "friction", "got"), [(3.0, 0.9, 3.0), (8.0, 0.4, 0.4 * GRAVITY)])
def test_brakes_give_what_was_asked_for_unless_the_tyres_slide(
    world: SimulatedWorld, asked: float, friction: float, got: float
) -> None:
    car = racecar(world, friction=friction)
    car.drive(3.0, 0.0)
    begin = run(world, car, 2.0).velocity[0]
    car.brake(asked)
    end = run(world, car, 0.3).velocity[0]
    assert (begin - end) / 0.3 == pytest.approx(got, rel=0.05)
    assert math.hypot(*run(world, car, 2.0).velocity) < 1e-3
    car.drive(1.0, 0.0)
    assert run(world, car, 1.5).velocity[0] == pytest.approx(1.0, rel=0.01)


def test_the_servo_is_late_by_its_delay(world: SimulatedWorld) -> None:
    car = racecar(world, steering_delay=0.1)
    car.drive(1.0, 0.0)
    run(world, car, 1.0)
    car.drive(1.0, 0.3)
    assert abs(run(world, car, 0.1).yaw_rate) < 1e-3
    assert run(world, car, 0.1).yaw_rate > 0.5


@pytest.mark.parametrize("lag", [0.1, 0.4])
def test_the_speed_loop_has_its_time_constant(world: SimulatedWorld, lag: float) -> None:
    car = racecar(world, speed_lag=lag)
    car.drive(0.3, 0.0)  # no more than the motor's acceleration allows
    assert run(world, car, lag).velocity[0] == pytest.approx(0.3 * (1 - math.exp(-1)), rel=0.05)


def test_how_it_runs_is_said_by_the_sim_targets_settings() -> None:
    assert CarDynamics.of({}) == CarDynamics()
    harness = {"tyre_friction": 0.3, "steering_delay": 0.1, "speed_lag": 0.4, "boot": "real"}
    assert CarDynamics.of(harness) == CarDynamics(0.3, 0.1, 0.4)


def test_tyres_give_no_more_than_their_friction_circle_and_right_what_they_can() -> None:
    chassis = Chassis(3.5, 0.1, 0.165, 0.05)
    forward, left, turn = impulses(chassis, (3.0, 1.0), 2.0, -3.0, 0.4)
    assert math.hypot(forward, left) <= 2 * 0.05 + 1e-9 and abs(turn) <= 2 * 0.05 * 0.165
    strong = Chassis(3.5, 0.1, 0.165, 50.0)
    forward, left, turn = impulses(strong, (1.0, 0.2), 0.5, 1.2, 0.3)
    u, w, spin = 1.0 + forward / 3.5, 0.2 + left / 3.5, 0.5 + turn / 0.1
    assert u == pytest.approx(1.2, abs=1e-3)
    assert w - 0.165 * spin == pytest.approx(0.0, abs=1e-3)
    assert spin == pytest.approx(1.2 * math.tan(0.3) / 0.33, abs=1e-2)


class Racecar(TestBody):
    """The PyBullet car where the tests of the agent have a bicycle."""

    __test__ = False

    def __init__(self, world: SimulatedWorld) -> None:
        super().__init__()
        self._world = world
        self._car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
        self.drive, self.brake = self._car.drive, self._car.brake  # type: ignore[method-assign]

    def state(self) -> BodyState:
        return self._car.state()

    def step(self, seconds: float) -> None:
        self._world.step()
        state = self._car.state()
        self.truth = BicycleState(state.position[0], state.position[1], state.yaw, math.hypot(*state.velocity))


@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0, 3.0])
def test_it_is_braked_before_the_geofence_at_every_speed(
    world: SimulatedWorld, speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the controller wants: here, straight on."""
    bench = CarWorld(Racecar(world), max_speed=speed, max_acceleration=6.0)
    bench.begin()
    navigator = bench.car._navigator
    assert navigator is not None
    monkeypatch.setattr(navigator, "step", lambda state, standing, now: Command(speed, 0.0))
    bench.car.command({"Motion.target": Point(5.0, 0.0)}, bench.now)
    fastest, said = 0.0, set()

    def look() -> None:
        nonlocal fastest
        fastest = max(fastest, bench.body.truth.speed)
        said.add(bench.car.progress)
        assert beyond(FENCE, bench.body.truth.x, bench.body.truth.y) < 0.0

    bench.run(6.0 / speed + 2.0, look)
    assert fastest > 0.9 * speed and bench.body.truth.x > 4.0
    assert "braking: the geofence is ahead" in said
