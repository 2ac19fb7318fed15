"""How a simulated autopilot flies: what it was told to do, for how long that holds, and the path that comes of it.

As ArduCopter/mode_guided.cpp of Copter 4.7: each kind of setpoint is a submode of its own, and a change of submode
starts the position controller anew from where the vehicle is, with the default speed. In local ENU about the fleet's
origin, metres and seconds; the speeds are ArduPilot's defaults (WP_SPD_UP, WP_SPD_DN, LAND_SPEED, LAND_ALT_LOW).
"""

from __future__ import annotations

import cmath
import enum
import math
from dataclasses import dataclass
from typing import Generic, TypeVar

# How ArduPilot turns a target that jumps into a path that a vehicle can fly: within an acceleration and a jerk.
#
# The formulas are those of Copter 4.2 to 4.7, libraries/AP_Math/control.cpp (sqrt_controller, shape_vel_accel,
# shape_pos_vel_accel; L. Hall, 2020). One form serves both axes: a horizontal vector is a complex number, east + i
# north, a height is a float. Metres and seconds.
#
# This is where a real vehicle's lag comes from. Behind a position that moves at v the path stays 2 v acceleration /
# jerk, 1 s for the default 2.5 m/s^2 and 5 m/s^3; with a velocity to go with it, the error e obeys e'' + 2 e' + 2 e =
# the target's acceleration.

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


# Keeps a vehicle on its path: ArduPilot's position P and velocity PID, which ask for an acceleration.
#
# The structure and the gains are the defaults of Copter 4.7, libraries/AC_AttitudeControl/AC_PosControl.cpp
# (PSC_NE_POS_P, PSC_NE_VEL_*, PSC_D_POS_P, PSC_D_VEL_P, PSC_JERK_*) and AC_WPNav.cpp (WP_ACC, WP_ACC_Z). What follows
# them in the real one, leaning and thrust, is the body's: it takes a tenth of a second. Vectors as in mavlink_shaping.

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


Vector = tuple[float, float, float]

STILL: Vector = (0.0, 0.0, 0.0)
TIMEOUT = 3.0  # seconds for which a velocity is kept (GUID_TIMEOUT)
SPEED, SPEED_UP, SPEED_DOWN = 5.0, 2.5, 1.5
LAND_FAST, LAND_SLOW, LAND_SLOWLY_BELOW = 1.5, 0.5, 10.0
YAW_GAIN, YAW_RATE = 1.5, 1.0  # rad/s per rad, and at most
TURNS_ABOVE = 0.05  # of the speed limit: faster, and it turns its nose to where it flies (AC_PosControl)


class Aim(enum.Enum):
    """What the vehicle is steered to."""

    HOLD = enum.auto()  # brake, and stay there
    TAKEOFF = enum.auto()
    POSITION = enum.auto()
    VELOCITY = enum.auto()
    POSITION_VELOCITY = enum.auto()
    LAND = enum.auto()
    FALL = enum.auto()  # a manual mode without anybody at the sticks


FOLLOWING = (Aim.POSITION, Aim.VELOCITY, Aim.POSITION_VELOCITY)


