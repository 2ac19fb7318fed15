"""The PyBullet world: robots and obstacles on a floor. The only module that knows pybullet, which has no types.

Frame: local ENU, metres; orientations are quaternions (x, y, z, w). PyBullet repeats itself only in a fresh client,
so a world serves one run.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from koordgen.runtime.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values import Point
from targets.sim.bodies import Vector

STEP = 1 / 240  # seconds
GRAVITY = 9.81
# Collision groups: what is in one touches those of its mask. Rays see robots and obstacles that are not hidden.
ROBOT, OBSTACLE, FLOOR, HIDDEN = 1, 2, 4, 8
EVERYTHING = ROBOT | OBSTACLE | FLOOR

Quaternion = tuple[float, float, float, float]


def _pybullet() -> ModuleType:
    """Imports pybullet without the line that it prints from C."""
    kept, null = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(null, number)
        import pybullet

        ctypes.CDLL(None).fflush(None)
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(null)
    assert isinstance(pybullet, ModuleType)
    return pybullet


@dataclass(frozen=True, slots=True)
class Motion:
    """Centre of mass (m), orientation, velocity (m/s) and spin (rad/s), all in the world's frame."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    spin: Vector

    @property
    def forward(self) -> Vector:
        """The body's own x axis."""
        x, y, z, w = self.orientation
        return (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w))

    @property
    def up(self) -> Vector:
        """The body's own z axis."""
        x, y, z, w = self.orientation
        return (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y))


def _vector(p: Point) -> Vector:
    return p.x, p.y, p.z


class Rigid:
    """One rigid body; made by a World."""

    def __init__(self, world: World, number: int, mass: float) -> None:
        self._bullet = world.bullet
        self._client = world.client
        self.number = number
        self.mass = mass

    def motion(self) -> Motion:
        position, orientation = self._bullet.getBasePositionAndOrientation(self.number, physicsClientId=self._client)
        velocity, spin = self._bullet.getBaseVelocity(self.number, physicsClientId=self._client)
        return Motion(position, orientation, velocity, spin)

    def push(self, force: Vector, torque: Vector, at: Vector) -> None:
        """Apply a wrench for the next step: newtons at the point `at`, newton metres; world's frame."""
        frame = self._bullet.WORLD_FRAME
        self._bullet.applyExternalForce(self.number, -1, force, at, frame, physicsClientId=self._client)
        self._bullet.applyExternalTorque(self.number, -1, torque, frame, physicsClientId=self._client)


