"""Distance of a line segment from a solid obstacle, exact but for rounding, without sampling.

Along a segment, parametrised by t in [0, 1], the distance to a convex body is a convex function. For a box, the square
of the distance consists of at most seven quadratics. For an upright cylinder, the pieces of the distance are linear, or
the distance to a line, or smooth. In a smooth piece, bisection finds the zero of the derivative to the last bit.

The result is the distance of a point on the segment from the body. So it is below the true distance by no more than a
rounding error. If the segment enters the body, the distance is 0. Lengths are in metres, positions in local ENU.
`mesh.py` measures meshes.
"""

from __future__ import annotations

import math
from itertools import pairwise

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.obstacles import Block, Cylinder, Sphere
from koordgen.runtime.values.points import Point

BISECTIONS = 60  # bisection steps of an interval within [0, 1]: more than the bits of a float's mantissa

Solid = Block | Sphere | Cylinder


def solid_distance(body: Solid, a: Point, b: Point) -> float:
    """Return the least distance (m) of the segment ab from a body; 0 if the segment touches the body."""
    match body:
        case Block(lo, hi):
            return _block(lo, hi, a, b)
        case Sphere(centre, radius):
            return max(0.0, segment_distance(centre, centre, a, b) - radius)
        case Cylinder():
            return _cylinder(body, a, b)


def _block(lo: Point, hi: Point, a: Point, b: Point) -> float:
    axes = ((lo.x, hi.x, a.x, b.x - a.x), (lo.y, hi.y, a.y, b.y - a.y), (lo.z, hi.z, a.z, b.z - a.z))
    places = [0.0, 1.0]
    for low, high, p, d in axes:
        if d:
            places += [t for t in ((low - p) / d, (high - p) / d) if 0.0 < t < 1.0]
    places.sort()
    best = min([_from_block(axes, t) for t in places])
    for begin, end in pairwise(places):
        middle = (begin + end) / 2  # from `begin` to `end`, the nearest faces of the block stay the same
        product = square = 0.0
        for low, high, p, d in axes:
            x = p + middle * d
            if not low <= x <= high:
                product += (p - (low if x < low else high)) * d
                square += d * d
        if square and begin < (t := -product / square) < end:
            best = min(best, _from_block(axes, t))
    return math.sqrt(best)


def _from_block(axes: tuple[tuple[float, float, float, float], ...], t: float) -> float:
    """Return the squared distance of the segment's place at `t` from the block."""
    total = 0.0
    for low, high, p, d in axes:
        x = p + t * d
        if x < low:
            total += (low - x) ** 2
        elif x > high:
            total += (x - high) ** 2
    return total


def _cylinder(body: Cylinder, a: Point, b: Point) -> float:
    x, y, z = a.x - body.base.x, a.y - body.base.y, a.z - body.base.z
    dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
    radius, height = body.radius, body.height

    def at(t: float) -> float:
        outside = math.hypot(x + t * dx, y + t * dy) - radius
        up = z + t * dz
        return math.hypot(max(0.0, outside), max(0.0, -up, up - height))

    def rising(t: float) -> bool:
        """Return whether the distance grows with t.

        The place at t is beside the cylinder, and also above or below it."""
        px, py, up = x + t * dx, y + t * dy, z + t * dz
        axis = math.hypot(px, py)
        return (axis - radius) / axis * (px * dx + py * dy) + (up if up < 0 else up - height) * dz > 0

    places = [0.0, 1.0]
    if dz:
        places += [-z / dz, (height - z) / dz]
    square = dx * dx + dy * dy
    if square:
        nearest = -(x * dx + y * dy) / square
        aside = (x * dy - y * dx) ** 2 / square  # squared distance of the line from the axis
        places.append(nearest)
        if aside < radius * radius:
            half = math.sqrt((radius * radius - aside) / square)
            places += [nearest - half, nearest + half]
    places = sorted(t for t in places if 0.0 <= t <= 1.0)
    best = min([at(t) for t in places])
    for begin, end in pairwise(places):
        middle = (begin + end) / 2
        beside = math.hypot(x + middle * dx, y + middle * dy) > radius
        if best > 0.0 and beside and not 0.0 <= z + middle * dz <= height:
            for _ in range(BISECTIONS):
                middle = (begin + end) / 2
                begin, end = (begin, middle) if rising(middle) else (middle, end)
            best = min(best, at((begin + end) / 2))
    return best
