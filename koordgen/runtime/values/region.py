"""Regions of space, the right operands of `in`. Metres, local ENU."""

from __future__ import annotations

from typing import NamedTuple

from koordgen.runtime.values.points import Point, distance, no_nan


class Rect(NamedTuple):
    """Axis-aligned box between two corners in any order, faces included."""

    a: Point
    b: Point

    def __contains__(self, p: object) -> bool:
        a, b = self
        return isinstance(p, Point) and (
            min(a.x, b.x) <= p.x <= max(a.x, b.x)
            and min(a.y, b.y) <= p.y <= max(a.y, b.y)
            and min(a.z, b.z) <= p.z <= max(a.z, b.z)
        )


class Ball(NamedTuple):
    """Points at most `radius` away from `center`.

    Raises NotANumber if the distance is NaN, for infinite points."""

    center: Point
    radius: float

    def __contains__(self, p: object) -> bool:
        return isinstance(p, Point) and no_nan(distance(p, self.center)) <= self.radius
