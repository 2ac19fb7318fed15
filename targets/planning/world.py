"""What planners are made from and asked: see docs/explanation/planners.md, which is for those who write their own.

Metres, local ENU. All of it is frozen and goes through a pipe as MessagePack.
"""

from __future__ import annotations

from typing import Protocol

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Grid, Point

Path = tuple[Point, ...]


class World(msgspec.Struct, frozen=True):
    """What does not change: where the body may be, what stands there, and facts of the body. Planned paths are those of
    its reference point."""

    arena: Box  # the reference point stays inside
    obstacles: tuple[Obstacle, ...] = ()  # those of the fleet file
    clearance: float = 0.0  # kept between the body and all else
    radius: float = 0.0  # of the ball around the reference point in which the body is
    flies: bool = True  # False: it moves in the plane z = 0
    footprint: tuple[float, float] = (0.0, 0.0)  # length and width of a vehicle on the ground
    overhang: float = 0.0  # how much of that length is behind its rear axle, whose middle is the reference point
    height: float = 0.0  # of such a vehicle: what stands or hangs above is not in its way
    wheelbase: float = 0.0
    turning_radius: float = 0.0  # the smallest; 0: it turns on the spot
    reverse: bool = True  # whether such a vehicle goes backwards, too
    error: float = 0.0  # how far the body may be from where it is sent: errors of tracking and of its position
    seed: int | None = None  # with `iterations`, an answer depends on nothing but the question
    iterations: int | None = None  # bounds the work instead of `seconds`

    @property
    def kept(self) -> float:
        """The distance of planned paths from obstacles."""
        return self.radius + max(self.clearance, self.error)

    @property
    def least(self) -> float:
        """The distance from obstacles below which the body may touch one."""
        return self.radius + self.error


class Scene(msgspec.Struct, frozen=True):
    """What stands there at the moment of a call. Grids and points are as high as anything."""

    grids: tuple[Grid, ...] = ()
    points: tuple[Point, ...] = ()
    others: tuple[Path, ...] = ()  # the paths that other robots have published; a single point stays there

    @classmethod
    def of(cls, named: tuple[Grid, ...] | tuple[Point, ...], others: tuple[Path, ...]) -> Scene:
        """Return what a program names as obstacles, all Grids or all Points, and the others' paths."""
        grids = tuple(g for g in named if isinstance(g, Grid))
        return cls(grids, tuple(p for p in named if isinstance(p, Point)), others)


class Planner(Protocol):
    """A planner of the user's own needs no more than this; it is made once, with a World, and asked again and again."""

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        """A path from `start` to `goal`, both included, straight from each point to the next, within about `seconds`;
        () when there is none. It is checked before anybody follows it."""
        ...
