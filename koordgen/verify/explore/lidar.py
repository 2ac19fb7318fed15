"""Model of a planar lidar that measures the distances to walls."""

from __future__ import annotations

import math
from collections.abc import Callable

from koordgen.runtime.values.points import Point, Scan

Wall = tuple[Point, Point]  # opposite corners of a box, in metres in the local ENU frame


def lidar(rays: int, range_: float, walls: tuple[Wall, ...]) -> Callable[[Point], tuple[tuple[Point, Scan], ...]]:
    """Return a function that computes the scan of a lidar from the lidar's position.

    A scan has `rays` rays at equal angles, counter-clockwise from east, of at most `range_` metres. The lidar sees the
    walls, but no robots."""
    angles = tuple([2 * math.pi * k / rays for k in range(rays)])

    def look(place: Point) -> tuple[tuple[Point, Scan], ...]:
        ranges = [min([_ray_distance(place, angle, wall) for wall in walls], default=math.inf) for angle in angles]
        return ((place, Scan(angles, tuple([min(range_, way) for way in ranges]), range_)),)

    return look


def _ray_distance(place: Point, angle: float, wall: Wall) -> float:
    """Return the distance in metres from `place` to a wall along a ray, by the slab method.

    Returns infinity if the ray misses the wall."""
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
