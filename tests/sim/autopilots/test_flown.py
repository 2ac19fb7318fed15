"""The simulated autopilot on the body with four motors: what was measured on ArduPilot 4.7 holds there, too."""

from __future__ import annotations

import math

import pytest

from benchmarks.fixtures import quad_rig as rig
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import SimulatedWorld
from tests.sim.autopilots.bench import Bench
from tests.sim.autopilots.test_autopilot_timing import REAL, lifted
from tests.sim.autopilots.test_autopilot_tracking import carrot, circle, followed, mean


class Motors:
    """In place of `rig.PointMass`."""

    def __init__(self, position: Vector = (1.0, -2.0, 0.0)) -> None:
        self.world = SimulatedWorld()
        self._quad = SimulatedQuadrotor(self.world, position, 0.0)
        self.accelerate, self.motors = self._quad.accelerate, self._quad.motors

    def state(self) -> BodyState:
        return self._quad.state()

    @property
    def position(self) -> Vector:
        return self.state().position

    def step(self, dt: float) -> None:
        self.world.step()


@pytest.fixture(autouse=True)
def motors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "PointMass", Motors)


def test_a_position_that_moves_is_followed_half_a_metre_behind() -> None:
    assert mean(followed(0xDF8, carrot, 20, 14)[-100:]) == pytest.approx(0.54, rel=0.15)


def test_at_one_setpoint_a_second_it_falls_further_behind() -> None:
    assert mean(followed(0xDF8, carrot, 1, 14)[-100:]) == pytest.approx(0.82, rel=0.15)


def test_a_circle_of_positions_and_velocities_is_left_by_a_quarter_of_a_metre() -> None:
    assert mean(followed(0xDC0, circle, 20, 32)) == pytest.approx(0.26, rel=0.15)


def test_it_leaves_the_ground_3_3_s_after_the_command_and_climbs_at_1_2_m_s() -> None:
    left, fastest = lifted(Bench(harness=REAL))
    assert left == pytest.approx(3.3, abs=0.3) and fastest == pytest.approx(1.22, rel=0.15)


def test_it_hovers_without_swinging() -> None:
    bench = Bench()
    bench.fly()
    bench.wait(10.0)
    moved = []
    for _ in range(100):
        bench.wait(0.05)
        moved.append(math.hypot(*bench.rig.body.state().velocity))
    assert max(moved) < 0.02
