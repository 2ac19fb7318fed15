"""What a planar lidar sees in a place with walls."""

from __future__ import annotations

import math
from collections.abc import Callable

from koordgen.runtime.values.points import Point, Scan

Wall = tuple[Point, Point]  # the corners of a box, metres, local ENU


def lidar(rays: int, range_: float, walls: tuple[Wall, ...]) -> Callable[[Point], tuple[tuple[Point, Scan], ...]]:
    """From a place, one scan of so many rays around it from east on, `range_` metres far. Robots are not seen."""
    angles = tuple([2 * math.pi * k / rays for k in range(rays)])

    def look(place: Point) -> tuple[tuple[Point, Scan], ...]:
        ranges = [min([_way(place, angle, wall) for wall in walls], default=math.inf) for angle in angles]
        return ((place, Scan(angles, tuple([min(range_, way) for way in ranges]), range_)),)

    return look


def _way(place: Point, angle: float, wall: Wall) -> float:
    """Metres along a ray to where it enters a box, by its slabs; infinite where it does not."""
    enter, leave = 0.0, math.inf
    lo, hi = wall
    for at, along, low, high in (
        (place.x, math.cos(angle), lo.x, hi.x),
        (place.y, math.sin(angle), lo.y, hi.y),
    ):
        if abs(along) < 1e-12:
            if not low <= at <= high:
                return math.inf
            continue
        ends = sorted(((low - at) / along, (high - at) / along))
        enter, leave = max(enter, ends[0]), min(leave, ends[1])
    return enter if enter <= leave else math.inf
