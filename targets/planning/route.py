"""Remaining part of a commanded path: the present goal, and the goals after it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.points import Point

AS_NEAR = 0.05  # metres; a later leg counts as the nearest leg only if it is nearer to the robot by more than this


def commanded(actuators: Mapping[str, Any], modules: Iterable[str]) -> list[tuple[Point, ...]]:
    """Return the paths that a program commands through these modules' actuators.

    A target counts as a path of one point."""
    found: list[tuple[Point, ...]] = []
    for module in modules:
        if (name := f"{module}.target") in actuators:
            found.append((actuators[name],))
        if (name := f"{module}.path") in actuators:
            found.append(actuators[name])
    return found


def passed(points: tuple[Point, ...], position: Point) -> int:
    """Return how many points of a path a robot has passed: the points before the end of its nearest leg.

    If several legs are about equally near to the robot (AS_NEAR), the earliest leg counts."""
    away = [segment_distance(position, position, a, b) for a, b in pairwise(points)]
    return 1 + next(i for i, d in enumerate(away) if d <= min(away) + AS_NEAR) if away else 0


class Route:
    """Commanded path of one robot. `goal`: the present goal; None if nothing is commanded.

    A single target is a path of one point."""

    def __init__(self) -> None:
        self.goal: Point | None = None
        self._commanded: tuple[Point, ...] = ()
        self._ahead: tuple[Point, ...] = ()

    def follow(self, points: tuple[Point, ...]) -> bool:
        """Follow these points from now on; without points, clear the goal.

        Return False, and change nothing, if the robot follows these points already."""
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
        """Skip `count` goals, but never the last goal of the path."""
        for _ in range(count):
            self.passed()

    def passed(self) -> Point | None:
        """Advance to the next goal if the path has a further goal. Return the goal that is then present."""
        if self._ahead:
            self.goal, self._ahead = self._ahead[0], self._ahead[1:]
        return self.goal
