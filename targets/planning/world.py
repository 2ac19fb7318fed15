"""Data types of planners: the world they are created with, and the scene of a call.

docs/explanation/planners.md explains how to write a planner. Metres, local ENU. All types are frozen, and are sent
through a pipe as MessagePack.
"""

from __future__ import annotations

from typing import Protocol

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Grid, Point

Path = tuple[Point, ...]


class World(msgspec.Struct, frozen=True):
    """Constant part of planning: the arena, the fixed obstacles, and facts of the vehicle.

    Planned paths are paths of the vehicle's reference point."""

    arena: Box  # box in which the reference point stays
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of the fleet file
    clearance: float = 0.0  # distance kept between the vehicle and everything else
    radius: float = 0.0  # radius of the ball around the reference point that contains the vehicle
    flies: bool = True  # False: the vehicle moves in the plane z = 0
    footprint: tuple[float, float] = (0.0, 0.0)  # length and width of a ground vehicle
    overhang: float = 0.0  # part of the length behind the rear axle, whose middle is the reference point
    height: float = 0.0  # height of a ground vehicle; obstacles above it are ignored
    wheelbase: float = 0.0  # distance of the axles of a ground vehicle
    turning_radius: float = 0.0  # smallest turning radius of a ground vehicle; 0: it turns on the spot
    reverse: bool = True  # whether a ground vehicle may drive in reverse
    error: float = 0.0  # largest distance of the vehicle from its commanded position: tracking and position errors
    seed: int | None = None  # random seed; with `seed` and `iterations`, equal questions have equal answers
    iterations: int | None = None  # limits the work instead of `seconds`

    @property
    def kept(self) -> float:
        """Distance of planned paths from obstacles."""
        return self.radius + max(self.clearance, self.error)

    @property
    def least(self) -> float:
        """Distance of a path from obstacles below which the vehicle may touch one."""
        return self.radius + self.error


class Scene(msgspec.Struct, frozen=True):
    """Obstacles at the time of a call, besides the fixed ones. Grids and points count as infinitely high."""

    grids: tuple[Grid, ...] = ()
    points: tuple[Point, ...] = ()
    others: tuple[
        Path, ...
    ] = ()  # paths that other robots have published; a robot with a path of one point stays there

    @classmethod
    def of(cls, named: tuple[Grid, ...] | tuple[Point, ...], others: tuple[Path, ...]) -> Scene:
        """Return the scene of the obstacles that a program passes, all Grids or all Points, and others' paths."""
        grids = tuple(g for g in named if isinstance(g, Grid))
        return cls(grids, tuple(p for p in named if isinstance(p, Point)), others)


class Planner(Protocol):
    """Interface of a planner, also of a user's own. It is created once, with a World, and then called repeatedly."""

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """Return a path from `start` to `goal`, or () if there is none, within about `seconds`.

        The path includes both, and is straight between its points. The caller checks it before a robot follows it."""
        ...
