"""Contact engines: common interface of PyBullet and MuJoCo, and the choice between them.

An engine moves only the bodies under its control (`set_pose`). In each step it receives their velocities, which already
include all forces but contacts; so there is no gravity in an engine. The friction of two surfaces is the product of
theirs. Lengths are in metres, masses in kg, in the world frame (ENU). Quaternions are (x, y, z, w)."""

from __future__ import annotations

import importlib.util
import platform
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from koordgen.runtime.values.obstacles import Obstacle
from targets.sim.base.bodies import Vector
from targets.sim.base.scenario import AUTO, MUJOCO, PACKAGES, PYBULLET

TOUCHING = 1e-3  # m; surfaces this close touch
FLOOR_FRICTION = 0.5  # of a floor with friction 1
OBSTACLE_FRICTION = 0.5  # PyBullet's default

Quaternion = tuple[float, float, float, float]
BodyMotionTuple = tuple[Vector, Quaternion, Vector, Vector]  # position, orientation, velocity, spin


class NoWindow(OSError):
    """A window was requested, but there is no display or the engine has no window."""


class NoEngine(Exception):
    """The requested engine is not installed; `hint` says how to install it."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Solid:
    """Shape of a body: a box with edges `size` (m), or with `round` an upright cylinder in that box.

    Mass (kg), inertia about its own axes (kg m^2), friction."""

    size: Vector
    mass: float
    inertia: Vector
    friction: float = 0.0
    round: bool = False

    @property
    def reach(self) -> float:
        """Radius of the bounding sphere about the centre (m)."""
        x, y, z = self.size
        across = x if self.round else (x * x + y * y) ** 0.5
        return float((across * across + z * z) ** 0.5 / 2)


@dataclass(frozen=True, slots=True)
class Touched:
    """Contacts of one step: pairs of bodies (the lower number first), and bodies with obstacles."""

    bodies: frozenset[tuple[int, int]] = frozenset()
    obstacles: frozenset[tuple[int, int]] = frozenset()


class Engine(Protocol):
    """A floor at z = 0, obstacles and bodies.

    Obstacles and bodies are numbered from 0, each in the order of creation. The same calls give the same motion to the
    last bit."""

    @property
    def shown(self) -> bool:
        """True if the engine shows its own window."""
        ...

    def obstacle(self, obstacle: Obstacle) -> int:
        """Add an obstacle, which nothing moves; return its number."""
        ...

    def move(self, obstacle: int, by: Vector) -> None:
        """Move an obstacle by a vector at once: it does not push bodies."""
        ...

    def body(self, solid: Solid) -> int:
        """Add a body, not yet under the engine's control; return its number."""
        ...

    def set_pose(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Take control of a body, from this pose on."""
        ...

    def release(self, body: int) -> None:
        """Give up control of a body: it touches nothing."""
        ...

    def show(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Show a body outside the engine's control at this pose."""
        ...

    def step(self, taken: Iterable[tuple[int, Sequence[float], Sequence[float]]]) -> list[BodyMotionTuple]:
        """Step all bodies under control, each with its velocity (m/s) and spin (rad/s).

        Returns the new motion of each, in the same order."""
        ...

    def touched(self) -> Touched:
        """Return the contacts of the last step, except with the floor."""
        ...

    def grounded(self, body: int) -> bool:
        """Return whether a body under control touches the floor."""
        ...

    def close(self) -> None:
        """Free the engine. Idempotent."""
        ...


def choose(wanted: str = AUTO) -> str:
    """Return the engine to use, a key of PACKAGES.

    The wanted one, or for AUTO an installed one, PyBullet first.

    Raises NoEngine."""
    if wanted == AUTO:
        found = next(filter(is_installed, PACKAGES), None)
        if found is None:
            raise NoEngine(
                f"no contact engine is installed: {' or '.join(PACKAGES.values())} is needed",
                _install(PYBULLET if _has_wheel() else MUJOCO),
            )
        return found
    if not is_installed(wanted):
        hint = _install(wanted)
        if wanted == PYBULLET and not _has_wheel():
            here = f"Python {sys.version_info[0]}.{sys.version_info[1]} on {platform.machine()}"
            hint = f"PyBullet has no wheel for {here}; set `sim: {{engine: mujoco}}` in the fleet file"
        raise NoEngine(f"the engine is {wanted}, and the Python package {PACKAGES[wanted]!r} is missing", hint)
    return wanted


def is_installed(engine: str) -> bool:
    """Return whether Python can import an engine."""
    return importlib.util.find_spec(engine) is not None


def _has_wheel() -> bool:
    """Return whether pip finds a built PyBullet for this Python, as the markers in pyproject.toml say."""
    return sys.version_info < (3, 12) and platform.machine() == "x86_64"


def _install(engine: str) -> str:
    return f"{sys.executable} -m pip install {PACKAGES[engine]}"
