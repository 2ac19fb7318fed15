"""Contact engine PyBullet (see contacts.py).

The only module that imports pybullet, which has no types.

Bodies that the engine does not control are asleep and have no contacts. PyBullet itself multiplies the friction of two
surfaces. Results repeat exactly only in a new client."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.physics.contacts import FLOOR_FRICTION, TOUCHING, BodyMotionTuple, NoWindow, Solid, Touched

# Collision groups and masks: a body touches the groups in its mask.
ROBOT, OBSTACLE, FLOOR, NOTHING = 1, 2, 4, 0
EVERYTHING = ROBOT | OBSTACLE | FLOOR


def _pybullet() -> ModuleType:
    """Import pybullet without the line that its C code prints."""
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


def _displayed() -> bool:
    """Return whether there is an X display. Without one, PyBullet's window would end the process."""
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return False
    x11.XOpenDisplay.restype = ctypes.c_void_p
    display = x11.XOpenDisplay(None)
    if not display:
        return False
    x11.XCloseDisplay(ctypes.c_void_p(display))
    return True


def _vector(p: Point) -> Vector:
    return p.x, p.y, p.z


class Bullet:
    """One PyBullet client.

    Bodies and obstacles are numbered from 0 in the order of creation. Raises NoWindow."""

    def __init__(self, step: float, friction: float = 1.0, gui: bool = False) -> None:
        if gui and not _displayed():
            raise NoWindow("there is no display to open PyBullet's window on; leave out --gui, or set DISPLAY")
        bullet: Any = _pybullet()
        self.bullet, self.shown = bullet, gui
        self._client: int = bullet.connect(bullet.GUI if gui else bullet.DIRECT)
        self._own = {"physicsClientId": self._client}
        bullet.setTimeStep(step, **self._own)
        self._floor: int = bullet.createMultiBody(
            0, bullet.createCollisionShape(bullet.GEOM_PLANE, **self._own), **self._own
        )
        self._group(self._floor, FLOOR, ROBOT)
        bullet.changeDynamics(self._floor, -1, lateralFriction=FLOOR_FRICTION * friction, **self._own)
        self._obstacles: dict[int, int] = {}  # PyBullet's number -> the engine's number
        self._bodies: dict[int, int] = {}
        self._numbers: list[int] = []  # PyBullet's numbers of bodies

    @property
    def client(self) -> int:
        """PyBullet's number of the client."""
        return self._client

    def obstacle(self, obstacle: Obstacle) -> int:
        """Add an obstacle, which nothing moves. Return its number."""
        kinds, own = self.bullet, self._own
        match obstacle:
            case Block(lo, hi):
                middle, half = (lo + hi) / 2, (hi - lo) / 2
                shape = kinds.createCollisionShape(kinds.GEOM_BOX, halfExtents=_vector(half), **own)
            case Sphere(middle, radius):
                shape = kinds.createCollisionShape(kinds.GEOM_SPHERE, radius=radius, **own)
            case Cylinder(base, radius, height):
                middle = Point(base.x, base.y, base.z + height / 2)
                shape = kinds.createCollisionShape(kinds.GEOM_CYLINDER, radius=radius, height=height, **own)
            case Mesh(vertices, faces):
                middle = Point()
                shape = kinds.createCollisionShape(
                    kinds.GEOM_MESH, vertices=[_vector(p) for p in vertices], indices=[i for f in faces for i in f],
                    flags=kinds.GEOM_FORCE_CONCAVE_TRIMESH, **own,
                )  # fmt: skip
        number: int = kinds.createMultiBody(0, shape, -1, _vector(middle), **own)
        self._group(number, OBSTACLE, ROBOT)
        return self._obstacles.setdefault(number, len(self._obstacles))

    def move(self, obstacle: int, by: Vector) -> None:
        """See contacts.Engine."""
        number = next(theirs for theirs, own in self._obstacles.items() if own == obstacle)
        place, turn = self.bullet.getBasePositionAndOrientation(number, **self._own)
        moved = [at + step for at, step in zip(place, by, strict=True)]
        self.bullet.resetBasePositionAndOrientation(number, moved, turn, **self._own)

    def body(self, solid: Solid) -> int:
        """Add a body, not yet under the engine's control. Return its number."""
        kinds, own = self.bullet, self._own
        x, y, z = solid.size
        if solid.round:
            shape = kinds.createCollisionShape(kinds.GEOM_CYLINDER, radius=x / 2, height=z, **own)
        else:
            shape = kinds.createCollisionShape(kinds.GEOM_BOX, halfExtents=[x / 2, y / 2, z / 2], **own)
        number: int = kinds.createMultiBody(solid.mass, shape, **own)
        kinds.changeDynamics(
            number, -1, linearDamping=0, angularDamping=0, restitution=0, lateralFriction=solid.friction,
            localInertiaDiagonal=solid.inertia, **own,
        )  # fmt: skip
        self._numbers.append(number)
        self._bodies[number] = len(self._bodies)
        self.release(len(self._bodies) - 1)
        return len(self._bodies) - 1

    def number(self, body: int) -> int:
        """Return PyBullet's number of a body."""
        return self._numbers[body]

    def set_pose(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Take control of a body: the engine moves it from now on."""
        number = self._numbers[body]
        self._group(number, ROBOT, EVERYTHING)
        self.bullet.changeDynamics(
            number, -1, activationState=self.bullet.ACTIVATION_STATE_DISABLE_SLEEPING, **self._own
        )
        self.show(body, position, orientation)

    def release(self, body: int) -> None:
        """Give up control of a body: the engine no longer moves it."""
        number = self._numbers[body]
        self._group(number, NOTHING, NOTHING)
        self.bullet.resetBaseVelocity(number, (0, 0, 0), (0, 0, 0), **self._own)
        self.bullet.changeDynamics(
            number, -1, activationState=self.bullet.ACTIVATION_STATE_ENABLE_SLEEPING, **self._own
        )
        self.bullet.changeDynamics(number, -1, activationState=self.bullet.ACTIVATION_STATE_SLEEP, **self._own)

    def show(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Set a body's pose."""
        self.bullet.resetBasePositionAndOrientation(self._numbers[body], position, orientation, **self._own)

    def step(self, taken: Iterable[tuple[int, Sequence[float], Sequence[float]]]) -> list[BodyMotionTuple]:
        """Step the bodies under control with their velocities and spins. Return their new motions."""
        numbers = []
        for body, velocity, spin in taken:
            numbers.append(self._numbers[body])
            self.bullet.resetBaseVelocity(numbers[-1], velocity, spin, **self._own)
        self.bullet.stepSimulation(**self._own)
        found: list[BodyMotionTuple] = []
        for number in numbers:
            place = self.bullet.getBasePositionAndOrientation(number, **self._own)
            found.append((*place, *self.bullet.getBaseVelocity(number, **self._own)))
        return found

    def touched(self) -> Touched:
        """Return the contacts of the last step, except with the floor."""
        bodies, obstacles = set(), set()
        for point in self.bullet.getContactPoints(**self._own):
            a, b, distance = point[1], point[2], point[8]
            if distance > TOUCHING:
                continue  # PyBullet keeps points of contact where surfaces are still up to 2 cm apart
            if a in self._bodies and b in self._bodies:
                one, other = self._bodies[a], self._bodies[b]
                bodies.add((min(one, other), max(one, other)))
            elif a in self._obstacles or b in self._obstacles:
                body, obstacle = (b, a) if a in self._obstacles else (a, b)
                obstacles.add((self._bodies[body], self._obstacles[obstacle]))
        return Touched(frozenset(bodies), frozenset(obstacles))

    def grounded(self, body: int) -> bool:
        """Return whether a body under control touches the floor."""
        return bool(self.bullet.getContactPoints(self._numbers[body], self._floor, **self._own))

    def _group(self, number: int, group: int, mask: int) -> None:
        self.bullet.setCollisionFilterGroupMask(number, -1, group, mask, **self._own)

    def _activate(self, number: int, state: int) -> None:
        self.bullet.changeDynamics(number, -1, activationState=state, **self._own)

    def close(self) -> None:
        """Idempotent."""
        if self._client >= 0:
            self.bullet.disconnect(**self._own)
            self._client = -1
