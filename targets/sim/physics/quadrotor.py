"""Simulated quadrotors: four motors on a rigid body, with an attitude loop of their own.

A motor's thrust grows with the square of its speed, which follows its command with a lag. The four thrusts, their
torques and the drag of the propellers move the body. So it accelerates sideways only by tilting, which takes time.
Model: R. Mahony, V. Kumar, P. Corke, Multirotor Aerial Vehicles, IEEE Robotics & Automation Magazine 19(3), 2012. The
reference point is the middle between the feet: at z = 0 the body stands on the floor."""

from __future__ import annotations

import math

import numpy as np

from targets.sim.base.bodies import BodyState, Vector
from targets.sim.physics.contacts import Solid
from targets.sim.physics.rigid import Array, Mask, rotations, total, yaws
from targets.sim.physics.world import GRAVITY, STEP, BodyKind, BodyMotion, SimulatedWorld

MASS = 1.4  # kg
RADIUS, HEIGHT = 0.18, 0.12  # m, of a cylinder with the propellers in it
INERTIA = (0.015, 0.015, 0.025)  # kg m^2, about the body's axes
LEVER = 0.1  # m from each motor to the body's x axis, and to its y axis
DRAG_TORQUE = 0.016  # m: a propeller's torque divided by its thrust
MAX_TILT = 0.6  # rad, largest commanded tilt
MAX_CLIMB, MAX_SINK = 0.8 * GRAVITY, 0.6 * GRAVITY  # m/s^2, largest commanded vertical acceleration
MAX_THRUST = 2.2 * MASS * GRAVITY  # N, of all four motors
MAX_YAW_RATE = 2.0  # rad/s
TILT_GAIN = 10.0  # rad/s of tilting per rad of error: the inverse of the attitude's time constant
RATE_GAIN, YAW_RATE_GAIN = 20.0, 5.0  # 1/s
MAX_TORQUE = (1.0, 1.0, 0.1)  # N m, largest commanded torques
MOTOR_LAG = 0.02  # s
# 1/s: deceleration by air per speed, due to the rotors' stream: 0.2 sqrt(thrust x air density x disc area) / mass of
# the quadrotor in ArduPilot's own simulation (libraries/SITL/SIM_Frame: 3 kg, 0.385 m^2).
DRAG = 0.25

SOLID = Solid((2 * RADIUS, 2 * RADIUS, HEIGHT), MASS, INERTIA, friction=0.8, round=True)
# Mixer: thrust and torques about the body axes (forward, left, up) of unit thrusts of the motors front left, rear left,
# rear right, front right. The first motor turns clockwise, its neighbours counter-clockwise.
_MIX = np.array(
    [
        [1.0, 1.0, 1.0, 1.0],
        [LEVER, LEVER, -LEVER, -LEVER],
        [-LEVER, LEVER, LEVER, -LEVER],
        [DRAG_TORQUE, -DRAG_TORQUE, DRAG_TORQUE, -DRAG_TORQUE],
    ]
)
_PER_STEP = np.array([STEP / MASS, *(STEP / i for i in INERTIA)])[:, None]
_GIVEN = _MIX * (MAX_THRUST / 4) * _PER_STEP  # velocity and spin that motors at full speed add in one step
_WANTED = np.linalg.inv(_MIX * (MAX_THRUST / 4))
_FOLLOWED = 1.0 - math.exp(-STEP / MOTOR_LAG)
_GAINS = (np.array(INERTIA) * (RATE_GAIN, RATE_GAIN, YAW_RATE_GAIN))[:, None]
_GYROSCOPIC = STEP * np.array([(INERTIA[1] - INERTIA[2]) / INERTIA[0], (INERTIA[2] - INERTIA[0]) / INERTIA[1]])[:, None]
_LEAST = np.array([0.0, *(-t for t in MAX_TORQUE)])[:, None]
_MOST = np.array([MAX_THRUST, *MAX_TORQUE])[:, None]
# Limits of the commands.
_LOWEST = np.array([-math.inf, -math.inf, -MAX_SINK, -MAX_YAW_RATE])[:, None]
_HIGHEST = np.array([math.inf, math.inf, MAX_CLIMB, MAX_YAW_RATE])[:, None]
_FEET = np.array([0.0, 0.0, HEIGHT / 2])[:, None]


