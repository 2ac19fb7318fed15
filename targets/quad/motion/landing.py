"""Choice of a landing place that is not on another robot.

Other robots publish their positions or paths. A quad that would land on a published path first moves aside to the
nearest free place, for SECONDS at most. Lengths are in metres, times in seconds, positions in local ENU.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol

from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.points import Point
from targets.planning.world import Path
from targets.quad.motion.reference import STANDING
from targets.quad.motion.trajectory import norm

# Candidate places lie on rings around the quad: the radius of the largest ring, and the distance between rings, in m.
FARTHEST, STEP = 1.6, 0.2
DIRECTIONS = 16  # number of candidate landing places on each ring around the quad
TURN = 2.4  # rad between the first directions of robots with successive pids, so that they choose different places
SECONDS = 8.0  # seconds that the flight to another landing place may take; after that, the quad lands where it is
THERE = 0.15  # m; horizontal distance from the chosen place within which a slow quad begins to land


class Surroundings(Protocol):
    """Interface to the geofence and the obstacles around the quad."""

    def may_land(self, position: Point, place: Point) -> bool:
        """Return whether geofence and obstacles allow the quad to fly straight to `place` and to land there."""
        ...


class Landing:
    """Landing place of one robot, horizontally at least `apart` metres from the paths of other robots."""

    def __init__(self, pid: int, apart: float, surroundings: Surroundings) -> None:
        self._pid, self._apart, self._surroundings = pid, apart, surroundings
        self._until: float | None = None  # latest time at which the landing begins; None before a place is chosen
        self._place: Point | None = None
        self._log_lines: list[str] = []

    def aside(self, position: Point, velocity: Point, others: dict[str, Path], now: float) -> Point | None:
        """Return the place to fly to before the landing, or None to land now at `position`.

        `others`: published paths by robot name. The first call chooses the place, and later calls keep it."""
        if self._until is None:
            self._until = now + SECONDS
            self._place = self._chosen(position, others)
        place = self._place
        if place is None or now > self._until:
            return None
        if math.hypot(position.x - place.x, position.y - place.y) <= THERE and norm(velocity) < STANDING:
            return None
        return place

    def _chosen(self, position: Point, others: dict[str, Path]) -> Point | None:
        below = [name for name, path in others.items() if self._is_below(path, position)]
        if not below:
            return None
        names = f"robot {', '.join(below)}"
        place = next((p for p in self._places(position) if self._is_free(position, p, others)), None)
        if place is None:
            self._log_lines.append(f"landing above a path of {names}: there is no free place within {FARTHEST:g} m")
        else:
            self._log_lines.append(f"{names} may be below: moving to ({place.x:.2f}, {place.y:.2f}) before the landing")
        return place

    def _is_below(self, path: Path, position: Point) -> bool:
        """Return whether the quad at `position` would land on this path of another robot.

        The path's lowest point must be more than apart / 4 below the quad, and its horizontal distance below `apart`.
        """
        lower = min(p.z for p in path) < position.z - self._apart / 4
        return lower and _from_above(path, position) < self._apart

    def _is_free(self, position: Point, place: Point, others: dict[str, Path]) -> bool:
        apart = all(_from_above(path, place) >= self._apart for path in others.values())
        return apart and self._surroundings.may_land(position, place)

    def _places(self, position: Point) -> Iterator[Point]:
        for ring in range(1, round(FARTHEST / STEP) + 1):
            for i in range(DIRECTIONS):
                turn = self._pid * TURN + math.tau * i / DIRECTIONS
                yield position + Point(math.cos(turn), math.sin(turn)) * (ring * STEP)

    def log_lines(self) -> list[str]:
        """Return log lines on the choice of a landing place since the last call."""
        told, self._log_lines = self._log_lines, []
        return told


def _from_above(path: Path, place: Point) -> float:
    """Return the horizontal distance of a place from a path."""
    return path_distance(tuple(Point(p.x, p.y) for p in path), (Point(place.x, place.y),))
