"""Regions of space: a program writes `point in region`. Coordinates are metres in local ENU."""

from __future__ import annotations

from typing import NamedTuple

from koordgen.runtime.values.points import Point, distance, no_nan


class Rect(NamedTuple):
    """Axis-aligned box between two opposite corners in any order. Points on its faces are inside."""

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
    """Ball: all points at a distance of at most `radius` metres from `center`.

    `point in ball` raises NotANumber if the distance is NaN, as for infinite points."""

    center: Point
    radius: float

    def __contains__(self, p: object) -> bool:
        return isinstance(p, Point) and no_nan(distance(p, self.center)) <= self.radius