class Guidance:
    """The current aim. `speed` is the horizontal limit, `up` and `down` are the vertical ones; `position` is the
    target, for LAND home's height. `yaw` (rad, ENU) is kept; where `looks_ahead`, and no setpoint says otherwise, it
    turns to the direction of flight."""

    def __init__(self) -> None:
        self.speed = SPEED
        self.default_speed = SPEED
        self.up, self.down = self.default_up, self.default_down = SPEED_UP, SPEED_DOWN
        self.timeout = TIMEOUT
        self.looks_ahead = True
        self.aim = Aim.HOLD
        self.position: Vector = STILL
        self.velocity: Vector = STILL
        self.push: Vector = STILL  # m/s^2, that goes with the velocity
        self.since = 0.0
        self.descends = 0.0  # when a LAND begins to go down
        self.yaw = 0.0
        self.yaw_rate = 0.0
        self._yaw_told = False
        self._begun = False
        self._level, self._height = horizontal(), vertical()

    def go(self, aim: Aim, now: float, position: Vector, velocity: Vector = STILL, push: Vector = STILL) -> None:
        """A new aim, or the same with other numbers."""
        if aim is not self.aim:
            self._begun = False
            if aim is not Aim.TAKEOFF:  # the only change of submode that keeps the speeds
                self.take_default_speeds()
        self.aim, self.since = aim, now
        self.position, self.velocity, self.push = position, velocity, push
        self.turn(None, 0.0)

    def take_default_speeds(self) -> None:
        """Forget the limits that commands have set."""
        self.speed, self.up, self.down = self.default_speed, self.default_up, self.default_down

    def land(self, now: float, position: Vector, pause: float) -> None:
        """Go down after a pause (s)."""
        self.go(Aim.LAND, now, position)
        self.descends = now + pause

    def turn(self, yaw: float | None, rate: float) -> None:
        """What the last setpoint says of the yaw: nothing, an angle, a rate, or both."""
        self._yaw_told = yaw is not None or rate != 0.0 or self.aim not in FOLLOWING
        self.yaw_rate = rate
        if yaw is not None:
            self.yaw = yaw

    def stop(self, now: float, position: Vector) -> None:
        """Brake, from whatever it is at (ModeGuided::init)."""
        self._begun = False
        self.go(Aim.HOLD, now, position)

    def rest(self) -> None:
        """On the ground: begin anew when it leaves it."""
        self._begun = False
        self._level.rest()
        self._height.rest()

    def turning(self, yaw: float, dt: float) -> float:
        """The yaw rate to ask of the body, given its yaw."""
        self.yaw += self.yaw_rate * dt
        velocity = self._level.path.velocity
        if self.looks_ahead and not self._yaw_told and abs(velocity) > TURNS_ABOVE * self.speed:
            self.yaw = cmath.phase(velocity)
        wanted = YAW_GAIN * math.remainder(self.yaw - yaw, math.tau) + self.yaw_rate
        return max(-YAW_RATE, min(YAW_RATE, wanted))

    def acceleration(self, position: Vector, velocity: Vector, now: float, dt: float) -> Vector:
        """What to ask of the body, given where the vehicle believes to be. `dt` is positive."""
        if self.aim is Aim.FALL:
            return 0.0, 0.0, -9.0
        at, moving = complex(position[0], position[1]), complex(velocity[0], velocity[1])
        if not self._begun:
            self._begun = True
            self._level.begin(at, moving)
            self._height.begin(position[2], velocity[2])
        if now - self.since > self.timeout and self.aim in FOLLOWING:
            self.velocity, self.push, self.yaw_rate = STILL, STILL, 0.0
        self._level.path.advance(dt)
        self._height.path.advance(dt)
        self._shape(position[2], now, dt)
        level = self._level.acceleration(at, moving, self.speed, dt)
        rising = self.up if self._height.path.position > position[2] else self.down
        return level.real, level.imag, self._height.acceleration(position[2], velocity[2], rising, dt)

    def _shape(self, height: float, now: float, dt: float) -> None:
        """Bend the path towards the aim."""
        level, up = self._level.path, self._height.path
        (x, y, z), (vx, vy, vz), (ax, ay, az) = self.position, self.velocity, self.push
        match self.aim:
            case Aim.POSITION | Aim.TAKEOFF:
                fast, rising = self._speeds(abs(complex(x, y) - level.position), z - up.position)
                level.seek(complex(x, y), 0j, 0j, fast, dt)
                up.seek(z, 0.0, 0.0, rising, dt)
            case Aim.POSITION_VELOCITY:
                level.seek(complex(x, y), complex(vx, vy), complex(ax, ay), self.speed, dt)
                up.seek(z, vz, az, self.up if z > up.position else self.down, dt)
                self.position = (x + vx * dt, y + vy * dt, z + vz * dt)
            case Aim.LAND:
                level.match(0j, 0j, dt)
                fast = LAND_SLOW if height < z + LAND_SLOWLY_BELOW else LAND_FAST
                up.match(-fast if now >= self.descends else 0.0, 0.0, dt)
            case _:
                level.match(complex(vx, vy), complex(ax, ay), dt)
                up.match(vz, az, dt)
        self.velocity = (vx + ax * dt, vy + ay * dt, vz + az * dt)

    def _speeds(self, far: float, up: float) -> tuple[float, float]:
        """The horizontal and the vertical speed of a straight way there, within both limits (kinematic_limit)."""
        length = math.hypot(far, up)
        if length <= 0.0:
            return self.speed, self.up
        level, steep = far / length, abs(up) / length
        vertical_limit = self.up if up > 0 else self.down
        along = min(self.speed / max(level, 1e-9), vertical_limit / max(steep, 1e-9))
        return along * level, along * steep
