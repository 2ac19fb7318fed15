"""Data types of path planners: the World of a planner, and the Scene of a call.

docs/explanation/planners.md explains how to write a planner. Lengths are in metres, positions in local ENU. All types
are frozen, and are sent through a pipe as MessagePack.
"""

from __future__ import annotations

from typing import Protocol

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Grid, Point

Path = tuple[Point, ...]


class World(msgspec.Struct, frozen=True):
    """Data of a planner that stay constant: the arena, the fixed obstacles, and facts of the vehicle.

    A planned path is a path of the vehicle's reference point."""

    arena: Box  # box in which the reference point stays
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of the fleet file
    clearance: float = 0.0  # distance to keep between the vehicle and obstacles or other robots
    radius: float = 0.0  # radius of the ball around the reference point that contains the vehicle
    flies: bool = True  # False: the vehicle moves in the plane z = 0
    footprint: tuple[float, float] = (0.0, 0.0)  # length and width of a ground vehicle
    overhang: float = 0.0  # length of a ground vehicle behind its rear axle; the reference point is the axle's middle
    height: float = 0.0  # height of a ground vehicle; obstacles above it are ignored
    wheelbase: float = 0.0  # distance of the axles of a ground vehicle
    turning_radius: float = 0.0  # smallest turning radius of a ground vehicle; 0: the vehicle turns on the spot
    reverse: bool = True  # whether a ground vehicle may drive in reverse
    error: float = 0.0  # largest distance of the vehicle from its commanded position: tracking and position errors
    seed: int | None = None  # random seed; with `seed` and `iterations`, equal questions have equal answers
    iterations: int | None = None  # limit of a planner's work in iterations, in place of a limit in seconds

    @property
    def kept(self) -> float:
        """Distance (m) that planned paths keep from obstacles."""
        return self.radius + max(self.clearance, self.error)

    @property
    def least(self) -> float:
        """Least safe distance (m) of a path from obstacles: nearer, the vehicle may touch an obstacle."""
        return self.radius + self.error


class Scene(msgspec.Struct, frozen=True):
    """Obstacles at the time of a call, in addition to the fixed obstacles of the World.

    Grids and points count as infinitely high."""

    grids: tuple[Grid, ...] = ()
    points: tuple[Point, ...] = ()
    others: tuple[
        Path, ...
    ] = ()  # paths that other robots have published; a robot with a path of one point stays there

    @classmethod
    def of(cls, named: tuple[Grid, ...] | tuple[Point, ...], others: tuple[Path, ...]) -> Scene:
        """Return the scene with the obstacles `named` that a program passes, and the paths of other robots.

        `named` contains only Grids or only Points."""
        grids = tuple(g for g in named if isinstance(g, Grid))
        return cls(grids, tuple(p for p in named if isinstance(p, Point)), others)


class Planner(Protocol):
    """Interface of a path planner, built-in or written by a user.

    A planner is created once, with a World, and then called repeatedly."""

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """Return a path from `start` to `goal`, or () if there is none, within about `seconds`.

        The path includes `start` and `goal`, and is straight between its points. The caller checks the path before a
        robot follows it."""
        ...
