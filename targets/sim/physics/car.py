"""Simulated cars.

A rigid body on four tyres, a steering servo with delay, and a motor with speed control.

Within the grip of its tyres, a car follows the kinematic bicycle (S. M. LaValle, Planning Algorithms (2006), section
13.1.2.1) exactly; beyond it, it slides (`impulses`). While it stands on its wheels with nothing near, no contact engine
is needed. The reference point is the middle of the rear axle, on the floor."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics.contacts import Solid
from targets.sim.physics.rigid import Array, Mask, yaws
from targets.sim.physics.world import GRAVITY, STEP, BodyKind, BodyMotion, SimulatedWorld

# Tyre model: impulses of two axles in one step, limited by friction.
#
# The wheels of each axle hold the body's velocity there to their own direction, and along it to their own speed. The
# forces of both axles that do so within the step are found by projected Gauss-Seidel, each axle's kept within its
# friction circle (Coulomb: friction times load; the load is half the weight, acceleration does not shift it). So a car
# within its limits follows the kinematic bicycle exactly, one that is too fast for its curve is pushed wide, and one
# that brakes too hard slides. Sequential impulses: E. Catto, Iterative Dynamics with Temporal Coherence (2005).

_ROUNDS = 6  # more than enough: for a body like this the two axles hardly disturb each other


@dataclass(frozen=True, slots=True)
class Chassis:
    """Constants of a car's tyre model.

    Mass (kg), inertia about the vertical (kg m^2), distance of each axle from the centre of mass (m), largest impulse
    (N s) of one axle's tyres in one step."""

    mass: float
    inertia: float
    reach: float
    most: float


def impulses(
    chassis: Chassis, velocity: tuple[float, float], spin: float, speed: float, steering: float
) -> tuple[float, float, float]:
    """Return the tyres' impulses of one step in the body frame.

    Forward and left in N s, about the vertical in N m s.

    `velocity` of the centre of mass, forward and left (m/s); `spin` in rad/s; `speed` of the rear wheels (m/s);
    `steering` of the front wheels (rad, positive to the left). All wheels are driven."""
    u, w = velocity
    m, inertia, reach = chassis.mass, chassis.inertia, chassis.reach
    cos, sin = math.cos(steering), math.sin(steering)
    # For each axle: lever arm, rolling direction, wheel speed.
    axles = ((-reach, 1.0, 0.0, speed), (reach, cos, sin, speed / cos))
    along, across = [0.0, 0.0], [0.0, 0.0]
    for _ in range(_ROUNDS):
        for k, (arm, dx, dy, rolling) in enumerate(axles):
            old = along[k], across[k]
            # Each axle takes half of the longitudinal error, or both would correct it twice.
            slip = rolling - (u * dx + (w + spin * arm) * dy)
            along[k] += 0.5 * slip / (1.0 / m + (arm * dy) ** 2 / inertia)
            slide = u * -dy + (w + spin * arm) * dx
            across[k] -= slide / (1.0 / m + (arm * dx) ** 2 / inertia)
            share = min(1.0, chassis.most / max(math.hypot(along[k], across[k]), 1e-12))
            along[k], across[k] = along[k] * share, across[k] * share
            fore, side = along[k] - old[0], across[k] - old[1]
            x, y = fore * dx - side * dy, fore * dy + side * dx
            u, w, spin = u + x / m, w + y / m, spin + arm * y / inertia
    forward = sum(p * dx - q * dy for p, q, (_, dx, dy, _) in zip(along, across, axles, strict=True))
    left = [p * dy + q * dx for p, q, (_, dx, dy, _) in zip(along, across, axles, strict=True)]
    return forward, left[0] + left[1], reach * (left[1] - left[0])


MASS = 3.5  # kg
OVERHANG, WIDTH, HEIGHT = 0.17, 0.28, 0.14  # m; a body is longer than its wheelbase by OVERHANG
MAX_SPEED = 10.0  # m/s
MAX_ACCELERATION = 6.0  # m/s^2, of the wheels, by the motor
STEERING_LAG, MAX_STEERING_RATE = 0.05, 4.0  # s, rad/s
UPRIGHT = 0.8  # cosine of the tilt beyond which the wheels have left the floor
LIFTED = 0.03  # m
# Tolerances for a car that stands on the floor: m, square of half the tilt, m/s, rad/s.
_OFF, _TILTED, _RISING, _TIPPING = 0.003, 1e-4, 0.05, 0.1
_SUSPENSION, _HOP = 20.0, 0.3  # suspension's rate (1/s); climb speed above which the wheels leave the floor (m/s)


