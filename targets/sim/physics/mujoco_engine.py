"""Contact engine MuJoCo (see contacts.py). The only module that imports mujoco.

MuJoCo compiles a model before the first step, and again after a body or an obstacle was added. Two of its rules differ
from this simulator's:
- A mesh collides as its convex hull. Here each triangle is a mesh of its own, a prism of THICKNESS, so that an arch can
  be flown through. A mesh stays a surface even if it is convex: a room can be one.
- Friction of two geoms is the larger one. Here the friction of each pair is set: floor and body, and body and body, are
  explicit pairs. Obstacles are too many for that; a body's geom has the higher priority, so its friction counts there,
  and that is the product with an obstacle's.

Contacts are soft in MuJoCo. Here damping removes the whole velocity into a surface within one step, and stiffness moves
a body out of a surface by ERP of the depth in each step: slowly enough that nothing bounces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.physics.contacts import (
    FLOOR_FRICTION,
    OBSTACLE_FRICTION,
    TOUCHING,
    BodyMotionTuple,
    NoWindow,
    Solid,
    Touched,
)
from targets.sim.physics.rigid import Array, rotations

THICKNESS = 5e-4  # m, of a mesh's surface
NARROWEST = 1e-5  # m; MuJoCo cannot make a body of a narrower triangle, and its neighbours leave no relevant gap
ERP = 0.02  # share of the depth, in each step
IMPEDANCE = (0.999, 0.999, 0.001, 0.5, 2.0)  # the same at all depths
FRICTION_BY_NORMAL = 10.0  # impedance of friction relative to the normal direction: bodies at rest do not creep
SLIDING = 1.5  # see Mujoco._limit_friction
TINY = 1e-12  # m/s^2
OBSTACLES = 1  # collision bit
PARKED = 1e4  # m above the floor, and between neighbours: position of bodies outside the engine's control


class Mujoco:
    """One MuJoCo model with its state. Implements contacts.Engine. Raises NoWindow."""

    shown = False

    def __init__(self, step: float, friction: float = 1.0, gui: bool = False) -> None:
        if gui:
            raise NoWindow("the engine mujoco has no window; use --live instead of --gui to watch the run in a browser")
        self._spec = _specification(step)
        self._solref = (-ERP / step**2, -1 / step)
        self._floor = FLOOR_FRICTION * friction
        self._solids: list[Solid] = []
        self._obstacles: list[str] = []  # obstacle numbers by geom name
        self._many = 0  # number of obstacles
        self._model: Any = None  # None: compile before the next use
        self._data: Any = None
        self._poses: Array = np.zeros((0, 7))  # of bodies: position and orientation (w, x, y, z)
        self._speeds: Array = np.zeros((0, 6))  # velocity in the world frame, and spin in the body frame
        self._owners: list[tuple[int, int]] = []  # by geom: body and obstacle, -1 for none

    def obstacle(self, obstacle: Obstacle) -> int:
        """See contacts.Engine."""
        number = self._many
        for part, shape in enumerate(_shapes(obstacle)):
            vertices = shape.pop("vertices", None)
            if vertices is not None:
                shape["meshname"] = f"mesh {number} {part}"
                self._spec.add_mesh(
                    name=shape["meshname"], uservert=vertices, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
                )
            self._spec.worldbody.add_geom(name=f"obstacle {number} {part}", contype=OBSTACLES, conaffinity=0, **shape)
        self._many += 1
        self._model = None
        return number

    def move(self, obstacle: int, by: Vector) -> None:
        """See contacts.Engine."""
        for geom in self._spec.geoms:
            if _owner(geom.name) == (-1, obstacle):
                geom.pos = np.add(geom.pos, by)
        self._model = None  # geoms of the world get their positions at compilation

    def body(self, solid: Solid) -> int:
        """See contacts.Engine."""
        number = len(self._solids)
        x, y, z = solid.size
        kinds = mujoco.mjtGeom
        body = self._spec.worldbody.add_body(
            pos=_parked(number), explicitinertial=True, mass=solid.mass, ipos=(0.0, 0.0, 0.0),
            # _compile sets the real inertia, which MuJoCo's checks may refuse here
            inertia=(solid.mass * solid.reach**2,) * 3,
        )  # fmt: skip
        body.add_freejoint()
        body.add_geom(
            name=f"body {number}", type=kinds.mjGEOM_CYLINDER if solid.round else kinds.mjGEOM_BOX,
            size=(x / 2, z / 2, 0.0) if solid.round else (x / 2, y / 2, z / 2),
            contype=0, conaffinity=OBSTACLES, priority=1, **self._surface(solid.friction * OBSTACLE_FRICTION, 3),
        )  # fmt: skip
        self._pair("floor", number, solid.friction * self._floor)
        for other, each in enumerate(self._solids):
            self._pair(f"body {other}", number, solid.friction * each.friction)
        self._solids.append(solid)
        self._model = None
        return number

    def _surface(self, friction: float, values: int) -> dict[str, Any]:
        """Return contact parameters of a geom (3 friction `values`) or of a pair (5)."""
        slides = (friction, friction, 0.0, 0.0, 0.0) if values == 5 else (friction, 0.0, 0.0)
        return {
            "condim": 3 if friction > 0 else 1, "friction": slides, "solref": self._solref, "solimp": IMPEDANCE,
            "gap": TOUCHING,
        }  # fmt: skip

    def _pair(self, other: str, body: int, friction: float) -> None:
        self._spec.add_pair(geomname1=other, geomname2=f"body {body}", **self._surface(friction, 5))

    def _compile(self) -> None:
        """Compile the model. Bodies keep their poses."""
        poses = self._poses.copy()
        self._model = mujoco_model = self._spec.compile()
        mujoco_model.body_inertia[1:] = [solid.inertia for solid in self._solids]
        self._data = mujoco.MjData(mujoco_model)
        mujoco.mj_setConst(mujoco_model, self._data)
        mujoco.mj_resetData(mujoco_model, self._data)
        self._poses = self._data.qpos.reshape(-1, 7)
        self._poses[: len(poses)] = poses
        self._speeds = self._data.qvel.reshape(-1, 6)
        self._owners = [_owner(mujoco_model.geom(k).name) for k in range(mujoco_model.ngeom)]

    def set_pose(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """See contacts.Engine."""
        if self._model is None:
            self._compile()
        x, y, z, w = orientation
        self._poses[body] = (*position, w, x, y, z)

    def release(self, body: int) -> None:
        """See contacts.Engine."""
        self._poses[body] = (*_parked(body), 1.0, 0.0, 0.0, 0.0)
        self._speeds[body] = 0.0

    def show(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Do nothing: there is no window. See contacts.Engine."""

    def step(self, taken: Iterable[tuple[int, Sequence[float], Sequence[float]]]) -> list[BodyMotionTuple]:
        """See contacts.Engine. Raises RuntimeError with MuJoCo's warning if it could not compute the step."""
        if self._model is None:
            self._compile()
        numbers, velocities, spins = zip(*taken, strict=True)
        rows = list(numbers)
        self._speeds[rows, :3] = velocities
        turned = rotations(self._poses[rows][:, [4, 5, 6, 3]].T)
        self._speeds[rows, 3:] = np.einsum("ijn,ni->nj", turned, np.array(spins))
        mujoco.mj_step1(self._model, self._data)
        self._limit_friction()
        mujoco.mj_step2(self._model, self._data)
        if _warnings:
            first = _warnings[0]
            _warnings.clear()
            raise RuntimeError(f"MuJoCo: {first}")
        poses, speeds = self._poses[rows], self._speeds[rows]
        orientations = poses[:, [4, 5, 6, 3]]
        orientations /= np.linalg.norm(orientations, axis=1, keepdims=True)
        spun = np.einsum("ijn,nj->ni", rotations(orientations.T), speeds[:, 3:])
        parts = (poses[:, :3].tolist(), orientations.tolist(), speeds[:, :3].tolist(), spun.tolist())
        return [tuple(map(tuple, each)) for each in zip(*parts, strict=True)]  # type: ignore[misc]

    def _limit_friction(self) -> None:
        """Limit friction as Coulomb's law does.

        MuJoCo's contact problem is convex, so a sliding body is lifted: by the friction coefficient times the ratio of
        requested to available friction (M. Anitescu, Optimization-based simulation of nonsmooth rigid multibody
        dynamics, Mathematical Programming 105, 2006). Here the requested friction is limited to SLIDING times the
        available one, and the surface's request is reduced by that lift. A body that friction can hold does not creep:
        its whole velocity is requested."""
        # requested accelerations: normal, and two of friction
        contact, wanted = self._data.contact, self._data.efc_aref
        rough = (contact.dim == 3) & (contact.efc_address >= 0)
        if not rough.any():
            return
        rows, coefficient = contact.efc_address[rough], contact.friction[rough, 0]
        given = coefficient * np.maximum(wanted[rows], 0.0)
        asked = np.hypot(wanted[rows + 1], wanted[rows + 2])
        share = np.minimum(SLIDING * given / np.maximum(asked, TINY), 1.0)
        wanted[rows + 1] *= share
        wanted[rows + 2] *= share
        wanted[rows] -= np.where(share < 1.0, coefficient * (SLIDING - 1.0) * given, 0.0)

    def touched(self) -> Touched:
        """See contacts.Engine."""
        bodies, obstacles = set(), set()
        for (one, first), (other, second) in self._contacts():
            if one >= 0 and other >= 0:
                bodies.add((min(one, other), max(one, other)))
            elif first >= 0 or second >= 0:
                obstacles.add((max(one, other), max(first, second)))
        return Touched(frozenset(bodies), frozenset(obstacles))

    def grounded(self, body: int) -> bool:
        """See contacts.Engine."""
        pairs = ({one, other} for one, other in self._contacts())
        return any({_FLOOR, (body, -1)} == pair for pair in pairs)

    def _contacts(self) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        """Yield the owners of the two geoms of each contact. A contact may occur several times."""
        if self._data is not None:
            for one, other in self._data.contact.geom.tolist():
                yield self._owners[one], self._owners[other]

    def close(self) -> None:
        """See contacts.Engine."""
        self._model = self._data = None


