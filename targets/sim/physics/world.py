"""World: robots and obstacles on a floor. All bodies of a kind move together, in arrays.

A contact engine moves the bodies that may touch something (contacts.py, broad_phase.py). Frame: local ENU, metres. The
same bodies, seed and commands give the same motion to the last bit. A world serves one run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from koordgen.runtime.trace.schema import Wind
from koordgen.runtime.values.obstacles import Obstacle
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.scenario import AUTO
from targets.sim.physics.broad_phase import BROAD_PHASE_PERIOD, BroadPhase
from targets.sim.physics.contacts import Solid, Touched
from targets.sim.physics.engines import make
from targets.sim.physics.ray_casting import Bodies, LidarMount, ObstacleMap, cast_rays
from targets.sim.physics.rigid import Array, Mask, Motions, advance, rotations
from targets.sim.physics.wind import Air

STEP = 1 / 240  # seconds
GRAVITY = 9.81

Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Motion of one body in the world frame.

    Centre of mass (m), orientation (x, y, z, w), velocity (m/s) and spin (rad/s)."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    spin: Vector

    @property
    def up(self) -> Vector:
        """The body's z axis in the world frame."""
        x, y, z, w = self.orientation
        return (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y))


class BodyKind(ABC):
    """All bodies with the same dynamics.

    A kind overrides `grow` (arrays of its own), `push`, and any method whose default does not fit."""

    rolling = False  # True if the floor carries the bodies without the contact engine

    def __init__(self) -> None:
        self.count = 0
        self.motions = Motions.still(0)
        self._cached: tuple[int, list[BodyState]] = (-1, [])

    @abstractmethod
    def grow(self) -> None:
        """Extend the kind's own arrays for a new last body."""

    @abstractmethod
    def push(self, air: Array | None, taken: Mask) -> None:
        """Change velocities and spins by all forces of one step except contacts.

        `air` is the wind. `taken` bodies are under the contact engine's control."""

    def steady(self) -> Mask:
        """Return which bodies stand on the floor as usual. Only for a kind that rolls."""
        return np.zeros(self.count, dtype=bool)

    @abstractmethod
    def place(self) -> tuple[Array, Array, Array]:
        """Return positions and velocities of the reference points, (3, n), and yaws of the bodies."""

    def states(self, steps: int) -> list[BodyState]:
        """Return the true states after `steps` steps."""
        if self._cached[0] != steps:
            position, velocity, yaw = (array.tolist() for array in self.place())
            places, speeds = zip(*position, strict=True), zip(*velocity, strict=True)
            rates = self.motions.spin[2].tolist()
            self._cached = (steps, list(map(BodyState, places, speeds, yaw, rates)))
        return self._cached[1]

    def forget(self) -> None:
        """Discard the cached states."""
        self._cached = (-1, [])


Law = TypeVar("Law", bound=BodyKind)


class Rigid:
    """One body of the world: `number` among all bodies, `index` within its kind."""

    def __init__(self, world: SimulatedWorld, kind: BodyKind, number: int, index: int) -> None:
        self._world, self._kind = world, kind
        self.number, self.index = number, index

    def state(self) -> BodyState:
        return self._kind.states(self._world.steps)[self.index]

    def motion(self) -> BodyMotion:
        now, k = self._kind.motions, self.index
        position, velocity, spin = (tuple(a[:, k].tolist()) for a in (now.position, now.velocity, now.spin))
        return BodyMotion(position, tuple(now.orientation[:, k].tolist()), velocity, spin)

    def throw(self, velocity: Vector, spin: Vector = (0.0, 0.0, 0.0)) -> None:
        """Set the body's velocity (m/s) and spin (rad/s) from outside the simulation."""
        self._kind.motions.velocity[:, self.index] = velocity
        self._kind.motions.spin[:, self.index] = spin
        self._kind.forget()
        self._world.repeat_broad_phase()


