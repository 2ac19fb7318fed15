"""Devices of robots of fidelity `simple`: nothing stands between the agent's platform and the body.

The platform that the agent gets for such a robot asks the device here, which is the body with the errors of positions,
and with what a robot does whose agent has fallen silent: a quad stops, and lands later; a car brakes.
"""

from __future__ import annotations

import importlib
import random
from collections.abc import Callable, Mapping
from typing import Any

from targets.sim.bodies import BodyState, DeviceContext, Vector
from targets.sim.first_order import SimpleCar, SimpleQuadrotor

HOVERING, LANDING = 0.5, 5.0  # s without a command after which a quad stops, and lands, as an autopilot does
BRAKING = 0.15  # s without a command after which a car brakes, as its watchdog does
SINKING, GROUND = 0.5, 0.02  # m/s, m


class Direct:
    """targets.sim.bodies.Device. `platform` makes the agent's, in this process."""

    made: str  # what makes the platform

    def __init__(self, body: SimpleQuadrotor | SimpleCar, context: DeviceContext) -> None:
        self._seen = body
        self._noise = float(context.harness.get("position_noise", 0.0))
        self._dice = random.Random(f"{context.seed}/{context.robot}/simple")
        self._upset = context.upset
        self._now, self._heard = 0.0, 0.0
        self.overrides: Mapping[str, Any] = {}

    def platform(self, settings: Any, key: bytes | None, inside: Any) -> Any:
        """See koordgen.runtime.inside."""
        module, _, member = self.made.partition(":")
        make: Callable[..., Any] = getattr(importlib.import_module(module), member)
        return make(settings, key, inside, self)

    def state(self) -> BodyState | None:
        """Where the body is taken to be; None: that is not known now."""
        truth = self._upset.late(self._now, self._seen.state())
        place = self._upset.measured(truth.position, self._noise, self._dice)
        return None if place is None else BodyState(place, truth.velocity, truth.yaw, truth.yaw_rate)

    def step(self, now: float) -> None:
        """See Device."""
        self._now = now

    def close(self) -> None:
        """See Device."""


class DirectQuad(Direct):
    """Flies as its platform says."""

    made = "targets.quad.simple:inside"

    def __init__(self, body: SimpleQuadrotor, context: DeviceContext) -> None:
        super().__init__(body, context)
        self._body = body
        self._flying = False

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        self._heard = self._now
        self._body.fly(velocity, yaw_rate)

    def motors(self, on: bool) -> None:
        self._heard, self._flying = self._now, on
        self._body.motors(on)

    def step(self, now: float) -> None:
        """See Device."""
        self._now = now
        silent = now - self._heard
        if not self._flying or silent <= HOVERING:
            return
        if silent > LANDING and self._body.state().position[2] < GROUND:
            self._flying = False
            self._body.motors(False)
        self._body.fly((0.0, 0.0, -SINKING if silent > LANDING else 0.0), 0.0)


class DirectCar(Direct):
    """Drives as its platform says."""

    made = "targets.car.simple:inside"

    def __init__(self, body: SimpleCar, context: DeviceContext) -> None:
        super().__init__(body, context)
        self._body = body
        self._braking = float(context.settings.get("braking", 3.0))

    def drive(self, speed: float, steering: float) -> None:
        self._heard = self._now
        self._body.drive(speed, steering)

    def brake(self, deceleration: float) -> None:
        self._heard = self._now
        self._body.brake(deceleration)

    def step(self, now: float) -> None:
        """See Device."""
        self._now = now
        if now - self._heard > BRAKING:
            self._body.brake(self._braking)
