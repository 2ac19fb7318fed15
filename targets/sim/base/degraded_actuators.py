"""Degraded actuators: a body whose motors and servos respond more slowly than usual."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from targets.sim.base.bodies import Vector
from targets.sim.base.fault_state import FaultState

Command = tuple[float, ...]


class DegradedActuators:
    """Wrapper of a body that delays commands by a first-order lag of `fault_state.lag` seconds.

    Everything else passes without delay. `clock` returns the world's time."""

    def __init__(self, body: Any, fault_state: FaultState, clock: Callable[[], float]) -> None:
        self._body, self._fault_state, self._clock = body, fault_state, clock
        self._received: dict[str, tuple[float, Command]] = {}  # command -> time and value that the body last received

    def __getattr__(self, name: str) -> Any:
        return getattr(self._body, name)

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        """See bodies.Quadrotor."""
        x, y, z, rate = self._lagged("accelerate", (*acceleration, yaw_rate))
        self._body.accelerate((x, y, z), rate)

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        """See first_order.SimpleQuadrotor."""
        x, y, z, rate = self._lagged("fly", (*velocity, yaw_rate))
        self._body.fly((x, y, z), rate)

    def thrusts(self, shares: tuple[float, float, float, float]) -> None:
        """See quadrotor.SimulatedQuadrotor."""
        a, b, c, d = self._lagged("thrusts", shares)
        self._body.thrusts((a, b, c, d))

    def drive(self, speed: float, steering: float) -> None:
        """See bodies.Car."""
        self._body.drive(*self._lagged("drive", (speed, steering)))

    def _lagged(self, name: str, asked: Command) -> Command:
        lag = self._fault_state.lag
        if lag <= 0.0:
            if self._received:
                self._received.clear()
            return asked
        now = self._clock()
        at, before = self._received.get(name, (now, asked))
        share = 1.0 - math.exp((at - now) / lag)
        given = tuple(b + share * (a - b) for a, b in zip(asked, before, strict=True))
        self._received[name] = now, given
        return given
