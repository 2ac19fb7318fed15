"""Guidance of a simulated autopilot: setpoints, their timeout, path shaping and position control.

As ArduCopter/mode_guided.cpp of Copter 4.7: each kind of setpoint is a submode of its own, and a change of submode
restarts the position controller at the vehicle's state, with the default speed. Local ENU about the fleet's origin, in
metres and seconds. The speeds are ArduPilot's defaults (WP_SPD_UP, WP_SPD_DN, LAND_SPEED, LAND_ALT_LOW)."""

from __future__ import annotations

import cmath
import enum
import math
from dataclasses import dataclass
from typing import Generic, TypeVar

# Path shaping: ArduPilot turns a target that jumps into a path with limited acceleration and jerk.
#
# The formulas are those of Copter 4.2 to 4.7, libraries/AP_Math/control.cpp (sqrt_controller, shape_vel_accel,
# shape_pos_vel_accel; L. Hall, 2020). One form serves both axes: a horizontal vector is a complex number, east + i
# north, a height is a float. Metres and seconds.
#
# The lag of a real vehicle comes from here. Behind a position that moves at v the path stays 2 v acceleration / jerk, 1
# s for the default 2.5 m/s^2 and 5 m/s^3. With a velocity to go with it, the error e obeys e'' + 2 e' + 2 e = the
# target's acceleration.

Number = TypeVar("Number", float, complex)


def limited(value: Number, most: float) -> Number:
    """Shorten a value to a length of at most `most`."""
    length = abs(value)
    return value if length <= most else value * (most / length)


def approach(error: Number, gain: float, limit: float, dt: float) -> Number:
    """Return the rate that closes an error (sqrt_controller).

    Proportional when near; when far, such that a deceleration of `limit` ends it. Never more than the error in one
    step."""
    far = abs(error)
    if far <= 0.0:
        return error
    knee = limit / gain**2
    rate = gain * far if far <= knee else math.sqrt(2 * limit * (far - knee / 2))
    return error * (min(rate, far / dt) / far)


def reach(speed: float, gain: float, limit: float) -> float:
    """Return the error for which `approach` returns this speed (inv_sqrt_controller)."""
    knee = limit / gain
    return speed / gain if speed <= knee else knee / gain / 2 + speed**2 / (2 * limit)


@dataclass(slots=True)
class Path(Generic[Number]):
    """Shaped target point that moves within `acceleration_limit` (m/s^2) and `jerk` (m/s^3)."""

    position: Number
    velocity: Number
    acceleration: Number
    acceleration_limit: float
    jerk: float

    def begin(self, position: Number, velocity: Number, acceleration: Number) -> None:
        """Set position, velocity and acceleration."""
        self.position, self.velocity, self.acceleration = position, velocity, acceleration

    def advance(self, dt: float) -> None:
        """Extrapolate by `dt` seconds."""
        self.position += self.velocity * dt + self.acceleration * (0.5 * dt * dt)
        self.velocity += self.acceleration * dt

    def seek(self, position: Number, velocity: Number, acceleration: Number, speed: float, dt: float) -> None:
        """Accelerate towards a position that moves with velocity and acceleration, at most `speed` faster."""
        gain = 0.5 * self.jerk / self.acceleration_limit
        closing = limited(approach(position - self.position, gain, 0.5 * self.acceleration_limit, dt), speed)
        self.match(closing + velocity, acceleration, dt)

    def match(self, velocity: Number, acceleration: Number, dt: float) -> None:
        """Accelerate towards a velocity that changes by an acceleration."""
        gain = self.jerk / self.acceleration_limit
        wanted = limited(approach(velocity - self.velocity, gain, self.jerk, dt), self.acceleration_limit)
        self.acceleration += limited(wanted + acceleration - self.acceleration, self.jerk * dt)


# Position control: ArduPilot's position P and velocity PID, whose output is an acceleration.
#
# Structure and gains are the defaults of Copter 4.7, libraries/AC_AttitudeControl/AC_PosControl.cpp (PSC_NE_POS_P,
# PSC_NE_VEL_*, PSC_D_POS_P, PSC_D_VEL_P, PSC_JERK_*) and AC_WPNav.cpp (WP_ACC, WP_ACC_Z). The real controller then
# commands lean and thrust. The simulated body does this part: it takes a tenth of a second.

