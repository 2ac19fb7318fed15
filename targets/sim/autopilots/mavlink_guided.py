"""How a simulated autopilot flies: what it was told to do, for how long that holds, and the path that comes of it.

As ArduCopter/mode_guided.cpp of Copter 4.7: each kind of setpoint is a submode of its own, and a change of submode
starts the position controller anew from where the vehicle is, with the default speed. In local ENU about the fleet's
origin, metres and seconds; the speeds are ArduPilot's defaults (WP_SPD_UP, WP_SPD_DN, LAND_SPEED, LAND_ALT_LOW).
"""

from __future__ import annotations

import cmath
import enum
import math

from targets.sim.autopilots.mavlink_position import horizontal, vertical

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
