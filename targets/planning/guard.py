"""Keeps a body from being sent too near to what stands in the fleet file: for paths that no planner has checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Point, distance
from targets.planning.room import Room, fixed
from targets.planning.world import Path

HERE = 0.1  # m from the body within which a path's first points count as the place where it is


class Guard:
    """Checks ways of a body's reference point, which keeps a distance from each obstacle: the sum of `parts`, in
    metres by their names.

    A body that is nearer to an obstacle may leave: the first part of its way comes no nearer than it is, but for a
    twentieth. From there on the way keeps the largest distance that the body has had since it came too near, again but
    for a twentieth. So targets that creep towards an obstacle are refused."""

    def __init__(self, obstacles: Iterable[Obstacle], parts: Mapping[str, float]) -> None:
        self._standing = fixed(obstacles)
        self._kept = sum(parts.values())
        self._rule = " + ".join(f"{name} {value:g}" for name, value in parts.items())
        self._near: dict[str, float] = {}  # distances kept from obstacles that the body is too near to, by names

    def trouble(self, position: Point, path: Path) -> str:
        """Why the way from `position`, where the body is, along these points must not be gone, in words; "" when it
        may be. The test is exact."""
        if not self._standing:
            return ""
        here = Room(position)
        here.keep(self._standing, self._kept)
        self._near = {name: max(kept, self._near.get(name, 0.0)) for name, kept in here.lowered.items()}
        while len(path) > 1 and distance(position, path[0]) <= HERE:
            path = path[1:]
        return self._met(here, (position, *path[:1])) or self._met(self._beyond(here), (*path[:1], *path))

    def _beyond(self, here: Room) -> Room:
        """Return the obstacles, with the distances to keep, for a path after its first part."""
        if not self._near:
            return here
        found = Room(Point())
        found.keep_all(self._standing, lambda name: self._near.get(name, self._kept))
        return found

    def _met(self, here: Room, path: Path) -> str:
        for a, b in pairwise(path):
            away, name = here.nearest(a, b)
            if name:
                way = f"from ({a.x:.2f}, {a.y:.2f}, {a.z:.2f}) to ({b.x:.2f}, {b.y:.2f}, {b.z:.2f})"
                return f"the way {way} comes within {away:.2f} m of {name}; {self._kept:g} m are kept: {self._rule}"
        return ""