ACCELERATION, JERK = 2.5, 5.0  # m/s^2, m/s^3
ACCELERATION_UP, JERK_UP = 1.0, 5.0
MOST = 9.81 * math.tan(math.radians(30))  # m/s^2, horizontally: ANGLE_MAX
ERROR_FILTER = 2 * math.pi * 5.0  # 1/s: PSC_NE_VEL_FLTE and _FLTD


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains: 1/s for a position error.

    1/s, 1/s^2 and 1 for a velocity error, its integral and its derivative."""

    position: float
    proportional: float
    integral: float
    derivative: float


HORIZONTAL = Gains(1.0, 2.0, 1.0, 0.25)
VERTICAL = Gains(1.0, 5.0, 0.0, 0.0)
INTEGRAL_LIMIT = 10.0  # m/s^2


class Axis(Generic[Number]):
    """Control loop of one axis: horizontal (complex) or vertical (float)."""

    def __init__(self, gains: Gains, path: Path[Number], most: float) -> None:
        self._gains, self._most = gains, most
        self._nothing: Number = path.position * 0
        self._integral: Number = self._nothing
        self._error: Number = self._nothing
        self._derivative: Number = self._nothing
        self._asked: Number = self._nothing
        self.path: Path[Number] = path

    def begin(self, position: Number, velocity: Number) -> None:
        """Restart at the vehicle's state, without a jump of the commanded acceleration."""
        if self._gains.integral:
            self.path.begin(position, velocity, self._nothing)
            self._integral = self._asked
        else:
            self.path.begin(position, velocity, limited(self._asked, self.path.acceleration_limit))
        self._error = self._derivative = self._nothing

    def idle(self) -> None:
        """Command no acceleration: the vehicle is on the ground."""
        self._asked = self._nothing

    def acceleration(self, position: Number, velocity: Number, speed: float, dt: float) -> Number:
        """Return the commanded acceleration. `speed` limits the correction of a position error."""
        gains, path = self._gains, self.path
        limit = path.acceleration_limit
        off = limited(path.position - position, reach(speed, gains.position, limit))
        path.position = position + off  # keep the path near a vehicle that cannot follow it
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
    """Return the control loop of both horizontal directions."""
    return Axis(HORIZONTAL, Path(0j, 0j, 0j, ACCELERATION, JERK), MOST)


def vertical() -> Axis[float]:
    """Return the control loop of the height."""
    return Axis(VERTICAL, Path(0.0, 0.0, 0.0, ACCELERATION_UP, JERK_UP), 9.81)


Vector = tuple[float, float, float]

STILL: Vector = (0.0, 0.0, 0.0)
TIMEOUT = 3.0  # seconds for which a velocity setpoint holds (GUID_TIMEOUT)
SPEED, SPEED_UP, SPEED_DOWN = 5.0, 2.5, 1.5
LAND_FAST, LAND_SLOW, LAND_SLOWLY_BELOW = 1.5, 0.5, 10.0
YAW_GAIN, YAW_RATE = 1.5, 1.0  # rad/s per rad, and the largest rad/s
TURNS_ABOVE = 0.05  # share of the speed limit; above it, the nose turns into the direction of flight (AC_PosControl)


class GuidanceMode(enum.Enum):
    """Submode of GUIDED, landing, or free fall: the kind of the present target."""

    HOLD = enum.auto()  # brake, then hold the position
    TAKEOFF = enum.auto()
    POSITION = enum.auto()
    VELOCITY = enum.auto()
    POSITION_VELOCITY = enum.auto()
    LAND = enum.auto()
    FALL = enum.auto()  # a manual mode without a pilot


FOLLOWING = (GuidanceMode.POSITION, GuidanceMode.VELOCITY, GuidanceMode.POSITION_VELOCITY)


