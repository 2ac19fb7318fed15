"""Distance of two paths: the least distance of segments in space, exact except for rounding errors.

The safety of robots relies on this distance.

The squared distance of p + s d and r + t e is a convex function of (s, t) on the unit square. Its minimum is on the
square's rim, where an endpoint of one segment meets the other segment, or at the one inner point where the line between
the points is perpendicular to both. All five candidates are computed, and each is the distance of two points that do
lie on the segments: whatever rounding does to the position, no candidate is below the true distance by more than its
own rounding. Nearly parallel segments break the textbook formula, whose denominator (d.d)(e.e) - (d.e)^2 is then
nothing but rounding. Here the inner point comes from the cross product, which keeps its digits, and is moved to the
foot of the perpendicular on one segment and back on the other: an error along a common direction has almost no effect.

The error is at most 1e-15 of the largest difference between coordinates of the four points, plus 1e-75 m; measured
against exact arithmetic in tests/runtime/values/test_geometry.py."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

from koordgen.runtime.values.points import Point, no_nan

LIMIT = 1e75  # metres; beyond it fourth powers of lengths overflow

Vector = tuple[float, float, float]


class Segment(NamedTuple):
    """Segment from `start` to `end`; `low` and `high` are the corners of its bounding box."""

    start: Vector
    end: Vector
    low: Vector
    high: Vector


def segment_distance(p: Point, q: Point, r: Point, s: Point) -> float:
    """Return the least distance (m) of two segments pq and rs; either may be a point.

    Raises ValueError for a coordinate that is NaN or beyond LIMIT."""
    return path_distance((p, q), (r, s))


def path_distance(a: tuple[Point, ...], b: tuple[Point, ...]) -> float:
    """Return the least distance (m) of two paths.

    Polylines through their points in order, or single points.

    inf if one has no points. Raises ValueError for a coordinate that is NaN or beyond LIMIT."""
    others = _segments(b)
    best = math.inf
    for mine in _segments(a):
        for other in others:
            if _gap(mine, other) < best:  # skip segments that are far apart, which most are
                best = min(best, _squared(mine, other))
    return math.sqrt(best)


def clear(path: tuple[Point, ...], paths: Iterable[tuple[Point, ...]], eps: float) -> bool:
    """Return whether a path stays more than eps metres away from all others.

    True for a path without points.

    Raises ValueError for a coordinate that is NaN or beyond LIMIT, NotANumber if eps is NaN."""
    no_nan(eps)
    return all(path_distance(path, other) > eps for other in paths)


def _segments(path: tuple[Point, ...]) -> list[Segment]:
    points = [_vector(p) for p in path]
    return [_segment(p, q) for p, q in pairwise(points if len(points) != 1 else points * 2)]


def _vector(p: Point) -> Vector:
    if not (abs(p.x) <= LIMIT and abs(p.y) <= LIMIT and abs(p.z) <= LIMIT):
        raise ValueError(f"no distance can be told from ({p.x}, {p.y}, {p.z})")
    return p.x, p.y, p.z


def _segment(p: Vector, q: Vector) -> Segment:
    low = min(p[0], q[0]), min(p[1], q[1]), min(p[2], q[2])
    high = max(p[0], q[0]), max(p[1], q[1]), max(p[2], q[2])
    return Segment(p, q, low, high)


def _gap(a: Segment, b: Segment) -> float:
    """Return the squared distance of two segments' bounding boxes, a lower bound of the segments' own."""
    _, _, (ax, ay, az), (bx, by, bz) = a
    _, _, (cx, cy, cz), (dx, dy, dz) = b
    gap = max(ax - dx, cx - bx, 0.0), max(ay - dy, cy - by, 0.0), max(az - dz, cz - bz, 0.0)
    return _dot(gap, gap)


def _squared(a: Segment, b: Segment) -> float:
    (p, q, _, _), (r, s, _, _) = a, b
    # only differences from here on: distance from the origin adds no error
    d, e, w = _minus(q, p), _minus(s, r), _minus(r, p)
    rim = min(
        _beyond(_minus(p, r), e),
        _beyond(_minus(q, r), e),
        _beyond(w, d),
        _beyond(_minus(s, p), d),
    )
    n = _cross(d, e)
    square = _dot(n, n)
    if square == 0:
        return rim  # parallel, or a point: the minimum is on the rim
    inside = _times(_clip(_dot(_cross(w, e), n) / square), d)
    opposite = _times(_foot(_minus(inside, w), e), e)
    return min(rim, _beyond(_plus(w, opposite), d))


def _beyond(x: Vector, d: Vector) -> float:
    """Return the squared distance of the point x from the segment from the origin to d."""
    gap = _minus(x, _times(_foot(x, d), d))
    return _dot(gap, gap)


def _foot(x: Vector, d: Vector) -> float:
    """Return the parameter, 0 to 1, of the point nearest to x on the segment from the origin to d."""
    square = _dot(d, d)
    return _clip(_dot(x, d) / square) if square else 0.0


def _clip(t: float) -> float:
    return min(max(t, 0.0), 1.0)


def _times(t: float, a: Vector) -> Vector:
    return t * a[0], t * a[1], t * a[2]


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