@dataclass(frozen=True, slots=True)
class CarDynamics:
    """Dynamics of a car.

    Tyre friction (of the weight), servo delay (s), time constant of the speed loop (s)."""

    friction: float = 0.9
    steering_delay: float = 0.02
    speed_lag: float = 0.15

    @staticmethod
    def of(harness: Mapping[str, Any]) -> CarDynamics:
        """Read the settings of the sim target."""
        return CarDynamics(
            float(harness.get("tyre_friction", USUAL.friction)),
            float(harness.get("steering_delay", USUAL.steering_delay)),
            float(harness.get("speed_lag", USUAL.speed_lag)),
        )


USUAL = CarDynamics()


class RollingKind(BodyKind):
    """Kind of body on wheels: contact with the floor for cars of both fidelities."""

    rolling = True

    def __init__(self) -> None:
        super().__init__()
        self.ahead = np.zeros(0)  # m, from the rear axle to the centre of mass

    def steady(self) -> Mask:
        """See BodyKind."""
        now = self.motions
        x, y = now.orientation[:2]
        level = (np.abs(now.position[2] - HEIGHT / 2) < _OFF) & (x * x + y * y < _TILTED)
        found: Mask = level & (np.abs(now.velocity[2]) < _RISING) & (np.abs(now.spin[:2]).max(0) < _TIPPING)
        return found

    def carry(self, taken: Mask) -> Mask:
        """Apply the floor's force on the wheels. Return which cars have their wheels on the floor.

        A suspension holds those cars level without an engine's contacts: on PyBullet's floor a sliding box sinks in and
        shakes. `taken`: cars under the contact engine's control."""
        now = self.motions
        if not taken.any():
            now.velocity[2] = now.spin[0] = now.spin[1] = 0.0
            return ~taken
        x, y, z, w = now.orientation
        down: Mask = (1 - 2 * (x * x + y * y) > UPRIGHT) & (now.position[2] < HEIGHT / 2 + LIFTED)
        held = down & (now.velocity[2] < _HOP)
        rising = (HEIGHT / 2 - now.position[2]) * _SUSPENSION
        now.velocity[2] = np.where(held, rising, now.velocity[2] - GRAVITY * STEP)
        now.spin[0] = np.where(held, (y * z - x * w) * (2 * _SUSPENSION), now.spin[0])
        now.spin[1] = np.where(held, (x * z + y * w) * (-2 * _SUSPENSION), now.spin[1])
        return down

    def place(self) -> tuple[Array, Array, Array]:
        """See BodyKind."""
        now, yaw = self.motions, yaws(self.motions.orientation)
        ahead = np.empty((2, self.count))
        np.cos(yaw, out=ahead[0])
        np.sin(yaw, out=ahead[1])
        ahead *= self.ahead
        position, velocity = now.position.copy(), now.velocity.copy()
        position[:2] -= ahead
        position[2] -= HEIGHT / 2
        velocity[0] += now.spin[2] * ahead[1]
        velocity[1] -= now.spin[2] * ahead[0]
        return position, velocity, yaw


class Cars(RollingKind):
    """All cars of a world. Tyres are computed car by car, for there are few cars."""

    def __init__(self) -> None:
        super().__init__()
        self.each: list[SimulatedCar] = []

    def grow(self) -> None:
        """See BodyKind."""
        self.ahead = np.append(self.ahead, 0.0)

    def push(self, air: Array | None, taken: Mask) -> None:
        """See BodyKind."""
        now = self.motions
        down = self.carry(taken).tolist()
        # Heading in the middle of the step. The heading at its beginning would let every curve drift outwards.
        yaw = (yaws(now.orientation) + now.spin[2] * (STEP / 2)).tolist()
        told = zip(self.each, down, yaw, now.velocity[:2].T.tolist(), now.spin[2].tolist(), strict=True)
        for k, (car, stands, heading, velocity, spin) in enumerate(told):
            car.follow()
            if stands:
                now.velocity[0, k], now.velocity[1, k], now.spin[2, k] = car.rolled(heading, velocity, spin)


