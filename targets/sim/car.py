"""The simulated car: one rigid body on four tyres, with a servo that is late and a motor that holds a speed.

Within what its tyres hold it follows the kinematic bicycle (S. M. LaValle, Planning Algorithms (2006), section
13.1.2.1) exactly; beyond that it slides (tyres.py). The reference point is the middle of the rear axle, on the floor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from targets.sim.bodies import BodyState, Vector
from targets.sim.tyres import Chassis, impulses
from targets.sim.world import GRAVITY, STEP, Rigid, World

MASS = 3.5  # kg
OVERHANG, WIDTH, HEIGHT = 0.17, 0.28, 0.14  # m; the body is longer than its wheelbase by OVERHANG
MAX_SPEED = 10.0  # m/s
MAX_ACCELERATION = 6.0  # m/s^2, of the wheels by the motor
STEERING_LAG, MAX_STEERING_RATE = 0.05, 4.0  # s, rad/s
UPRIGHT = 0.8  # cosine of the tilt beyond which wheels have left the floor
LIFTED = 0.03  # m


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


class SimulatedCar:
    """Implements `bodies.Car`. `step` once before each step of the world."""

    def __init__(
        self,
        world: World,
        start: Vector,
        yaw: float,
        wheelbase: float,
        max_steering: float,
        running: Running = USUAL,
    ) -> None:
        length = wheelbase + OVERHANG
        ahead = wheelbase / 2
        centre = (start[0] + ahead * math.cos(yaw), start[1] + ahead * math.sin(yaw), start[2] + HEIGHT / 2)
        inertia = tuple(MASS / 12 * (a * a + b * b) for a, b in ((WIDTH, HEIGHT), (length, HEIGHT), (length, WIDTH)))
        # No friction of the box itself: the tyres' forces are computed here.
        size = (length, WIDTH, HEIGHT)
        self.rigid: Rigid = world.box(size, MASS, centre, yaw, 0.0, (inertia[0], inertia[1], inertia[2]))
        most = running.friction * MASS * GRAVITY / 2 * STEP
        self._chassis = Chassis(MASS, inertia[2], wheelbase / 2, most)
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
        motion = self.rigid.motion()
        yaw = math.atan2(motion.forward[1], motion.forward[0])
        ahead = self.wheelbase / 2
        cos, sin, rate = math.cos(yaw), math.sin(yaw), motion.spin[2]
        x, y, z = motion.position
        vx, vy, vz = motion.velocity
        return BodyState(
            (x - ahead * cos, y - ahead * sin, z - HEIGHT / 2),
            (vx + ahead * rate * sin, vy - ahead * rate * cos, vz),
            yaw,
            rate,
        )

    def drive(self, speed: float, steering: float) -> None:
        """See bodies.Car."""
        if not (math.isfinite(speed) and math.isfinite(steering)):
            raise ValueError(f"not a speed and a steering angle: {speed}, {steering}")
        self._asked, self._braking = max(-MAX_SPEED, min(MAX_SPEED, speed)), 0.0
        self._angle = max(-self._max_steering, min(self._max_steering, steering))

    def brake(self, deceleration: float) -> None:
        """See bodies.Car."""
        self._braking = max(0.0, deceleration)

    def step(self) -> None:
        """Let motor and servo follow, and push the body by its tyres."""
        if self._braking > 0.0:
            slower = min(abs(self._speed), self._braking * STEP)
            self._speed -= math.copysign(slower, self._speed)
        else:
            self._speed = _follow(self._speed, self._asked, self._running.speed_lag, MAX_ACCELERATION)
        self._turns.append(self._angle)
        self._steering = _follow(self._steering, self._turns.popleft(), STEERING_LAG, MAX_STEERING_RATE)
        motion = self.rigid.motion()
        if motion.up[2] < UPRIGHT or motion.position[2] > HEIGHT / 2 + LIFTED:
            return
        # The heading in the middle of the step; with that at its beginning, every curve would drift outwards.
        yaw = math.atan2(motion.forward[1], motion.forward[0]) + motion.spin[2] * STEP / 2
        cos, sin = math.cos(yaw), math.sin(yaw)
        vx, vy, _ = motion.velocity
        velocity = (vx * cos + vy * sin, vy * cos - vx * sin)
        forward, left, turn = impulses(self._chassis, velocity, motion.spin[2], self._speed, self._steering)
        force = ((forward * cos - left * sin) / STEP, (forward * sin + left * cos) / STEP, 0.0)
        self.rigid.push(force, (0.0, 0.0, turn / STEP), motion.position)


def _follow(value: float, asked: float, lag: float, most: float) -> float:
    """First-order lag with a limit on the rate, one step on."""
    rate = (asked - value) / lag
    return value + max(-most, min(most, rate)) * STEP
