"""Exact collision check of many poses at once: the car's outline against shapes, with numpy.

`shapes.Footprint.distance` measures one pose. A `ShapeTable` checks arrays of poses: it returns which poses keep the
required distance from every shape. It sorts shapes into square cells of the ground, and compares a pose only with the
shapes near its cell.
Metres, radians, local ENU.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from targets.car.planning.shapes import Bounds, Footprint, Shape

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

CELL, MOST_CELLS = 0.5, 250_000  # least width (m) of a cell; maximum number of cells
MOST_PAD = 0.05  # metres: largest `pad` that `ShapeTable.free` accepts


class ShapeTable:
    """Obstacles as arrays of shapes. Each shape has a distance (m) that the car's outline must keep from it."""

    def __init__(self, shapes: Sequence[Shape], kept: Sequence[float], body: Footprint, extent: Bounds) -> None:
        """`body`: the largest outline that will be checked. `extent`: area (m) in which all checked poses lie."""
        most = max((len(shape.core) for shape in shapes), default=1)
        cores = [(*shape.core, *shape.core[-1:] * (most - len(shape.core))) for shape in shapes]
        self._cores = np.array(cores, dtype=float).reshape(len(shapes), most, 2)
        self._bounds = np.array([shape.bounds for shape in shapes], dtype=float).reshape(-1, 4)
        self._radii = np.array([shape.radius for shape in shapes], dtype=float)
        self._upright = np.array([shape.upright for shape in shapes], dtype=bool)
        self._kept = np.array(kept, dtype=float)
        self._west, self._south, east, north = extent
        width, height = east - self._west, north - self._south
        self._size = max(CELL, math.sqrt(width * height / MOST_CELLS))
        self._columns, self._rows = math.floor(width / self._size) + 1, math.floor(height / self._size) + 1
        self._sort(math.hypot(body.length, body.width) / 2 + abs(_middle(body)) + MOST_PAD)

    def _sort(self, reach: float) -> None:
        """Record for each cell the shapes that an outline centred in it may touch: those within `reach` (m)."""
        owners, members = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
        for number, ((west, south, east, north), kept) in enumerate(zip(self._bounds, self._kept, strict=True)):
            away = reach + kept
            columns = self._range(west - away - self._west, east + away - self._west, self._columns)
            rows = self._range(south - away - self._south, north + away - self._south, self._rows)
            owners.append(np.add.outer(rows * self._columns, columns).ravel())
            members.append(np.full(len(owners[-1]), number))
        cells = np.concatenate(owners)
        self._members = np.concatenate(members)[np.argsort(cells, kind="stable")]
        self._counts = np.bincount(cells, minlength=self._columns * self._rows)
        self._firsts = np.cumsum(self._counts) - self._counts

    def _range(self, low: float, high: float, count: int) -> Indices:
        begin, end = math.floor(low / self._size), math.floor(high / self._size) + 1
        return np.arange(min(max(begin, 0), count), min(max(end, 0), count))

    def lowered(self, kept: Sequence[float]) -> ShapeTable:
        """Return a table of these shapes with other distances (m). No distance may be larger than in this table."""
        found = ShapeTable.__new__(ShapeTable)
        found.__dict__ |= self.__dict__
        found._kept = np.array(kept, dtype=float)
        return found

    def free(self, body: Footprint, x: Floats, y: Floats, yaw: Floats, pad: float) -> Mask:
        """Return for each pose whether the outline `body` keeps its distance, plus `pad` metres, from every shape."""
        free = np.ones(len(x), dtype=bool)
        pose, shape = self._near(x, y)
        if not len(pose):
            return free
        c, s = np.cos(yaw), np.sin(yaw)
        px, py = (x + _middle(body) * c)[pose], (y + _middle(body) * s)[pose]
        bounds, away = self._bounds[shape], self._kept[shape] + pad
        dx = np.maximum(np.maximum(bounds[:, 0] - px, px - bounds[:, 2]), 0.0)
        dy = np.maximum(np.maximum(bounds[:, 1] - py, py - bounds[:, 3]), 0.0)
        close = np.flatnonzero(dx * dx + dy * dy < (away + math.hypot(body.length, body.width) / 2) ** 2)
        pose, shape, away = pose[close], shape[close], away[close] + self._radii[shape[close]]
        upright = self._upright[shape]
        for some, measure, places in ((upright, _near_box, self._bounds), (~upright, _near_polygon, self._cores)):
            pairs = np.flatnonzero(some)
            if len(pairs):
                at = pose[pairs]
                hit = measure(body, places[shape[pairs]], (x[at], y[at], c[at], s[at]), away[pairs])
                free[at[hit]] = False
        return free

    def _near(self, x: Floats, y: Floats) -> tuple[Indices, Indices]:
        """Return pairs as two arrays: each pose's index, with the index of each shape of its cell."""
        column = np.minimum(np.maximum((x - self._west) / self._size, 0), self._columns - 1).astype(np.intp)
        row = np.minimum(np.maximum((y - self._south) / self._size, 0), self._rows - 1).astype(np.intp)
        cell = row * self._columns + column
        counts = self._counts[cell]
        pose = np.repeat(np.arange(len(x)), counts)
        before = self._firsts[cell] - np.cumsum(counts) + counts
        return pose, self._members[np.arange(len(pose)) + np.repeat(before, counts)]