class SimulatedWorld:
    """A floor at z = 0, bodies and obstacles. `steps` counts the simulated steps.

    Raises contacts.NoEngine and contacts.NoWindow."""

    def __init__(
        self, wind: Wind | None = None, friction: float = 1.0, seed: int = 0, gui: bool = False, engine: str = AUTO
    ) -> None:
        self.engine = make(engine, STEP, friction, gui)
        self.friction = friction  # factor of the floor's friction; 1 is usual
        self.steps = 0
        self._broad_phase = BroadPhase()
        self._obstacles = ObstacleMap()
        self._kinds: dict[type[BodyKind], BodyKind] = {}
        self._motions = Motions.still(0)
        self._numbers: list[int] = []  # body numbers, by row in the arrays
        self._solids: list[Solid] = []  # by row, too
        self._reach = np.zeros(0)
        self._taken = np.zeros(0, dtype=bool)
        self._rows: list[int] = []  # rows of bodies under the contact engine's control
        self._may_collide = False  # whether one of those may touch more than the floor
        self._touched = Touched()
        self._next_broad_phase = 0
        self._wind, self._seed = wind or Wind(), seed
        self._air = Air(self._wind, seed, 0)

    @property
    def time(self) -> float:
        """Simulated seconds."""
        return self.steps * STEP

    def obstacle(self, obstacle: Obstacle) -> int:
        """Add an obstacle, which no body moves. Return its number, from 0."""
        self._broad_phase.stand(obstacle)
        self._obstacles.stand(obstacle)
        self.repeat_broad_phase()
        return self.engine.obstacle(obstacle)

    def move(self, number: int, by: Vector) -> Obstacle:
        """Move an obstacle by a vector (m) at once, without pushing bodies. Return it at its new position."""
        self._broad_phase.move(number, by)
        self.engine.move(number, by)
        self.repeat_broad_phase()
        return self._obstacles.move(number, by)

    def blow(self, wind: Wind) -> None:
        """Change the wind."""
        self._wind = wind
        self._air.change(wind)

    def add(self, law: type[Law], solid: Solid, centre: Vector, yaw: float) -> tuple[Law, Rigid]:
        """Add a body of a kind, at rest and level. Return the kind and the body."""
        kind = self._kinds.setdefault(law, law())
        assert isinstance(kind, law)
        row = sum(k.count for k in self._before(kind)) + kind.count
        kind.count += 1
        start = Motions.still(1)
        start.position[:, 0] = centre
        start.orientation[2:, 0] = np.sin(yaw / 2), np.cos(yaw / 2)
        old = self._motions
        self._motions = Motions(
            *(np.insert(getattr(old, name), row, getattr(start, name)[:, 0], axis=1)
              for name in ("position", "orientation", "velocity", "spin"))
        )  # fmt: skip
        self._solids.insert(row, solid)
        self._reach = np.array([each.reach for each in self._solids])
        self._taken = np.insert(self._taken, row, False)
        number = self.engine.body(solid)
        self._numbers.insert(row, number)
        self._shapes = (
            np.array([each.size for each in self._solids]).T, np.array([each.round for each in self._solids]),
            self._reach, np.array(self._numbers),
        )  # fmt: skip
        self._air = Air(self._wind, self._seed, len(self._numbers))
        for each, rows in self._parts():
            each.motions = self._motions.part(rows.start, rows.stop)
            each.forget()
        kind.grow()
        self.repeat_broad_phase()
        return kind, Rigid(self, kind, number, kind.count - 1)

    def _before(self, kind: BodyKind) -> Iterator[BodyKind]:
        for each in self._kinds.values():
            if each is kind:
                return
            yield each

    def _parts(self) -> Iterator[tuple[BodyKind, slice]]:
        first = 0
        for kind in self._kinds.values():
            yield kind, slice(first, first + kind.count)
            first += kind.count

    def repeat_broad_phase(self) -> None:
        """Repeat the broad phase before the next step."""
        self._next_broad_phase = self.steps
        self._rows = np.flatnonzero(self._taken).tolist()

    def step(self) -> None:
        """Simulate one step of all bodies."""
        if self.steps >= self._next_broad_phase:
            self._run_broad_phase()
        air = self._air.step(STEP)
        for kind, rows in self._parts():
            blown = air if air is None or air.shape[1] == 1 else air[:, rows]
            kind.push(blown, self._taken[rows])
        advance(self._motions, STEP)
        self._touched = self._contact() if self._rows else Touched()
        self.steps += 1

    def _run_broad_phase(self) -> None:
        """Run the broad phase.

        Hand over to the contact engine the bodies that may touch something until the next one."""
        seconds = BROAD_PHASE_PERIOD * STEP
        floor = self._broad_phase.to_floor(self._motions, self._reach, seconds)
        for kind, rows in self._parts():
            if kind.rolling:
                floor[rows] = ~kind.steady()
        others = self._broad_phase.to_others(self._motions, self._reach, seconds)
        taken = floor | others
        for row in np.flatnonzero(taken & ~self._taken).tolist():
            self.engine.set_pose(self._numbers[row], *self._pose(row))
        for row in np.flatnonzero(self._taken & ~taken).tolist():
            self.engine.release(self._numbers[row])
        self._taken, self._rows = taken, np.flatnonzero(taken).tolist()
        self._may_collide = bool(others.any())
        self._next_broad_phase = self.steps + BROAD_PHASE_PERIOD
        if self.engine.shown:
            for row in np.flatnonzero(~taken).tolist():
                self.engine.show(self._numbers[row], *self._pose(row))

    def _pose(self, row: int) -> tuple[list[float], list[float]]:
        return self._motions.position[:, row].tolist(), self._motions.orientation[:, row].tolist()

    def _contact(self) -> Touched:
        """Let the contact engine move its bodies. Return the contacts."""
        now, rows = self._motions, self._rows
        velocity, spin = now.velocity[:, rows].T.tolist(), now.spin[:, rows].T.tolist()
        numbers = [self._numbers[row] for row in rows]
        moved = self.engine.step(zip(numbers, velocity, spin, strict=True))
        found = [np.array(values).T for values in zip(*moved, strict=True)]
        now.position[:, rows], now.orientation[:, rows], now.velocity[:, rows], now.spin[:, rows] = found
        if not self._may_collide:
            return Touched()
        touched = self.engine.touched()
        if touched.bodies or touched.obstacles:
            self._next_broad_phase = self.steps + 1  # a body that was hit may be much faster now
        return touched

    def touched(self) -> Touched:
        """Return the contacts of the last step."""
        return self._touched

    def grounded(self, body: Rigid) -> bool:
        """Return whether a body stands on the floor."""
        row = self._numbers.index(body.number)
        if self._taken[row]:
            return self.engine.grounded(body.number)
        return any(kind.rolling and rows.start <= row < rows.stop for kind, rows in self._parts())

    def cast_rays(self, eyes: Sequence[LidarMount]) -> list[Array]:
        """Return the ranges of lidars (m) along their rays; inf without a hit."""
        now = self._motions
        bodies = Bodies(now.position, rotations(now.orientation), *self._shapes)
        return cast_rays(eyes, self._obstacles, bodies)

    def close(self) -> None:
        """Free the contact engine. Idempotent."""
        self.engine.close()
