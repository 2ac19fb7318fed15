"""Keeps a vehicle on its path: ArduPilot's position P and velocity PID, which ask for an acceleration.

The structure and the gains are the defaults of Copter 4.7, libraries/AC_AttitudeControl/AC_PosControl.cpp
(PSC_NE_POS_P, PSC_NE_VEL_*, PSC_D_POS_P, PSC_D_VEL_P, PSC_JERK_*) and AC_WPNav.cpp (WP_ACC, WP_ACC_Z). What follows
them in the real one, leaning and thrust, is the body's: it takes a tenth of a second. Vectors as in mavlink_shaping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic

from targets.sim.autopilots.mavlink_shaping import Number, Path, approach, limited, reach

ACCELERATION, JERK = 2.5, 5.0  # m/s^2, m/s^3
ACCELERATION_UP, JERK_UP = 1.0, 5.0
MOST = 9.81 * math.tan(math.radians(30))  # m/s^2, horizontally: ANGLE_MAX
ERROR_FILTER = 2 * math.pi * 5.0  # 1/s: PSC_NE_VEL_FLTE and _FLTD


@dataclass(frozen=True, slots=True)
class Gains:
    """1/s for a position error; 1/s, 1/s^2 and 1 for a velocity error, its integral and its derivative."""

    position: float
    proportional: float
    integral: float
    derivative: float


HORIZONTAL = Gains(1.0, 2.0, 1.0, 0.25)
VERTICAL = Gains(1.0, 5.0, 0.0, 0.0)
INTEGRAL_LIMIT = 10.0  # m/s^2


class Axis(Generic[Number]):
    """One of the two loops: horizontal (complex) or vertical (float)."""

    def __init__(self, gains: Gains, path: Path[Number], most: float) -> None:
        self._gains, self._most = gains, most
        self._nothing: Number = path.position * 0
        self._integral: Number = self._nothing
        self._error: Number = self._nothing
        self._derivative: Number = self._nothing
        self._asked: Number = self._nothing
        self.path: Path[Number] = path

    def begin(self, position: Number, velocity: Number) -> None:
        """Start anew from where the vehicle is and as it moves, without a jump of what is asked for."""
        if self._gains.integral:
            self.path.begin(position, velocity, self._nothing)
            self._integral = self._asked
        else:
            self.path.begin(position, velocity, limited(self._asked, self.path.acceleration_limit))
        self._error = self._derivative = self._nothing

    def rest(self) -> None:
        """Nothing is asked for: the vehicle is on the ground."""
        self._asked = self._nothing

    def acceleration(self, position: Number, velocity: Number, speed: float, dt: float) -> Number:
        """What to ask of the body; `speed` limits what a position error may ask for."""
        gains, path = self._gains, self.path
        limit = path.acceleration_limit
        off = limited(path.position - position, reach(speed, gains.position, limit))
        path.position = position + off  # a path does not run away from a vehicle that cannot follow
        wrong = path.velocity + approach(off, gains.position, limit, dt) - velocity
        share = ERROR_FILTER * dt / (1 + ERROR_FILTER * dt)
        before = self._error
        self._error += (wrong - self._error) * share
        self._derivative += ((self._error - before) / dt - self._derivative) * share
        self._integral = limited(self._integral + self._error * (gains.integral * dt), INTEGRAL_LIMIT)
        correction = self._error * gains.proportional + self._integral + self._derivative * gains.derivative
        self._asked = limited(path.acceleration + correction, self._most)
        return self._asked


def horizontal() -> Axis[complex]:
    """The loop of both horizontal directions."""
    return Axis(HORIZONTAL, Path(0j, 0j, 0j, ACCELERATION, JERK), MOST)


def vertical() -> Axis[float]:
    """The loop of the height."""
    return Axis(VERTICAL, Path(0.0, 0.0, 0.0, ACCELERATION_UP, JERK_UP), 9.81)
