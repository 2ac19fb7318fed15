"""Remaining part of a commanded path: the present goal, and the goals after it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.points import Point

AS_NEAR = 0.05  # metres by which a later leg must be nearer to the robot to count as the nearest


def commanded(actuators: Mapping[str, Any], modules: Iterable[str]) -> list[tuple[Point, ...]]:
    """Return the paths commanded by writes to these modules' actuators; a target is a path of one point."""
    found: list[tuple[Point, ...]] = []
    for module in modules:
        if (name := f"{module}.target") in actuators:
            found.append((actuators[name],))
        if (name := f"{module}.path") in actuators:
            found.append(actuators[name])
    return found


def passed(points: tuple[Point, ...], position: Point) -> int:
    """Return how many points of a path a robot has passed: those before the end of the leg nearest to it.

    Of legs that are about equally near (AS_NEAR), the earliest counts."""
    away = [segment_distance(position, position, a, b) for a, b in pairwise(points)]
    return 1 + next(i for i, d in enumerate(away) if d <= min(away) + AS_NEAR) if away else 0


class Route:
    """Commanded path of one robot. `goal`: the present goal, None without a command.

    A single target is a path of one point."""

    def __init__(self) -> None:
        self.goal: Point | None = None
        self._commanded: tuple[Point, ...] = ()
        self._ahead: tuple[Point, ...] = ()

    def take(self, points: tuple[Point, ...]) -> bool:
        """Follow these points from now on; without points, stay.

        Return False, and change nothing, if they are being followed already."""
        if points == self._commanded and self.goal is not None:
            return False
        self._commanded = points
        self.goal, self._ahead = (points[0], points[1:]) if points else (None, ())
        return True

    @property
    def last(self) -> bool:
        """Return whether the present goal is the last one."""
        return not self._ahead

    def skip(self, count: int) -> None:
        """Skip `count` goals, but never the last one."""
        for _ in range(count):
            self.passed()

    def passed(self) -> Point | None:
        """Advance to the next goal, if there is one, and return the present goal."""
        if self._ahead:
            self.goal, self._ahead = self._ahead[0], self._ahead[1:]
        return self.goal
