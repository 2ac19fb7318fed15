"""Regions of space, which stand on the right of `in`. Metres, local ENU."""

from __future__ import annotations

from typing import NamedTuple

from koordgen.runtime.values.points import Point, distance, no_nan


class Rect(NamedTuple):
    """The axis-parallel box between two corners, given in any order; its faces belong to it."""

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
    """The points at most `radius` away from `center`. NotANumber where the distance is none, of points at infinity."""

    center: Point
    radius: float

    def __contains__(self, p: object) -> bool:
        return isinstance(p, Point) and no_nan(distance(p, self.center)) <= self.radius
