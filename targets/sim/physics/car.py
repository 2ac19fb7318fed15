"""Simulated cars: a rigid body on four tyres, with a servo that is late and a motor that holds a speed.

Within what its tyres hold it follows the kinematic bicycle (S. M. LaValle, Planning Algorithms (2006), section
13.1.2.1) exactly; beyond that it slides (`impulses`). Its wheels carry it without a contact engine as long as it stands
on them and nothing is near. The reference point is the middle of the rear axle, on the floor.
"""

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
from targets.sim.physics.world import GRAVITY, STEP, Kind, Motion, World

# What four tyres do to a car in one step: two axles, each held to where its wheels roll, by no more than friction.
#
# The wheels of each axle hold the body's velocity there to their own direction, and along it to their own speed. The
# forces of both axles that do so within the step are found by projected Gauss-Seidel, each axle's kept within its
# friction circle (Coulomb: friction times load; the load is half the weight, nothing is shifted by acceleration). So a
# car within its limits follows the kinematic bicycle exactly, one that is too fast for its curve is pushed wide, and
# one that brakes too hard slides. Sequential impulses: E. Catto, Iterative Dynamics with Temporal Coherence (2005).

_ROUNDS = 6  # far more than needed: for a body like this the two axles hardly disturb each other


@dataclass(frozen=True, slots=True)
class Chassis:
    """Mass (kg), inertia about the vertical (kg m^2), distance of each axle from the centre of mass (m), and the most
    impulse (N s) that one axle's tyres give in one step."""

    mass: float
    inertia: float
    reach: float
    most: float


def impulses(
    chassis: Chassis, velocity: tuple[float, float], spin: float, speed: float, steering: float
) -> tuple[float, float, float]:
    """Impulses of one step in the body's frame: forward, to the left (N s), and about the vertical (N m s).
    `velocity` is that of the centre of mass, forward and to the left (m/s), `spin` in rad/s; `speed` is that of the
    rear wheels (m/s), `steering` the front wheels' angle (rad, positive to the left). All wheels are driven."""
    u, w = velocity
    m, inertia, reach = chassis.mass, chassis.inertia, chassis.reach
    cos, sin = math.cos(steering), math.sin(steering)
    # Axle by axle: its lever arm, the direction its wheels roll in, their speed.
    axles = ((-reach, 1.0, 0.0, speed), (reach, cos, sin, speed / cos))
    along, across = [0.0, 0.0], [0.0, 0.0]
    for _ in range(_ROUNDS):
        for k, (arm, dx, dy, rolling) in enumerate(axles):
            old = along[k], across[k]
            # Half the error along is this axle's part, or both would mend it.
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
OVERHANG, WIDTH, HEIGHT = 0.17, 0.28, 0.14  # m; the body is longer than its wheelbase by OVERHANG
MAX_SPEED = 10.0  # m/s
MAX_ACCELERATION = 6.0  # m/s^2, of the wheels by the motor
STEERING_LAG, MAX_STEERING_RATE = 0.05, 4.0  # s, rad/s
UPRIGHT = 0.8  # cosine of the tilt beyond which wheels have left the floor
LIFTED = 0.03  # m
# What a car that stands on the floor may be off: m, square of half the tilt, m/s, rad/s.
_OFF, _TILTED, _RISING, _TIPPING = 0.003, 1e-4, 0.05, 0.1
_SUSPENSION, _HOP = 20.0, 0.3  # 1/s: how fast it comes back; m/s: faster upwards wheels leave the floor


@dataclass(frozen=True, slots=True)
class Running:
    """How a car runs: the friction of its tyres (of the weight), the seconds until its servo begins to follow, and the
    time constant with which its motor's speed loop does."""

    friction: float = 0.9
    steering_delay: float = 0.02
    speed_lag: float = 0.15

    @staticmethod
    def of(harness: Mapping[str, Any]) -> Running:
        """As the sim target's settings say."""
        return Running(
            float(harness.get("tyre_friction", USUAL.friction)),
            float(harness.get("steering_delay", USUAL.steering_delay)),
            float(harness.get("speed_lag", USUAL.speed_lag)),
        )


USUAL = Running()


