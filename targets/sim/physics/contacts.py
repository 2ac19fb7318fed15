"""Contact engines: the interface of PyBullet (bullet.py) and MuJoCo (mujoco_engine.py), and the choice between them.

An engine moves only the bodies that were taken. In each step it gets their velocities, in which all forces but those of
contacts already are; so there is no gravity in an engine. The friction of two surfaces is the product of theirs.
Lengths are in metres, masses in kg, in the world's frame (ENU). Quaternions are (x, y, z, w).
"""

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

TOUCHING = 1e-3  # m; surfaces that are so near touch
FLOOR_FRICTION = 0.5  # of a floor of friction 1
OBSTACLE_FRICTION = 0.5  # what PyBullet gives to all that says nothing else

Quaternion = tuple[float, float, float, float]
Moved = tuple[Vector, Quaternion, Vector, Vector]  # position, orientation, velocity, spin


class NoWindow(OSError):
    """A window was asked for, and there is no display or the engine has none."""


class NoEngine(Exception):
    """The engine that is wanted is not installed; `hint` says what to do."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Solid:
    """The shape of a body: a box of edges `size`, or, if `round`, an upright cylinder in that box (m); mass (kg),
    inertia about its own axes (kg m^2), friction."""

    size: Vector
    mass: float
    inertia: Vector
    friction: float = 0.0
    round: bool = False

    @property
    def reach(self) -> float:
        """The radius of the sphere about its centre that it never leaves (m)."""
        x, y, z = self.size
        across = x if self.round else (x * x + y * y) ** 0.5
        return float((across * across + z * z) ** 0.5 / 2)


@dataclass(frozen=True, slots=True)
class Touched:
    """Contacts of one step: pairs of bodies (the lower number first), and bodies with obstacles."""

    bodies: frozenset[tuple[int, int]] = frozenset()
    obstacles: frozenset[tuple[int, int]] = frozenset()


class Engine(Protocol):
    """A floor at z = 0, obstacles and bodies. Obstacles and bodies are numbered from 0, each in the order in which they
    were added. The same calls give the same motion to the last bit."""

    @property
    def shown(self) -> bool:
        """True if the engine shows its own window."""
        ...

    def obstacle(self, obstacle: Obstacle) -> int:
        """Add an obstacle, which nothing moves; return its number."""
        ...

    def move(self, obstacle: int, by: Vector) -> None:
        """Move an obstacle by a vector, at once: it does not push what it passes."""
        ...

    def body(self, solid: Solid) -> int:
        """Add a body that is not taken; return its number."""
        ...

    def take(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Let the engine move a body from now on, from this pose."""
        ...

    def release(self, body: int) -> None:
        """Let the engine no longer move a body: it touches nothing."""
        ...

    def show(self, body: int, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Show a body that is not taken at this pose."""
        ...

    def step(self, taken: Iterable[tuple[int, Sequence[float], Sequence[float]]]) -> list[Moved]:
        """Move all bodies that are taken by one step, each with its velocity (m/s) and its spin (rad/s); return the new
        motion of each, in the same order."""
        ...

    def touched(self) -> Touched:
        """Return the contacts of the last step, without those with the floor."""
        ...

    def grounded(self, body: int) -> bool:
        """Return whether a body that is taken touches the floor."""
        ...

    def close(self) -> None:
        """Free the engine. Idempotent."""
        ...


def choose(wanted: str = AUTO) -> str:
    """Return the engine to use: the wanted one, a key of PACKAGES. For AUTO that is PyBullet where it is installed,
    else MuJoCo. Raises NoEngine."""
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
            hint = f"PyBullet has no wheel for {here}; say `sim: {{engine: mujoco}}` in the fleet file"
        raise NoEngine(f"the engine is {wanted}, and the Python package {PACKAGES[wanted]!r} is missing", hint)
    return wanted


def is_installed(engine: str) -> bool:
    """Return whether Python can import an engine."""
    return importlib.util.find_spec(engine) is not None


def _has_wheel() -> bool:
    """Whether pip finds a built PyBullet for this Python, as the markers in pyproject.toml say."""
    return sys.version_info < (3, 12) and platform.machine() == "x86_64"


def _install(engine: str) -> str:
    return f"{sys.executable} -m pip install {PACKAGES[engine]}"
