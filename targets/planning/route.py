"""What is left of a commanded path: the goal to make for now, and those behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.points import Point

AS_NEAR = 0.05  # metres by which a later leg must be nearer to a robot than an earlier one


def commanded(actuators: Mapping[str, Any], modules: Iterable[str]) -> list[tuple[Point, ...]]:
    """Return the paths among written actuators of these modules; a target is a path of one point."""
    found: list[tuple[Point, ...]] = []
    for module in modules:
        if (name := f"{module}.target") in actuators:
            found.append((actuators[name],))
        if (name := f"{module}.path") in actuators:
            found.append(actuators[name])
    return found


def passed(points: tuple[Point, ...], position: Point) -> int:
    """How many points of a path are behind a robot that was somewhere on the path: those before the nearest leg's end.
    Of legs that are as near, the earliest."""
    away = [segment_distance(position, position, a, b) for a, b in pairwise(points)]
    return 1 + next(i for i, d in enumerate(away) if d <= min(away) + AS_NEAR) if away else 0


class Route:
    """`goal` is None when nothing was commanded. A single target is a path of one point."""

    def __init__(self) -> None:
        self.goal: Point | None = None
        self._commanded: tuple[Point, ...] = ()
        self._ahead: tuple[Point, ...] = ()

    def take(self, points: tuple[Point, ...]) -> bool:
        """Follow these instead. False when they are being followed already, which changes nothing; none means: stay."""
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
        """So many goals are behind the robot; the last one stays."""
        for _ in range(count):
            self.passed()

    def passed(self) -> Point | None:
        """The present goal is behind the robot: make for the next, which is returned; the last one stays."""
        if self._ahead:
            self.goal, self._ahead = self._ahead[0], self._ahead[1:]
        return self.goal