class Guidance:
    """Present target and limits of a copter.

    `speed` is the horizontal limit, `up` and `down` the vertical ones (m/s). `position` is the target; for LAND its
    height is that of home. `yaw` (rad, ENU) is held. With `looks_ahead`, and without a yaw in the setpoint, the vehicle
    turns into the direction of flight."""

    def __init__(self) -> None:
        self.speed = SPEED
        self.default_speed = SPEED
        self.up, self.down = self.default_up, self.default_down = SPEED_UP, SPEED_DOWN
        self.timeout = TIMEOUT
        self.looks_ahead = True
        self.aim = GuidanceMode.HOLD
        self.position: Vector = STILL
        self.velocity: Vector = STILL
        self.push: Vector = STILL  # m/s^2, feed-forward to the velocity
        self.since = 0.0
        self.descends = 0.0  # time when a LAND begins to descend
        self.yaw = 0.0
        self.yaw_rate = 0.0
        self._has_yaw_setpoint = False
        self._begun = False
        self._level, self._height = horizontal(), vertical()

    def go(
        self, aim: GuidanceMode, now: float, position: Vector, velocity: Vector = STILL, push: Vector = STILL
    ) -> None:
        """Set a target, of the present kind or of another."""
        if aim is not self.aim:
            self._begun = False
            if aim is not GuidanceMode.TAKEOFF:  # a change to take-off is the only one that keeps the speeds
                self.reset_speeds()
        self.aim, self.since = aim, now
        self.position, self.velocity, self.push = position, velocity, push
        self.turn(None, 0.0)

    def reset_speeds(self) -> None:
        """Forget the speed limits that commands have set."""
        self.speed, self.up, self.down = self.default_speed, self.default_up, self.default_down

    def land(self, now: float, position: Vector, pause: float) -> None:
        """Descend after `pause` seconds."""
        self.go(GuidanceMode.LAND, now, position)
        self.descends = now + pause

    def turn(self, yaw: float | None, rate: float) -> None:
        """Apply the yaw of the last setpoint: none, an angle, a rate, or both."""
        self._has_yaw_setpoint = yaw is not None or rate != 0.0 or self.aim not in FOLLOWING
        self.yaw_rate = rate
        if yaw is not None:
            self.yaw = yaw

    def stop(self, now: float, position: Vector) -> None:
        """Brake and hold, whatever the present target is (ModeGuided::init)."""
        self._begun = False
        self.go(GuidanceMode.HOLD, now, position)

    def idle(self) -> None:
        """Prepare for a restart of the controllers: the vehicle is on the ground."""
        self._begun = False
        self._level.idle()
        self._height.idle()

    def turning(self, yaw: float, dt: float) -> float:
        """Return the commanded yaw rate for the estimated yaw."""
        self.yaw += self.yaw_rate * dt
        velocity = self._level.path.velocity
        if self.looks_ahead and not self._has_yaw_setpoint and abs(velocity) > TURNS_ABOVE * self.speed:
            self.yaw = cmath.phase(velocity)
        wanted = YAW_GAIN * math.remainder(self.yaw - yaw, math.tau) + self.yaw_rate
        return max(-YAW_RATE, min(YAW_RATE, wanted))

    def acceleration(self, position: Vector, velocity: Vector, now: float, dt: float) -> Vector:
        """Return the commanded acceleration for the estimated position and velocity. `dt` is positive."""
        if self.aim is GuidanceMode.FALL:
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
        """Shape the path towards the target."""
        level, up = self._level.path, self._height.path
        (x, y, z), (vx, vy, vz), (ax, ay, az) = self.position, self.velocity, self.push
        match self.aim:
            case GuidanceMode.POSITION | GuidanceMode.TAKEOFF:
                fast, rising = self._speeds(abs(complex(x, y) - level.position), z - up.position)
                level.seek(complex(x, y), 0j, 0j, fast, dt)
                up.seek(z, 0.0, 0.0, rising, dt)
            case GuidanceMode.POSITION_VELOCITY:
                level.seek(complex(x, y), complex(vx, vy), complex(ax, ay), self.speed, dt)
                up.seek(z, vz, az, self.up if z > up.position else self.down, dt)
                self.position = (x + vx * dt, y + vy * dt, z + vz * dt)
            case GuidanceMode.LAND:
                level.match(0j, 0j, dt)
                fast = LAND_SLOW if height < z + LAND_SLOWLY_BELOW else LAND_FAST
                up.match(-fast if now >= self.descends else 0.0, 0.0, dt)
            case _:
                level.match(complex(vx, vy), complex(ax, ay), dt)
                up.match(vz, az, dt)
        self.velocity = (vx + ax * dt, vy + ay * dt, vz + az * dt)

    def _speeds(self, far: float, up: float) -> tuple[float, float]:
        """Return both speeds of a straight path to the target, within both limits (kinematic_limit)."""
        length = math.hypot(far, up)
        if length <= 0.0:
            return self.speed, self.up
        level, steep = far / length, abs(up) / length
        vertical_limit = self.up if up > 0 else self.down
        along = min(self.speed / max(level, 1e-9), vertical_limit / max(steep, 1e-9))
        return along * level, along * steep
