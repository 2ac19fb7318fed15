"""Check of commanded paths, which no planner has checked, against the fleet file's obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Point, distance
from targets.planning.room import Room, fixed
from targets.planning.world import Path

HERE = 0.1  # m; points at the beginning of a path that are within this distance of the vehicle are skipped


class Guard:
    """Check of the paths of a vehicle's reference point.

    The distance to keep from obstacles is the sum of `parts` (m, by name).

    A vehicle that is already nearer to an obstacle may leave this obstacle. On the first leg of its path, it must keep
    95 % of its present distance. On later legs, it must keep 95 % of the largest distance that it has had since it came
    too near. So targets that creep towards an obstacle are refused."""

    def __init__(self, obstacles: Iterable[Obstacle], parts: Mapping[str, float]) -> None:
        self._standing = fixed(obstacles)
        self._kept = sum(parts.values())
        self._rule = " + ".join(f"{name} {value:g}" for name, value in parts.items())
        self._near: dict[str, float] = {}  # reduced distances to keep from obstacles that are too near, by name

    def trouble(self, position: Point, path: Path) -> str:
        """Return the reason why a path is refused, in words; "" if the path may be followed.

        The path leads from the vehicle's `position` along the points `path`. The test is exact."""
        if not self._standing:
            return ""
        here = Room(position)
        here.keep(self._standing, self._kept)
        self._near = {name: max(kept, self._near.get(name, 0.0)) for name, kept in here.lowered.items()}
        while len(path) > 1 and distance(position, path[0]) <= HERE:
            path = path[1:]
        return self._met(here, (position, *path[:1])) or self._met(self._beyond(here), (*path[:1], *path))

    def _beyond(self, here: Room) -> Room:
        """Return the obstacles for the legs after the first leg of a path, with the distances to keep."""
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
                return f"the path {way} comes within {away:.2f} m of {name}; {self._kept:g} m are kept: {self._rule}"
        return ""
