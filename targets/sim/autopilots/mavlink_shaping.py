"""How ArduPilot turns a target that jumps into a path that a vehicle can fly: within an acceleration and a jerk.

The formulas are those of Copter 4.2 to 4.7, libraries/AP_Math/control.cpp (sqrt_controller, shape_vel_accel,
shape_pos_vel_accel; L. Hall, 2020). One form serves both axes: a horizontal vector is a complex number, east + i north,
a height is a float. Metres and seconds.

This is where a real vehicle's lag comes from. Behind a position that moves at v the path stays 2 v acceleration / jerk,
1 s for the default 2.5 m/s^2 and 5 m/s^3; with a velocity to go with it, the error e obeys e'' + 2 e' + 2 e = the
target's acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

Number = TypeVar("Number", float, complex)


def limited(value: Number, most: float) -> Number:
    """The value, shortened to a length of `most`."""
    length = abs(value)
    return value if length <= most else value * (most / length)


def approach(error: Number, gain: float, limit: float, dt: float) -> Number:
    """The rate that closes an error: proportional when near; when far, such that a deceleration of `limit` ends it.
    Never more than the error in one step (sqrt_controller)."""
    far = abs(error)
    if far <= 0.0:
        return error
    knee = limit / gain**2
    rate = gain * far if far <= knee else math.sqrt(2 * limit * (far - knee / 2))
    return error * (min(rate, far / dt) / far)


def reach(speed: float, gain: float, limit: float) -> float:
    """The error for which `approach` asks for this speed (inv_sqrt_controller)."""
    knee = limit / gain
    return speed / gain if speed <= knee else knee / gain / 2 + speed**2 / (2 * limit)


@dataclass(slots=True)
class Path(Generic[Number]):
    """Where the vehicle is wanted now: a point that moves within `acceleration_limit` (m/s^2) and `jerk` (m/s^3)."""

    position: Number
    velocity: Number
    acceleration: Number
    acceleration_limit: float
    jerk: float

    def begin(self, position: Number, velocity: Number, acceleration: Number) -> None:
        """Jump to a state."""
        self.position, self.velocity, self.acceleration = position, velocity, acceleration

    def advance(self, dt: float) -> None:
        """Move on."""
        self.position += self.velocity * dt + self.acceleration * (0.5 * dt * dt)
        self.velocity += self.acceleration * dt

    def seek(self, position: Number, velocity: Number, acceleration: Number, speed: float, dt: float) -> None:
        """Accelerate towards a position that moves with a velocity and an acceleration, at most `speed` faster."""
        gain = 0.5 * self.jerk / self.acceleration_limit
        closing = limited(approach(position - self.position, gain, 0.5 * self.acceleration_limit, dt), speed)
        self.match(closing + velocity, acceleration, dt)

    def match(self, velocity: Number, acceleration: Number, dt: float) -> None:
        """Accelerate towards a velocity that changes by an acceleration."""
        gain = self.jerk / self.acceleration_limit
        wanted = limited(approach(velocity - self.velocity, gain, self.jerk, dt), self.acceleration_limit)
        self.acceleration += limited(wanted + acceleration - self.acceleration, self.jerk * dt)