def solid(wheelbase: float, stiff: bool = False) -> Solid:
    """Return a car's body. Its friction is 0, for the tyre model computes it.

    A `stiff` body never tips over."""
    x, y, z = size = (wheelbase + OVERHANG, WIDTH, HEIGHT)
    tipping = 1000.0 if stiff else 1.0
    about = [MASS / 12 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y))]
    return Solid(size, MASS, (about[0] * tipping, about[1] * tipping, about[2]))


def centre(start: Vector, yaw: float, ahead: float) -> Vector:
    """Return the centre of mass when the reference point is at `start`."""
    return start[0] + ahead * math.cos(yaw), start[1] + ahead * math.sin(yaw), start[2] + HEIGHT / 2


class SimulatedCar:
    """One car of `Cars`. Implements `bodies.Car`."""

    def __init__(
        self,
        world: SimulatedWorld,
        start: Vector,
        yaw: float,
        wheelbase: float,
        max_steering: float,
        running: CarDynamics = USUAL,
    ) -> None:
        ahead, shape = wheelbase / 2, solid(wheelbase)
        every, self.rigid = world.add(Cars, shape, centre(start, yaw, ahead), yaw)
        every.ahead[self.rigid.index] = ahead
        every.each.append(self)
        most = world.friction * running.friction * MASS * GRAVITY / 2 * STEP
        self._chassis = Chassis(MASS, shape.inertia[2], ahead, most)
        self._running = running
        self.wheelbase = wheelbase
        self._max_steering = max_steering
        self._asked = 0.0
        self._braking = 0.0  # m/s^2 of the wheels; 0: the motor holds the commanded speed
        # delayed steering commands, the oldest first
        self._turns = deque([0.0] * (1 + round(running.steering_delay / STEP)))
        self._angle = 0.0  # last steering command
        self._speed = 0.0  # of the wheels
        self._steering = 0.0

    def state(self) -> BodyState:
        return self.rigid.state()

    def motion(self) -> BodyMotion:
        """Return the motion of the centre of mass."""
        return self.rigid.motion()

    def drive(self, speed: float, steering: float) -> None:
        """See bodies.Car."""
        if not (math.isfinite(speed) and math.isfinite(steering)):
            raise ValueError(f"not a speed and a steering angle: {speed}, {steering}")
        self._asked, self._braking = max(-MAX_SPEED, min(MAX_SPEED, speed)), 0.0
        self._angle = max(-self._max_steering, min(self._max_steering, steering))

    def brake(self, deceleration: float) -> None:
        """See bodies.Car."""
        self._braking = max(0.0, deceleration)

    def follow(self) -> None:
        """Step the motor and the servo."""
        if self._braking > 0.0:
            slower = min(abs(self._speed), self._braking * STEP)
            self._speed -= math.copysign(slower, self._speed)
        else:
            self._speed = _step_lag(self._speed, self._asked, self._running.speed_lag, MAX_ACCELERATION)
        self._turns.append(self._angle)
        self._steering = _step_lag(self._steering, self._turns.popleft(), STEERING_LAG, MAX_STEERING_RATE)

    def rolled(self, yaw: float, velocity: list[float], spin: float) -> tuple[float, float, float]:
        """Return horizontal velocity (world frame) and spin after the tyres' impulses of one step."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        vx, vy = velocity
        inwards = (vx * cos + vy * sin, vy * cos - vx * sin)
        forward, left, turn = impulses(self._chassis, inwards, spin, self._speed, self._steering)
        chassis = self._chassis
        gained = ((forward * cos - left * sin) / chassis.mass, (forward * sin + left * cos) / chassis.mass)
        return vx + gained[0], vy + gained[1], spin + turn / chassis.inertia


def _step_lag(value: float, asked: float, lag: float, most: float) -> float:
    """Step a first-order lag with a limited rate."""
    rate = (asked - value) / lag
    return value + max(-most, min(most, rate)) * STEP
