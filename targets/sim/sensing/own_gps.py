"""Position error of an autopilot with its own GPS: a wandering error plus the robot's injected faults."""

from __future__ import annotations

import math
import random
from collections import deque

from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.fault_state import NO_POSITIONING_FAULT, FaultState

WANDER = 2.0  # seconds, correlation time of the wandering error
PERIOD = 0.2  # seconds between two fixes
CORRECTED = 1.0  # seconds, time constant with which the estimate follows faulty fixes, or good ones again
HELD = 60.0  # seconds of past positions kept for delayed fixes
HERE: Vector = (0.0, 0.0, 0.0)
NEAR = 1e-4  # metres: a smaller remaining error counts as none


class OwnGps:
    """Error model. `noise` (m): standard deviation of the usual error. `fixed`: time of the last fix."""

    def __init__(self, noise: float, fault_state: FaultState, dice: random.Random) -> None:
        self._noise, self._random = noise, dice
        self.fault_state = fault_state
        self.fixed = math.inf  # no fix was lost so far
        self._next = -math.inf
        self._usual: Vector = (0.0, 0.0, 0.0)
        self._pulled: Vector = (0.0, 0.0, 0.0)
        self._drift: Vector = (0.0, 0.0, 0.0)  # m/s
        self._past: deque[tuple[float, Vector]] = deque()

    def error(self, truth: BodyState, now: float, dt: float, bias: Vector) -> Vector:
        """Return the error in metres, `dt` seconds after the last call.

        `bias` (m/s^2) of the accelerometers makes the error grow while no fix arrives."""
        wrong = self.fault_state.positioning
        if wrong is NO_POSITIONING_FAULT and self._pulled == HERE:
            self.fixed = now
            if self._noise:
                self._wander(dt, self._noise)
            return self._usual
        if self._noise or wrong.noise:
            self._wander(dt, math.hypot(self._noise, wrong.noise))
        if wrong.delay:
            self._past.append((now, truth.position))
            while self._past and self._past[0][0] < now - HELD:
                self._past.popleft()
        elif self._past:
            self._past.clear()
        if now >= self._next:
            self._next = max(self._next, now - PERIOD) + PERIOD
            if not wrong.dropout or self._random.random() >= wrong.dropout:
                self.fixed, self._drift = now, (0.0, 0.0, 0.0)
        if wrong.dropout and now - self.fixed > PERIOD:
            self._drift = _plus(self._drift, bias, dt)
            self._pulled = _plus(self._pulled, self._drift, dt)
        else:
            told = _plus(
                wrong.bias, _plus(self._position_at(now - wrong.delay, truth.position), truth.position, -1.0), 1.0
            )
            rest = _plus(told, self._pulled, -1.0)
            self._pulled = _plus(self._pulled, rest, 1.0 - math.exp(-dt / CORRECTED))
            if wrong is NO_POSITIONING_FAULT and math.hypot(*rest) < NEAR:
                self._pulled = HERE
        return _plus(self._usual, self._pulled, 1.0)

    def _wander(self, dt: float, noise: float) -> None:
        """Step the wandering error, a first-order Gauss-Markov process."""
        keep = math.exp(-dt / WANDER) if dt else 0.0
        fresh = noise * math.sqrt(1 - keep * keep)
        (x, y, z), gauss = self._usual, self._random.gauss
        self._usual = (keep * x + gauss(0, fresh), keep * y + gauss(0, fresh), keep * z + gauss(0, fresh))

    def _position_at(self, time: float, present: Vector) -> Vector:
        """Return the position at `time`, as far back as it is known."""
        while len(self._past) > 1 and self._past[1][0] <= time:
            self._past.popleft()
        return self._past[0][1] if self._past else present


def _plus(a: Vector, b: Vector, share: float) -> Vector:
    """Return a + share * b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]