_FLOOR = (-1, -1)
_warnings: list[str] = []
mujoco.set_mju_user_warning(_warnings.append)  # otherwise warnings go to a file in the working directory


def _owner(name: str) -> tuple[int, int]:
    """Return the body and the obstacle of a geom of that name, -1 for none."""
    kind, *numbers = name.split()
    return (int(numbers[0]), -1) if kind == "body" else (-1, int(numbers[0])) if kind == "obstacle" else _FLOOR


def _specification(step: float) -> Any:
    """Return a specification with a floor and without gravity."""
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep, option.gravity = step, (0.0, 0.0, 0.0)
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, FRICTION_BY_NORMAL
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_DIAGEXACT
    # an automatic reset would put bodies back to their start
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1.0, 1.0, 1.0), contype=0, conaffinity=0
    )
    return spec


def _parked(body: int) -> tuple[float, float, float]:
    return PARKED * body, 0.0, PARKED


def _shapes(obstacle: Obstacle) -> Iterator[dict[str, Any]]:
    """Yield the geoms of an obstacle: type, size and position, or the vertices of a convex mesh."""
    kinds = mujoco.mjtGeom
    match obstacle:
        case Block(lo, hi):
            middle, half = (lo + hi) / 2, (hi - lo) / 2
            yield {"type": kinds.mjGEOM_BOX, "size": _vector(half), "pos": _vector(middle)}
        case Sphere(middle, radius):
            yield {"type": kinds.mjGEOM_SPHERE, "size": (radius, 0.0, 0.0), "pos": _vector(middle)}
        case Cylinder(base, radius, height):
            middle = Point(base.x, base.y, base.z + height / 2)
            yield {"type": kinds.mjGEOM_CYLINDER, "size": (radius, height / 2, 0.0), "pos": _vector(middle)}
        case Mesh(vertices, faces):
            corners = np.array([_vector(p) for p in vertices])
            for face in faces:
                prism = _prism(corners[list(face)])
                if prism is not None:
                    yield {"type": kinds.mjGEOM_MESH, "vertices": prism.ravel().tolist()}


def _prism(triangle: Array) -> Array | None:
    """Return the six corners of a triangle of THICKNESS, half to each side; None if it is too narrow."""
    across = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    twice_area = float(np.linalg.norm(across))
    longest = max(float(np.linalg.norm(triangle[k] - triangle[k - 1])) for k in range(3))
    if twice_area <= NARROWEST * longest:
        return None
    half = across * (THICKNESS / 2 / twice_area)
    return np.concatenate((triangle - half, triangle + half))


def _vector(p: Point) -> tuple[float, float, float]:
    return p.x, p.y, p.z
