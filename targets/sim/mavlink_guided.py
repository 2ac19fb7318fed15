"""How a simulated autopilot flies: setpoint groups and their timeouts, and the cascade from position to acceleration.

Everything in local ENU about the fleet's origin, metres and seconds. The numbers are ArduPilot's defaults where it has
one (POSXY_P, VELXY_P, WPNAV_SPEED, WPNAV_ACCEL, LAND_SPEED), so that a position that moves is followed as late as
by the real one: about 1.1 s.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

Vector = tuple[float, float, float]

TIMEOUT = 3.0  # seconds for which a velocity is kept
ACCELERATION = 2.5
SPEED_UP, SPEED_DOWN = 2.5, 1.5
LAND_FAST, LAND_SLOW, LAND_SLOWLY_BELOW = 1.5, 0.5, 5.0
_POSITION_GAIN = 1.0
_VELOCITY_GAIN = 2.0
_VERTICAL_GAIN = 4.0


class Aim(enum.Enum):
    """What the vehicle is steered to."""

    HOLD = enum.auto()
    TAKEOFF = enum.auto()
    POSITION = enum.auto()
    VELOCITY = enum.auto()
    POSITION_VELOCITY = enum.auto()
    LAND = enum.auto()
    FALL = enum.auto()  # a manual mode without anybody at the sticks


@dataclass(slots=True)
class Guidance:
    """The current aim. `speed` is the horizontal limit; `yaw` (rad, ENU) is kept."""

    speed: float = 5.0
    aim: Aim = Aim.HOLD
    position: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    since: float = 0.0
    yaw: float = 0.0

    def go(self, aim: Aim, now: float, position: Vector, velocity: Vector = (0.0, 0.0, 0.0)) -> None:
        """Steer to this from now on."""
        self.aim, self.position, self.velocity, self.since = aim, position, velocity, now

    def acceleration(self, position: Vector, velocity: Vector, now: float, dt: float) -> Vector:
        """What to ask of the body, given where the vehicle believes to be."""
        if self.aim is Aim.FALL:
            return 0.0, 0.0, -9.0
        if now - self.since > TIMEOUT:
            if self.aim is Aim.VELOCITY:
                self.go(Aim.HOLD, now, position)
            elif self.aim is Aim.POSITION_VELOCITY:
                self.velocity = (0.0, 0.0, 0.0)
        if self.aim is Aim.POSITION_VELOCITY:
            p, v = self.position, self.velocity
            self.position = (p[0] + v[0] * dt, p[1] + v[1] * dt, p[2] + v[2] * dt)
        wanted = self._velocity(position)
        ax = _VELOCITY_GAIN * (wanted[0] - velocity[0])
        ay = _VELOCITY_GAIN * (wanted[1] - velocity[1])
        scale = min(1.0, 2 * ACCELERATION / max(math.hypot(ax, ay), 1e-9))
        az = _VERTICAL_GAIN * (wanted[2] - velocity[2])
        return ax * scale, ay * scale, max(-2 * ACCELERATION, min(2 * ACCELERATION, az))

    def _velocity(self, position: Vector) -> Vector:
        v = self.velocity
        if self.aim is Aim.VELOCITY:
            vx, vy, vz = v
        else:
            ex, ey, ez = (t - p for t, p in zip(self.position, position, strict=True))
            far = math.hypot(ex, ey)
            speed = _approach(far)
            vx = v[0] + (ex / far * speed if far > 1e-9 else 0.0)
            vy = v[1] + (ey / far * speed if far > 1e-9 else 0.0)
            vz = v[2] + math.copysign(_approach(abs(ez)), ez)
        if self.aim is Aim.LAND:
            vz = -(LAND_SLOW if position[2] < self.position[2] + LAND_SLOWLY_BELOW else LAND_FAST)
        scale = min(1.0, self.speed / max(math.hypot(vx, vy), 1e-9))
        return vx * scale, vy * scale, max(-SPEED_DOWN, min(SPEED_UP, vz))


def _approach(far: float) -> float:
    """The speed at a distance: proportional when near, and braking at ACCELERATION when far (ArduPilot's
    sqrt_controller)."""
    linear = ACCELERATION / _POSITION_GAIN**2
    if far <= linear:
        return _POSITION_GAIN * far
    return math.sqrt(2 * ACCELERATION * (far - linear / 2))
