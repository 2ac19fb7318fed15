"""Distance between two paths: the least distance between their segments in space, exact except for rounding errors.

The safety of robots relies on this distance.

The points of two segments are p + s d and r + t e with s and t from 0 to 1. Their squared distance is a convex function
of (s, t) on the unit square. The minimum is on the rim of the square or inside. On the rim, an endpoint of one segment
is nearest to the other segment: four candidates. Inside, the line between the two points is perpendicular to both
segments: one candidate. All five candidates are computed. Each candidate is the distance between a point of one segment
and a point of the other, so rounding cannot make a candidate noticeably smaller than the true distance.

The textbook formula for the inner candidate fails for nearly parallel segments, because its denominator
(d.d)(e.e) - (d.e)^2 then consists of rounding errors. This module computes the inner point with the cross product,
which keeps its digits. Then the point is moved to the foot of the perpendicular on the other segment, and from there
back to the first segment. So an error along a common direction of the segments has almost no effect.

The error is at most 1e-15 of the largest difference between coordinates of the four points, plus 1e-75 m.
tests/runtime/values/test_geometry.py measures the error with exact arithmetic."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

from koordgen.runtime.values.points import Point, no_nan

LIMIT = 1e75  # largest valid coordinate in metres: fourth powers of larger lengths overflow

Vector = tuple[float, float, float]


class Segment(NamedTuple):
    """Segment from `start` to `end`. `low` and `high` are the corners of the segment's bounding box."""

    start: Vector
    end: Vector
    low: Vector
    high: Vector


def segment_distance(p: Point, q: Point, r: Point, s: Point) -> float:
    """Return the least distance in metres between the segments pq and rs. A segment may be a single point.

    Raises ValueError for a coordinate that is NaN or beyond LIMIT."""
    return path_distance((p, q), (r, s))


def path_distance(a: tuple[Point, ...], b: tuple[Point, ...]) -> float:
    """Return the least distance in metres between two paths; inf if a path has no points.

    A path is the polyline through its points in their order, or a single point. Raises ValueError for a coordinate that
    is NaN or beyond LIMIT."""
    others = _segments(b)
    best = math.inf
    for mine in _segments(a):
        for other in others:
            if _gap(mine, other) < best:  # most pairs of segments are too far apart and are skipped
                best = min(best, _squared(mine, other))
    return math.sqrt(best)


def clear(path: tuple[Point, ...], paths: Iterable[tuple[Point, ...]], eps: float) -> bool:
    """Return whether a path is more than eps metres away from all `paths`; True for a path without points.

    Raises ValueError for a coordinate that is NaN or beyond LIMIT, and NotANumber if eps is NaN."""
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
    """Return the squared distance between the bounding boxes of two segments.

    The squared distance between the segments is at least as large."""
    _, _, (ax, ay, az), (bx, by, bz) = a
    _, _, (cx, cy, cz), (dx, dy, dz) = b
    gap = max(ax - dx, cx - bx, 0.0), max(ay - dy, cy - by, 0.0), max(az - dz, cz - bz, 0.0)
    return _dot(gap, gap)


def _squared(a: Segment, b: Segment) -> float:
    (p, q, _, _), (r, s, _, _) = a, b
    # The code below uses only differences of points, so a large distance from the origin adds no error.
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
        return rim  # parallel segments, or a point: a candidate on the rim is the minimum
    inside = _times(_clip(_dot(_cross(w, e), n) / square), d)
    opposite = _times(_foot(_minus(inside, w), e), e)
    return min(rim, _beyond(_plus(w, opposite), d))


def _beyond(x: Vector, d: Vector) -> float:
    """Return the squared distance between the point x and the segment from the origin to d."""
    gap = _minus(x, _times(_foot(x, d), d))
    return _dot(gap, gap)


def _foot(x: Vector, d: Vector) -> float:
    """Return t from 0 to 1 such that t * d is the point nearest to x on the segment from the origin to d."""
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
