"""What is left of a commanded path: the goal to make for now, and those behind it."""

from __future__ import annotations

from koordgen.runtime.values import Point


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
        """Whether nothing comes behind the present goal."""
        return not self._ahead

    def passed(self) -> Point | None:
        """The present goal is behind the robot: make for the next, which is returned; the last one stays."""
        if self._ahead:
            self.goal, self._ahead = self._ahead[0], self._ahead[1:]
        return self.goal