class World:
    """A floor at z = 0 and what was put on it. `steps` counts what was simulated."""

    def __init__(self) -> None:
        self.bullet: Any = _pybullet()
        self.client: int = self.bullet.connect(self.bullet.DIRECT)
        self.bullet.setGravity(0, 0, -GRAVITY, physicsClientId=self.client)
        self.bullet.setTimeStep(STEP, physicsClientId=self.client)
        plane = self.bullet.createCollisionShape(self.bullet.GEOM_PLANE, physicsClientId=self.client)
        self._floor: int = self.bullet.createMultiBody(0, plane, physicsClientId=self.client)
        self._group(self._floor, FLOOR, ROBOT)
        self.steps = 0

    @property
    def time(self) -> float:
        """Seconds simulated."""
        return self.steps * STEP

    def box(self, size: Vector, mass: float, centre: Vector, yaw: float, friction: float, inertia: Vector) -> Rigid:
        """A box of edges `size` (m); `inertia` is about its own axes (kg m^2)."""
        shape = self.bullet.createCollisionShape(
            self.bullet.GEOM_BOX, halfExtents=[edge / 2 for edge in size], physicsClientId=self.client
        )
        return self._body(shape, mass, centre, yaw, friction, inertia)

    def cylinder(
        self, radius: float, height: float, mass: float, centre: Vector, yaw: float, friction: float, inertia: Vector
    ) -> Rigid:
        """An upright cylinder; `inertia` is about its own axes (kg m^2)."""
        shape = self.bullet.createCollisionShape(
            self.bullet.GEOM_CYLINDER, radius=radius, height=height, physicsClientId=self.client
        )
        return self._body(shape, mass, centre, yaw, friction, inertia)

    def obstacle(self, obstacle: Obstacle) -> int:
        """Something that nothing moves; its number, as in `contacts`."""
        kinds, client = self.bullet, {"physicsClientId": self.client}
        match obstacle:
            case Block(lo, hi):
                middle, half = (lo + hi) / 2, (hi - lo) / 2
                shape = kinds.createCollisionShape(kinds.GEOM_BOX, halfExtents=_vector(half), **client)
            case Sphere(middle, radius):
                shape = kinds.createCollisionShape(kinds.GEOM_SPHERE, radius=radius, **client)
            case Cylinder(base, radius, height):
                middle = Point(base.x, base.y, base.z + height / 2)
                shape = kinds.createCollisionShape(kinds.GEOM_CYLINDER, radius=radius, height=height, **client)
            case Mesh(vertices, faces):
                middle = Point()
                shape = kinds.createCollisionShape(
                    kinds.GEOM_MESH, vertices=[_vector(p) for p in vertices], indices=[i for f in faces for i in f],
                    flags=kinds.GEOM_FORCE_CONCAVE_TRIMESH, **client,
                )  # fmt: skip
        number: int = kinds.createMultiBody(0, shape, -1, _vector(middle), **client)
        self._group(number, OBSTACLE, ROBOT)
        return number

    def _group(self, number: int, group: int, mask: int) -> None:
        self.bullet.setCollisionFilterGroupMask(number, -1, group, mask, physicsClientId=self.client)

    def rays(self, origin: Vector, ends: Sequence[Vector], unseen: Rigid) -> list[float | None]:
        """How far along each straight line from `origin` to `ends`, as a share of it, the first robot or obstacle is,
        of all but `unseen`; None: there is none. Bullet finds the contacts of `unseen` anew in the next step."""
        self._group(unseen.number, HIDDEN, EVERYTHING)
        found = self.bullet.rayTestBatch(
            [origin] * len(ends), ends, numThreads=1, collisionFilterMask=ROBOT | OBSTACLE, physicsClientId=self.client
        )
        self._group(unseen.number, ROBOT, EVERYTHING)
        return [share if number >= 0 else None for number, _, share, *_ in found]

    def _body(self, shape: int, mass: float, centre: Vector, yaw: float, friction: float, inertia: Vector) -> Rigid:
        turned = self.bullet.getQuaternionFromEuler([0, 0, yaw])
        number = self.bullet.createMultiBody(mass, shape, -1, centre, turned, physicsClientId=self.client)
        self._group(number, ROBOT, EVERYTHING)
        self.bullet.changeDynamics(
            number,
            -1,
            linearDamping=0,
            angularDamping=0,
            restitution=0,
            lateralFriction=friction,
            localInertiaDiagonal=inertia,
            physicsClientId=self.client,
        )
        return Rigid(self, number, mass)

    def step(self) -> None:
        self.bullet.stepSimulation(physicsClientId=self.client)
        self.steps += 1

    def contacts(self) -> set[tuple[int, int]]:
        """The pairs of bodies (lower number first) that touched in the last step."""
        found = self.bullet.getContactPoints(physicsClientId=self.client)
        pairs = {(min(a, b), max(a, b)) for _, a, b, *_ in found}
        return {pair for pair in pairs if self._floor not in pair}

    def grounded(self, body: Rigid) -> bool:
        """Whether a body touches the floor."""
        return bool(self.bullet.getContactPoints(body.number, self._floor, physicsClientId=self.client))

    def close(self) -> None:
        if self.client >= 0:
            self.bullet.disconnect(physicsClientId=self.client)
            self.client = -1
