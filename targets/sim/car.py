"""The simulated car: one rigid body that tyre forces keep on the kinematic bicycle's course.

The forces are those that give the bicycle's velocity in one step, within what tyres can hold: free driving follows
the bicycle exactly, and a car that meets another body pushes no harder than its tyres let it. Formulas: S. M. LaValle,
Planning Algorithms (2006), section 13.1.2.1. The reference point is the middle of the rear axle, on the floor.
"""

from __future__ import annotations

import math

from targets.sim.bodies import BodyState, Vector
from targets.sim.world import GRAVITY, STEP, Rigid, World

MASS = 3.5  # kg
OVERHANG, WIDTH, HEIGHT = 0.17, 0.28, 0.14  # m; the body is longer than its wheelbase by OVERHANG
GRIP = 0.9  # of the weight: the most that tyres hold
MAX_SPEED = 5.0  # m/s
SPEED_LAG, MAX_ACCELERATION = 0.15, 6.0  # s, m/s^2
STEERING_LAG, MAX_STEERING_RATE = 0.05, 4.0  # s, rad/s
UPRIGHT = 0.8  # cosine of the tilt beyond which wheels have left the floor
LIFTED = 0.03  # m


class SimulatedCar:
    """Implements `bodies.Car`. `step` once before each step of the world."""

    def __init__(self, world: World, start: Vector, yaw: float, wheelbase: float, max_steering: float) -> None:
        length = wheelbase + OVERHANG
        ahead = wheelbase / 2
        centre = (start[0] + ahead * math.cos(yaw), start[1] + ahead * math.sin(yaw), start[2] + HEIGHT / 2)
        inertia = tuple(MASS / 12 * (a * a + b * b) for a, b in ((WIDTH, HEIGHT), (length, HEIGHT), (length, WIDTH)))
        # No friction of the box itself: the tyres' forces are computed here.
        size = (length, WIDTH, HEIGHT)
        self.rigid: Rigid = world.box(size, MASS, centre, yaw, 0.0, (inertia[0], inertia[1], inertia[2]))
        self._turning_inertia = inertia[2]
        self.wheelbase = wheelbase
        self._max_steering = max_steering
        self._asked = (0.0, 0.0)
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
        if not (math.isfinite(speed) and math.isfinite(steering)):
            raise ValueError(f"not a speed and a steering angle: {speed}, {steering}")
        self._asked = (
            max(-MAX_SPEED, min(MAX_SPEED, speed)),
            max(-self._max_steering, min(self._max_steering, steering)),
        )

    def step(self) -> None:
        """Let motor and servo follow, and push the body by its tyres."""
        self._speed = _follow(self._speed, self._asked[0], SPEED_LAG, MAX_ACCELERATION)
        self._steering = _follow(self._steering, self._asked[1], STEERING_LAG, MAX_STEERING_RATE)
        motion = self.rigid.motion()
        if motion.up[2] < UPRIGHT or motion.position[2] > HEIGHT / 2 + LIFTED:
            return
        rate = self._speed * math.tan(self._steering) / self.wheelbase
        # The heading in the middle of the step; with that at its beginning, every curve would drift outwards.
        yaw = math.atan2(motion.forward[1], motion.forward[0]) + rate * STEP / 2
        cos, sin, sideways = math.cos(yaw), math.sin(yaw), rate * self.wheelbase / 2
        vx, vy, _ = motion.velocity
        fx = MASS * (self._speed * cos - sideways * sin - vx) / STEP
        fy = MASS * (self._speed * sin + sideways * cos - vy) / STEP
        grip = GRIP * MASS * GRAVITY
        share = min(1.0, grip / max(math.hypot(fx, fy), 1e-9))
        turn = self._turning_inertia * (rate - motion.spin[2]) / STEP
        most = grip * self.wheelbase / 2
        self.rigid.push((fx * share, fy * share, 0.0), (0.0, 0.0, max(-most, min(most, turn))), motion.position)


def _follow(value: float, asked: float, lag: float, most: float) -> float:
    """First-order lag with a limit on the rate, one step on."""
    rate = (asked - value) / lag
    return value + max(-most, min(most, rate)) * STEP
