"""The simulated quadrotor: one rigid body moved by one wrench, with an attitude loop of its own.

Thrust acts along the body's axis, so it accelerates sideways only by tilting, and that takes time. The reference
point is the middle between its feet: z = 0 is standing on the floor.
"""

from __future__ import annotations

import math

from targets.sim.bodies import BodyState, Vector
from targets.sim.world import GRAVITY, STEP, Rigid, World

MASS = 1.4  # kg
RADIUS, HEIGHT = 0.18, 0.12  # m, of a cylinder with the propellers in it
INERTIA = 0.015  # kg m^2, about every axis
MAX_TILT = 0.6  # rad, asked for
MAX_CLIMB, MAX_SINK = 0.8 * GRAVITY, 0.6 * GRAVITY  # m/s^2, vertical acceleration asked for
MAX_THRUST = 2.2 * MASS * GRAVITY  # N
MAX_YAW_RATE = 2.0  # rad/s
TILT_GAIN = 10.0  # rad/s of tilting per rad of error: the attitude lag's inverse
RATE_GAIN = 40.0  # 1/s
MAX_SPIN_UP = 150.0  # rad/s^2
THRUST_LAG = 0.04  # s
# 1/s: deceleration by air per speed. That of the rotors' stream: 0.2 sqrt(thrust x air's density x disc area) / mass
# of the quadrotor that ArduPilot's own simulation flies (libraries/SITL/SIM_Frame: 3 kg, 0.385 m^2).
DRAG = 0.25


class SimulatedQuadrotor:
    """Implements `bodies.Quadrotor`. `step` once before each step of the world."""

    def __init__(self, world: World, start: Vector, yaw: float) -> None:
        centre = (start[0], start[1], start[2] + HEIGHT / 2)
        inertia = (INERTIA, INERTIA, INERTIA)
        self.rigid: Rigid = world.cylinder(RADIUS, HEIGHT, MASS, centre, yaw, 0.8, inertia)
        self._asked: Vector = (0.0, 0.0, 0.0)
        self._asked_rate = 0.0
        self._running = False
        self._thrust = 0.0

    def state(self) -> BodyState:
        motion = self.rigid.motion()
        x, y, z = motion.position
        forward = motion.forward
        yaw = math.atan2(forward[1], forward[0])
        return BodyState((x, y, z - HEIGHT / 2), motion.velocity, yaw, motion.spin[2])

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        if not all(map(math.isfinite, (*acceleration, yaw_rate))):
            raise ValueError(f"not an acceleration and a yaw rate: {acceleration}, {yaw_rate}")
        self._asked = acceleration
        self._asked_rate = _limited(yaw_rate, MAX_YAW_RATE)

    def motors(self, on: bool) -> None:
        self._running = on

    def step(self) -> None:
        """Push the body: thrust, attitude torque and drag."""
        motion = self.rigid.motion()
        vx, vy, vz = motion.velocity
        force = (-DRAG * MASS * vx, -DRAG * MASS * vy, -DRAG * MASS * vz)
        torque: Vector = (0.0, 0.0, 0.0)
        if self._running:
            up = motion.up
            lift = self._lift()
            size = math.hypot(*lift)
            wanted = min(MAX_THRUST, max(0.0, MASS * _dot(lift, up)))
            self._thrust += (wanted - self._thrust) * STEP / THRUST_LAG
            force = _sum(force, up, self._thrust)
            torque = self._turn(up, (lift[0] / size, lift[1] / size, lift[2] / size), motion.spin)
        else:
            self._thrust = 0.0
        self.rigid.push(force, torque, motion.position)

    def _lift(self) -> Vector:
        """The acceleration that thrust must give: what was asked for and gravity, within the limits of tilt and
        climb. Its vertical part is positive, so it has a direction."""
        ax, ay, az = self._asked
        lift = GRAVITY + max(-MAX_SINK, min(MAX_CLIMB, az))
        sideways = math.hypot(ax, ay)
        most = lift * math.tan(MAX_TILT)
        share = most / sideways if sideways > most else 1.0
        return (ax * share, ay * share, lift)

    def _turn(self, up: Vector, wanted: Vector, spin: Vector) -> Vector:
        """The torque that turns the thrust's axis towards `wanted`: a rate proportional to the error, held by a
        faster loop."""
        axis = _cross(up, wanted)
        yawing = self._asked_rate
        rate = _sum((TILT_GAIN * axis[0], TILT_GAIN * axis[1], TILT_GAIN * axis[2]), up, yawing)
        error = [r - s for r, s in zip(rate, spin, strict=True)]
        most = INERTIA * MAX_SPIN_UP
        x, y, z = (_limited(INERTIA * RATE_GAIN * e, most) for e in error)
        return (x, y, z)


def _limited(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _sum(a: Vector, b: Vector, share: float) -> Vector:
    """a + share * b."""
    return (a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2])