class Quadrotors(BodyKind):
    """All quadrotors of a world."""

    def __init__(self) -> None:
        super().__init__()
        # Commands in m/s^2 and rad/s. A list: writing single numbers into an array costs more than building it at each
        # step.
        self.asked: list[tuple[float, float, float, float]] = []
        self.running = np.zeros(0)  # 1 if its motors run
        self.motors = np.zeros((4, 0))  # motor speeds, as shares of the highest
        self.direct: dict[int, tuple[float, float, float, float]] = {}  # thrusts that bypass the attitude loop

    def grow(self) -> None:
        """See BodyKind."""
        self.asked.append((0.0, 0.0, 0.0, 0.0))
        self.running = np.append(self.running, 0.0)
        self.motors = np.column_stack((self.motors, np.zeros(4)))

    def push(self, air: Array | None, taken: Mask) -> None:
        """See BodyKind."""
        now = self.motions
        turned = rotations(now.orientation)
        spin = total(turned * now.spin[:, None])  # in the body's frame
        speeds = np.sqrt(self._thrusts(turned, spin))
        speeds *= self.running
        speeds -= self.motors
        speeds *= _FOLLOWED
        self.motors += speeds
        given = _GIVEN @ (self.motors * self.motors)
        gained = given[1:]
        gained[:2] += _GYROSCOPIC * spin[1::-1] * (spin[2] * ~taken)  # contact engines add this term themselves
        fallen, spun = now.velocity, now.spin
        spun += total(turned * gained, 1)
        fallen -= (fallen if air is None else fallen - air) * (DRAG * STEP)
        fallen += turned[:, 2] * given[0]
        fallen[2] -= GRAVITY * STEP

    def _thrusts(self, turned: Array, spin: Array) -> Array:
        """Return the thrusts that the attitude loop commands, as shares of each motor's maximum.

        Cascaded control: the tilt rate is proportional to the tilt error, and a faster loop controls the rate."""
        asked = np.minimum(np.maximum(np.array(self.asked).T, _LOWEST), _HIGHEST)
        lift = _lift(asked[:3])
        along = total(turned * lift[:, None])  # in the body's frame
        wanted = np.empty_like(self.motors)
        per_size = TILT_GAIN / np.sqrt(total(lift * lift))
        np.multiply(along[1], -per_size, out=wanted[1])
        np.multiply(along[0], per_size, out=wanted[2])
        wanted[3] = asked[3]
        np.multiply(along[2], MASS, out=wanted[0])
        torques = wanted[1:]
        torques -= spin
        torques *= _GAINS
        np.minimum(np.maximum(wanted, _LEAST, out=wanted), _MOST, out=wanted)
        found: Array = _WANTED[:, 1:] @ torques
        # Attitude has priority: reduce the common thrust as long as that keeps motors from saturation.
        common = wanted[0] * _WANTED[0, 0]
        np.minimum(common, 1.0 - np.maximum.reduce(found), out=common)
        np.maximum(common, -np.minimum.reduce(found), out=common)
        found += common
        for index, thrusts in self.direct.items():
            found[:, index] = thrusts
        np.minimum(np.maximum(found, 0.0, out=found), 1.0, out=found)
        return found

    def place(self) -> tuple[Array, Array, Array]:
        """See BodyKind."""
        return self.motions.position - _FEET, self.motions.velocity, yaws(self.motions.orientation)


def _lift(asked: Array) -> Array:
    """Return the acceleration that thrust must give.

    The commanded one plus gravity, within the tilt limit.

    Its vertical part is positive, so it has a direction."""
    asked[2] += GRAVITY
    most = asked[2] * math.tan(MAX_TILT)
    most /= np.maximum(np.hypot(asked[0], asked[1]), most)
    asked[:2] *= most
    return asked


class SimulatedQuadrotor:
    """One quadrotor of `Quadrotors`. Implements `bodies.Quadrotor`."""

    def __init__(self, world: SimulatedWorld, start: Vector, yaw: float) -> None:
        centre = (start[0], start[1], start[2] + HEIGHT / 2)
        self._all, self.rigid = world.add(Quadrotors, SOLID, centre, yaw)
        self._index = self.rigid.index

    def state(self) -> BodyState:
        return self.rigid.state()

    def motion(self) -> BodyMotion:
        """Return the motion of the centre of mass."""
        return self.rigid.motion()

    def accelerate(self, acceleration: Vector, yaw_rate: float) -> None:
        """See bodies.Quadrotor."""
        x, y, z = acceleration
        if not math.isfinite(x + y + z + yaw_rate):
            raise ValueError(f"not an acceleration and a yaw rate: {acceleration}, {yaw_rate}")
        self._all.asked[self._index] = x, y, z, yaw_rate

    def thrusts(self, shares: tuple[float, float, float, float]) -> None:
        """Command the thrust of each motor as a share of its maximum, bypassing the attitude loop.

        Order: front left, rear left, rear right, front right. Holds until the next command. A caller that uses it must
        not go back to `accelerate`."""
        self._all.direct[self._index] = shares

    def motors(self, on: bool) -> None:
        """See bodies.Quadrotor."""
        self._all.running[self._index] = on
