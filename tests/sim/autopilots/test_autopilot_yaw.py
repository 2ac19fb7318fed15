"""Where the simulated autopilot turns its nose: as a setpoint says, else along its way, as ArduPilot's default does."""

from __future__ import annotations

import math

import pytest

from benchmarks.fixtures.quad_rig import STEP
from targets.sim.autopilots.mavlink_guided import Guidance, GuidanceMode


class Turning:
    """A body that does exactly what is asked of it, 2 m up."""

    def __init__(self) -> None:
        self.guidance = Guidance()
        self.position, self.velocity = [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]
        self.yaw, self.now = 0.0, 0.0

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            (x, y, z), (vx, vy, vz) = self.position, self.velocity
            asked = self.guidance.acceleration((x, y, z), (vx, vy, vz), self.now, STEP)
            self.yaw += self.guidance.turning(self.yaw, STEP) * STEP
            for i in range(3):
                self.velocity[i] += asked[i] * STEP
                self.position[i] += self.velocity[i] * STEP


def test_it_looks_where_it_flies() -> None:
    body = Turning()
    body.guidance.go(GuidanceMode.POSITION, 0.0, (0.0, 20.0, 2.0))
    body.fly(5.0)
    assert body.yaw == pytest.approx(math.pi / 2, abs=0.05)
    body.guidance.go(GuidanceMode.POSITION, body.now, (0.0, body.position[1], 2.0))
    body.fly(10.0)
    assert abs(math.remainder(body.yaw, math.pi)) == pytest.approx(math.pi / 2, abs=0.1), "slow, it keeps its nose"


def test_slowly_it_keeps_its_nose() -> None:
    body = Turning()
    for tick in range(80):
        body.guidance.go(GuidanceMode.POSITION, body.now, (0.0, 0.2 * tick * 0.1, 2.0))
        body.fly(0.1)
    assert body.yaw == 0.0


def test_a_setpoint_with_a_yaw_is_obeyed() -> None:
    body = Turning()
    body.guidance.go(GuidanceMode.POSITION, 0.0, (0.0, 20.0, 2.0))
    body.guidance.turn(-1.0, 0.0)
    body.fly(5.0)
    assert body.yaw == pytest.approx(-1.0, abs=0.02)


def test_a_yaw_rate_lasts_three_seconds() -> None:
    body = Turning()
    body.guidance.go(GuidanceMode.VELOCITY, 0.0, (0.0, 0.0, 2.0))
    body.guidance.turn(None, 0.4)
    body.fly(10.0)
    assert body.yaw == pytest.approx(1.2, abs=0.05)


def test_it_need_not_look_ahead() -> None:
    body = Turning()
    body.guidance.looks_ahead = False
    body.guidance.go(GuidanceMode.POSITION, 0.0, (0.0, 20.0, 2.0))
    body.fly(5.0)
    assert body.yaw == 0.0