class RollingKind(Kind):
    """What cars of both fidelities share: where they stand, and where they do not."""

    rolling = True

    def __init__(self) -> None:
        super().__init__()
        self.ahead = np.zeros(0)  # m from the rear axle to the centre of mass

    def steady(self) -> Mask:
        """See Kind."""
        now = self.motions
        x, y = now.orientation[:2]
        level = (np.abs(now.position[2] - HEIGHT / 2) < _OFF) & (x * x + y * y < _TILTED)
        found: Mask = level & (np.abs(now.velocity[2]) < _RISING) & (np.abs(now.spin[:2]).max(0) < _TIPPING)
        return found

    def carry(self, taken: Mask) -> Mask:
        """What the floor does to them by their wheels; which of all have these on the floor. A suspension holds those
        level, without an engine's contacts: on PyBullet's floor a box that slides sinks in and shakes."""
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
        """See Kind."""
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
    """All cars of a world. Their tyres are computed one car after the other: there are few."""

    def __init__(self) -> None:
        super().__init__()
        self.each: list[SimulatedCar] = []

    def grow(self) -> None:
        """See Kind."""
        self.ahead = np.append(self.ahead, 0.0)

    def push(self, air: Array | None, taken: Mask) -> None:
        """See Kind."""
        now = self.motions
        down = self.carry(taken).tolist()
        # The heading in the middle of the step; with that at its beginning, every curve would drift outwards.
        yaw = (yaws(now.orientation) + now.spin[2] * (STEP / 2)).tolist()
        told = zip(self.each, down, yaw, now.velocity[:2].T.tolist(), now.spin[2].tolist(), strict=True)
        for k, (car, stands, heading, velocity, spin) in enumerate(told):
            car.follow()
            if stands:
                now.velocity[0, k], now.velocity[1, k], now.spin[2, k] = car.rolled(heading, velocity, spin)


def solid(wheelbase: float, stiff: bool = False) -> Solid:
    """A car's body. It has no friction: the tyres' forces are computed here. A `stiff` one never tips over."""
    x, y, z = size = (wheelbase + OVERHANG, WIDTH, HEIGHT)
    tipping = 1000.0 if stiff else 1.0
    about = [MASS / 12 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y))]
    return Solid(size, MASS, (about[0] * tipping, about[1] * tipping, about[2]))


def centre(start: Vector, yaw: float, ahead: float) -> Vector:
    """Where the centre of mass is when the reference point is at `start`."""
    return start[0] + ahead * math.cos(yaw), start[1] + ahead * math.sin(yaw), start[2] + HEIGHT / 2


class SimulatedCar:
    """One of them: implements `bodies.Car`."""

    def __init__(
        self,
        world: World,
        start: Vector,
        yaw: float,
        wheelbase: float,
        max_steering: float,
        running: Running = USUAL,
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
        self._braking = 0.0  # m/s^2 of the wheels; 0: the motor holds the speed that was asked for
        self._turns = deque([0.0] * (1 + round(running.steering_delay / STEP)))  # asked for, the oldest first
        self._angle = 0.0  # asked for last
        self._speed = 0.0  # of the wheels
        self._steering = 0.0

    def state(self) -> BodyState:
        return self.rigid.state()

    def motion(self) -> Motion:
        """Of its centre of mass."""
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
        """One step of motor and servo."""
        if self._braking > 0.0:
            slower = min(abs(self._speed), self._braking * STEP)
            self._speed -= math.copysign(slower, self._speed)
        else:
            self._speed = _follow(self._speed, self._asked, self._running.speed_lag, MAX_ACCELERATION)
        self._turns.append(self._angle)
        self._steering = _follow(self._steering, self._turns.popleft(), STEERING_LAG, MAX_STEERING_RATE)

    def rolled(self, yaw: float, velocity: list[float], spin: float) -> tuple[float, float, float]:
        """Horizontal velocity (world's frame) and spin after what the tyres do in one step."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        vx, vy = velocity
        inwards = (vx * cos + vy * sin, vy * cos - vx * sin)
        forward, left, turn = impulses(self._chassis, inwards, spin, self._speed, self._steering)
        chassis = self._chassis
        gained = ((forward * cos - left * sin) / chassis.mass, (forward * sin + left * cos) / chassis.mass)
        return vx + gained[0], vy + gained[1], spin + turn / chassis.inertia


def _follow(value: float, asked: float, lag: float, most: float) -> float:
    """First-order lag with a limit on the rate, one step on."""
    rate = (asked - value) / lag
    return value + max(-most, min(most, rate)) * STEP
