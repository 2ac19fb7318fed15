"""Robots of fidelity `simple`: velocities follow commands with a first-order lag, in arrays.

A quad stays level and ignores wind. A car is the kinematic bicycle (S. M. LaValle, Planning Algorithms (2006), section
13.1.2.1) with unlimited grip. Contacts, sizes and reference points are those of fidelity `full`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics import car, quadrotor
from targets.sim.physics.rigid import Array, Mask, total, yaws
from targets.sim.physics.world import GRAVITY, STEP, BodyKind, BodyMotion, SimulatedWorld

VELOCITY_LAG = 0.15  # s, of a quad
MAX_ACCELERATION = 8.0  # m/s^2, of a quad
TURNING_LAG = 0.1  # s
_FLOWN = 1.0 - math.exp(-STEP / VELOCITY_LAG)
_TURNED = 1.0 - math.exp(-STEP / TURNING_LAG)
_FEET = np.array([0.0, 0.0, quadrotor.HEIGHT / 2])[:, None]
# Large inertia, so a quad never tips over: it has no attitude loop to right it.
_SOLID = replace(quadrotor.SOLID, inertia=(15.0, 15.0, quadrotor.INERTIA[2]))


class SimpleQuadrotors(BodyKind):
    """All simple quadrotors of a world."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[float, float, float, float]] = []  # commanded velocities (m/s) and yaw rates (rad/s)
        self.running = np.zeros(0, dtype=bool)

    def grow(self) -> None:
        """See BodyKind."""
        self.asked.append((0.0, 0.0, 0.0, 0.0))
        self.running = np.append(self.running, False)

    def push(self, air: Array | None, taken: Mask) -> None:
        """See BodyKind."""
        now = self.motions
        asked = np.array(self.asked).T
        gained = (asked[:3] - now.velocity) * _FLOWN
        size = np.sqrt(total(gained * gained))
        gained *= MAX_ACCELERATION * STEP / np.maximum(size, MAX_ACCELERATION * STEP)
        gained *= self.running
        gained[2] -= (GRAVITY * STEP) * ~self.running
        now.velocity[:] += gained
        now.spin[2] += (_limited(asked[3], quadrotor.MAX_YAW_RATE) - now.spin[2]) * (_TURNED * self.running)

    def place(self) -> tuple[Array, Array, Array]:
        """See BodyKind."""
        return self.motions.position - _FEET, self.motions.velocity, yaws(self.motions.orientation)


class SimpleQuadrotor:
    """One simple quadrotor, commanded by `fly`."""

    def __init__(self, world: SimulatedWorld, start: Vector, yaw: float) -> None:
        centre = (start[0], start[1], start[2] + quadrotor.HEIGHT / 2)
        self._all, self.rigid = world.add(SimpleQuadrotors, _SOLID, centre, yaw)

    def state(self) -> BodyState:
        return self.rigid.state()

    def motion(self) -> BodyMotion:
        """Return the motion of the centre of mass."""
        return self.rigid.motion()

    def fly(self, velocity: Vector, yaw_rate: float) -> None:
        """Command a velocity (m/s, ENU) and a yaw rate (rad/s), which hold until the next command."""
        x, y, z = velocity
        if not math.isfinite(x + y + z + yaw_rate):
            raise ValueError(f"not a velocity and a yaw rate: {velocity}, {yaw_rate}")
        self._all.asked[self.rigid.index] = x, y, z, yaw_rate

    def motors(self, on: bool) -> None:
        """Switch the motors. Without them the quad rests or falls."""
        self._all.running[self.rigid.index] = on


class SimpleCars(car.RollingKind):
    """All simple cars of a world."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = np.zeros((2, 0))  # commanded speeds (m/s) and steering angles (rad)
        self.steering = np.zeros(0)
        self.eager = np.zeros(0)  # 1/s: acceleration per speed error
        self.most = np.zeros(0)  # m/s^2, largest acceleration

    def grow(self) -> None:
        """See BodyKind."""
        self.asked = np.column_stack((self.asked, np.zeros(2)))
        self.ahead, self.steering = np.append(self.ahead, 0.0), np.append(self.steering, 0.0)
        self.eager, self.most = np.append(self.eager, 0.0), np.append(self.most, 0.0)

    def push(self, air: Array | None, taken: Mask) -> None:
        """See BodyKind."""
        now = self.motions
        down = self.carry(taken)
        turning = (self.asked[1] - self.steering) / car.STEERING_LAG
        self.steering += _limited(turning, car.MAX_STEERING_RATE) * STEP
        yaw, half = yaws(now.orientation), STEP / 2
        headed = yaw - now.spin[2] * half  # heading that this velocity was computed for in the last step
        speed = now.velocity[0] * np.cos(headed) + now.velocity[1] * np.sin(headed)
        speed += _limited((self.asked[0] - speed) * self.eager, self.most) * STEP
        rate = speed * np.tan(self.steering) / (2 * self.ahead)
        heading = yaw + rate * half  # at the middle of the step
        cos, sin, across = np.cos(heading), np.sin(heading), self.ahead * rate
        np.copyto(now.velocity[0], speed * cos - across * sin, where=down)
        np.copyto(now.velocity[1], speed * sin + across * cos, where=down)
        np.copyto(now.spin[2], rate, where=down)


class SimpleCarBody:
    """One simple car. Implements `bodies.Car`."""

    def __init__(
        self,
        world: SimulatedWorld,
        start: Vector,
        yaw: float,
        wheelbase: float,
        max_steering: float,
        running: car.CarDynamics = car.USUAL,
    ) -> None:
        ahead = wheelbase / 2
        shape, place = car.solid(wheelbase, stiff=True), car.centre(start, yaw, ahead)
        self._all, self.rigid = world.add(SimpleCars, shape, place, yaw)
        self._all.ahead[self.rigid.index] = ahead
        self._lag = running.speed_lag
        self.wheelbase = wheelbase
        self._max_steering = max_steering
        self._last_command: tuple[float, float] | None = None
        self.drive(0.0, 0.0)

    def state(self) -> BodyState:
        return self.rigid.state()

    def motion(self) -> BodyMotion:
        """Return the motion of the centre of mass."""
        return self.rigid.motion()

    def drive(self, speed: float, steering: float) -> None:
        """See bodies.Car."""
        if self._last_command == (speed, steering):
            return  # devices repeat their command at every step
        if not (math.isfinite(speed) and math.isfinite(steering)):
            raise ValueError(f"not a speed and a steering angle: {speed}, {steering}")
        self._last_command = speed, steering
        every, k = self._all, self.rigid.index
        every.asked[0, k] = max(-car.MAX_SPEED, min(car.MAX_SPEED, speed))
        every.asked[1, k] = max(-self._max_steering, min(self._max_steering, steering))
        every.eager[k], every.most[k] = 1.0 / self._lag, car.MAX_ACCELERATION

    def brake(self, deceleration: float) -> None:
        """See bodies.Car."""
        if deceleration > 0.0:
            self._last_command = None
            every, k = self._all, self.rigid.index
            every.asked[0, k], every.eager[k], every.most[k] = 0.0, 1.0 / STEP, deceleration


def _limited(value: Array, most: Array | float) -> Array:
    found: Array = np.minimum(np.maximum(value, np.negative(most)), most)
    return found
