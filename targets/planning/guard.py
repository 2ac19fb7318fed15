"""Keeps a body from being sent through what stands in the fleet file: for paths that no planner has checked."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from koordgen.runtime.obstacles import Obstacle
from koordgen.runtime.values import Point
from targets.planning.room import Room, fixed
from targets.planning.world import Path


class Guard:
    """Of a body in a ball of `radius` metres around its reference point."""

    def __init__(self, obstacles: Iterable[Obstacle], radius: float) -> None:
        self._standing = fixed(obstacles)
        self._radius = radius

    def trouble(self, position: Point, path: Path) -> str:
        """Why the way from `position` along these points must not be gone, in words; "" when it may be. The test is
        exact. From where the body is nearer than its radius to an obstacle already, it may go where that is not nearer
        by more than a twentieth."""
        if not self._standing:
            return ""
        here = Room(position)
        here.keep(self._standing, self._radius)
        for a, b in pairwise((position, *path)):
            away, name = here.nearest(a, b)
            if name:
                way = f"from ({a.x:.2f}, {a.y:.2f}, {a.z:.2f}) to ({b.x:.2f}, {b.y:.2f}, {b.z:.2f})"
                return f"the way {way} comes within {away:.2f} m of {name}; the body's radius is {self._radius:g} m"
        return ""