Poses = tuple[Floats, Floats, Floats, Floats]  # x, y, cosine of yaw, sine of yaw


def _middle(body: Footprint) -> float:
    return body.length / 2 - body.overhang


def _near_box(body: Footprint, boxes: Floats, poses: Poses, away: Floats) -> Mask:
    """Return for each pair whether the outline overlaps an axis-parallel box, or is nearer to it than `away` metres.

    This special case of `_near_polygon` exists for speed: most of the time of a search is spent on boxes."""
    front, back, half = body.front, -body.overhang, body.width / 2
    x, y, c, s = (of[:, None] for of in poses)
    dx, dy = boxes[:, (0, 2, 2, 0)] - x, boxes[:, (1, 1, 3, 3)] - y
    u, v = c * dx + s * dy, c * dy - s * dx  # corners of the box in the frame of the outline
    apart = (u.min(axis=1) > front) | (u.max(axis=1) < back) | (v.min(axis=1) > half) | (v.max(axis=1) < -half)
    du, dv = u - np.minimum(np.maximum(u, back), front), v - np.minimum(np.maximum(v, -half), half)
    least = (du * du + dv * dv).min(axis=1)
    ahead, aside = np.array((back, front, front, back)), np.array((-half, -half, half, half))
    px, py = x + c * ahead - s * aside, y + s * ahead + c * aside  # corners of the outline
    west, south, east, north = boxes.T
    apart |= (px.min(axis=1) > east) | (px.max(axis=1) < west) | (py.min(axis=1) > north) | (py.max(axis=1) < south)
    dx = px - np.minimum(np.maximum(px, west[:, None]), east[:, None])
    dy = py - np.minimum(np.maximum(py, south[:, None]), north[:, None])
    least = np.minimum(least, (dx * dx + dy * dy).min(axis=1))
    near: Mask = ~apart | (least < away * np.abs(away))
    return near


def _near_polygon(body: Footprint, cores: Floats, poses: Poses, away: Floats) -> Mask:
    """Return for each pair whether the outline overlaps a convex polygon, or is nearer to it than `away` metres.

    The polygon's corners are counter-clockwise; some may be equal. If two convex polygons do not overlap, their
    distance is that of a corner of one from the other, so only corners are measured."""
    front, back, half = body.front, -body.overhang, body.width / 2
    x, y, c, s = (of[:, None] for of in poses)
    dx, dy = cores[:, :, 0] - x, cores[:, :, 1] - y
    u, v = c * dx + s * dy, c * dy - s * dx  # corners of the polygon in the frame of the outline
    apart = (u.min(axis=1) > front) | (u.max(axis=1) < back) | (v.min(axis=1) > half) | (v.max(axis=1) < -half)
    du, dv = u - np.minimum(np.maximum(u, back), front), v - np.minimum(np.maximum(v, -half), half)
    least = (du * du + dv * dv).min(axis=1)
    ahead, aside = np.array((back, front, front, back)), np.array((-half, -half, half, half))
    for i, j in pairwise((*range(cores.shape[1]), 0)):
        eu, ev = (u[:, j] - u[:, i])[:, None], (v[:, j] - v[:, i])[:, None]
        ru, rv = ahead - u[:, i, None], aside - v[:, i, None]
        square = eu * eu + ev * ev
        share = np.minimum(np.maximum((ru * eu + rv * ev) / np.where(square == 0.0, 1.0, square), 0.0), 1.0)
        du, dv = ru - share * eu, rv - share * ev
        least = np.minimum(least, (du * du + dv * dv).min(axis=1))
        apart |= (ru * ev - rv * eu).min(axis=1) > 0.0
    near: Mask = ~apart | (least < away * np.abs(away))
    return near
