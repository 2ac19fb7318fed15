"""Distance of a line segment from a triangle mesh, exact but for rounding, vectorised with numpy.

The distance of a segment from a triangle is 0 if the segment passes through the triangle. Otherwise it is the least of
these distances: of the segment from the three sides, and of each end of the segment from the triangle's plane, if the
end's projection onto the plane is inside the triangle. Each of them is the distance between a point of the segment and
a point of the triangle, computed as in `koordgen.runtime.values.geometry`. Up to FEW triangles are measured one by one,
which is then faster than numpy.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.obstacles import Mesh
from koordgen.runtime.values.points import Point

FEW = 12  # up to this number of triangles, a loop over the triangles is faster than numpy

Array = NDArray[np.float64]


class Surface:
    """Triangle mesh prepared for distance queries. `low`, `high`: corners of its bounding box."""

    def __init__(self, mesh: Mesh) -> None:
        vertices = np.array([(p.x, p.y, p.z) for p in mesh.vertices])
        self._corners: Array = vertices[np.array(mesh.faces, dtype=np.intp)]  # shape: (faces, 3 corners, 3 axes)
        self._low, self._high = self._corners.min(axis=1), self._corners.max(axis=1)
        self.low = Point(*map(float, self._low.min(axis=0)))
        self.high = Point(*map(float, self._high.max(axis=0)))
        self._triangles = [Triangle(*(mesh.vertices[i] for i in face)) for face in mesh.faces]

    def distance(self, a: Point, b: Point, within: float = math.inf) -> float:
        """Return the distance (m) of the segment ab from the surface.

        If the distance is more than `within`, return any value above `within`, possibly infinity."""
        start, end = np.array((a.x, a.y, a.z)), np.array((b.x, b.y, b.z))
        low, high = np.minimum(start, end) - within, np.maximum(start, end) + within
        near = ((self._low <= high) & (self._high >= low)).all(axis=1)
        found = np.flatnonzero(near)
        if len(found) <= FEW:
            return min((self._triangles[i].distance(a, b, within) for i in found), default=math.inf)
        return _least(self._corners[found], start, end - start)


class Triangle:
    """Single triangle: its corners, and its plane, which is the set of places p with normal . p = offset."""

    def __init__(self, a: Point, b: Point, c: Point) -> None:
        self._corners = (a, b, c)
        u, v = b - a, c - a
        normal = Point(u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x)
        square = _inner(normal, normal)
        self._normal = normal / math.sqrt(square) if square > 0 else None  # None without area
        self._offset = _inner(self._normal, a) if self._normal is not None else 0.0

    def distance(self, a: Point, b: Point, within: float) -> float:
        """Return the distance (m) of the segment ab from the triangle.

        If the distance is more than `within`, return any value above `within`, possibly infinity."""
        p, q, r = self._corners
        normal, best = self._normal, math.inf
        if normal is not None:
            heights = _inner(normal, a) - self._offset, _inner(normal, b) - self._offset
            if min(heights) > within or max(heights) < -within:
                return math.inf
            through = heights[0] * heights[1] <= 0 and heights[0] != heights[1]
            if through and self._over(a + (b - a) * (heights[0] / (heights[0] - heights[1]))):
                return 0.0
            best = min((abs(h) for h, end in zip(heights, (a, b), strict=True) if self._over(end)), default=best)
        return min(best, segment_distance(p, q, a, b), segment_distance(q, r, a, b), segment_distance(r, p, a, b))

    def _over(self, place: Point) -> bool:
        """Return whether the projection of a place onto the triangle's plane is inside the triangle."""
        assert self._normal is not None
        corners = self._corners
        for p, q in zip(corners, (*corners[1:], corners[0]), strict=True):
            side, away = q - p, place - p
            turned = Point(
                side.y * away.z - side.z * away.y, side.z * away.x - side.x * away.z, side.x * away.y - side.y * away.x
            )
            if _inner(turned, self._normal) < 0:
                return False
        return True


def _inner(p: Point, q: Point) -> float:
    return p.x * q.x + p.y * q.y + p.z * q.z


def _least(corners: Array, start: Array, d: Array) -> float:
    """Return the least distance of triangles from the segment start + t d, 0 <= t <= 1.

    `corners`: the corners of the triangles, of shape (n, 3 corners, 3 coordinates)."""
    first, sides = corners, np.roll(corners, -1, axis=1) - corners
    best = float(_segments(start, d, first.reshape(-1, 3), sides.reshape(-1, 3)).min())
    normal = np.cross(sides[:, 0], sides[:, 1])
    square = _dot(normal, normal)
    flat = square > 0  # a triangle without area consists of its sides only
    if not flat.any():
        return math.sqrt(best)
    corners, sides, normal, square = corners[flat], sides[flat], normal[flat], square[flat]
    # The heights above the triangle's plane are multiplied by the normal's length.
    heights = [_dot(end - corners[:, 0], normal) for end in (start, start + d)]
    for height, end in zip(heights, (start, start + d), strict=True):
        over = _inside(corners, sides, normal, end - (height / square)[:, None] * normal)
        if over.any():
            best = min(best, float((height[over] ** 2 / square[over]).min()))
    rise = heights[0] - heights[1]
    through = (heights[0] * heights[1] <= 0) & (rise != 0)
    if through.any():
        share = heights[0][through] / rise[through]
        if _inside(corners[through], sides[through], normal[through], start + share[:, None] * d).any():
            return 0.0
    return math.sqrt(best)


def _inside(corners: Array, sides: Array, normal: Array, places: Array) -> NDArray[np.bool_]:
    """Return for each place whether it lies in its triangle.

    Each place lies in the plane of its triangle."""
    offset = places[:, None, :] - corners
    turned = np.einsum("nij,nj->ni", np.cross(sides, offset), normal)
    found: NDArray[np.bool_] = (turned >= 0).all(axis=1)
    return found


def _segments(start: Array, d: Array, first: Array, e: Array) -> Array:
    """Return the squared distances of the segment start + s d from the segments first + t e.

    The parameters s and t are between 0 and 1. The formulas are those of `koordgen.runtime.values.geometry`."""
    w = first - start
    n = np.cross(d, e)
    square = _dot(n, n)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.clip(np.where(square > 0, _dot(np.cross(w, e), n) / square, 0.0), 0.0, 1.0)
    inside = s[:, None] * d
    opposite = _foot(inside - w, e)[:, None] * e
    candidates = (
        _beyond(-w, e),
        _beyond(start + d - first, e),
        _beyond(w, d),
        _beyond(first + e - start, d),
        _beyond(w + opposite, d),
    )
    least: Array = np.minimum.reduce(candidates)
    return least


def _beyond(x: Array, d: Array) -> Array:
    """Return the squared distance of each place in `x` from the segment between the origin and `d`."""
    gap = x - _foot(x, d)[:, None] * d
    return _dot(gap, gap)


def _foot(x: Array, d: Array) -> Array:
    square = np.sum(d * d, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(square > 0, _dot(x, d) / square, 0.0)
    found: Array = np.clip(share, 0.0, 1.0)
    return found


def _dot(a: Array, b: Array) -> Array:
    found: Array = np.sum(a * b, axis=-1)
    return found
