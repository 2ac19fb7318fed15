"""What a planar lidar sees: how far it is in each direction to what stands there, in closed form.

Obstacles are cut at the lidar's height into line segments and circles; other robots stay what they are, boxes and
cylinders that may be tilted. For each of these only those rays are reckoned that may meet it, found by the angles
between which it is seen; all of these rays, of all lidars that look at once, are one array.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values import Point
from targets.sim.bodies import Vector
from targets.sim.rigid import Array, Mask, total

Index = NDArray[np.int64]
_SEAM = 1e-9  # of a segment's length by which it is longer, or rays would pass between two


@dataclass(frozen=True, slots=True)
class Eye:
    """A lidar: where it is (m), how many rays it has, evenly over the full turn and the first to the east, how far
    they go (m), and the number of the body that it is mounted on and does not see."""

    place: Vector
    rays: int
    range: float
    unseen: int = -1


@dataclass(frozen=True, slots=True)
class Bodies:
    """The other robots: centres (3, n), rotation matrices (3, 3, n), edges of the box or of the box around the upright
    cylinder (3, n), which of them are cylinders, how far each extends from its centre, and their numbers."""

    centres: Array
    turned: Array
    sizes: Array
    round: Mask
    reach: Array
    numbers: Index


@dataclass(frozen=True, slots=True)
class Slice:
    """What stands at one height: segments (n, 4) as x, y of both ends; circles (n, 3) as x, y and radius."""

    segments: Array
    circles: Array


class Scenery:
    """All that stands there and does not move."""

    def __init__(self) -> None:
        self._obstacles: list[Obstacle] = []
        self._last: tuple[float, Slice] | None = None

    def stand(self, obstacle: Obstacle) -> None:
        """One more."""
        self._obstacles.append(obstacle)
        self._last = None

    def cut(self, z: float) -> Slice:
        """At a height (m). That of the last call is kept: cars always ask for the same."""
        if self._last is None or self._last[0] != z:
            segments: list[tuple[float, float, float, float]] = []
            circles: list[Vector] = []
            for obstacle in self._obstacles:
                _cut(obstacle, z, segments, circles)
            self._last = z, Slice(np.array(segments).reshape(-1, 4), np.array(circles).reshape(-1, 3))
        return self._last[1]


def look(eyes: Sequence[Eye], scenery: Scenery, bodies: Bodies) -> list[Array]:
    """For each lidar how far (m) each of its rays goes until an obstacle or another body; infinite: beyond its range.
    The floor ends no ray, nor does a round thing that the lidar is inside of."""
    field = _Field(eyes)
    slices = [scenery.cut(eye.place[2]) for eye in eyes]
    _see_segments(field, slices)
    _see_circles(field, slices)
    _see_bodies(field, bodies)
    found = []
    for eye, first in zip(eyes, field.first, strict=True):
        ranges = field.nearest[first : first + eye.rays]
        ranges[ranges > eye.range] = np.inf
        found.append(ranges)
    return found


class _Field:
    """All rays of some lidars, one after the other, and how far each has got."""

    def __init__(self, eyes: Sequence[Eye]) -> None:
        self.eyes = eyes
        self.rays = np.array([eye.rays for eye in eyes], dtype=np.int64)
        self.range = np.array([eye.range for eye in eyes])
        self.first: Index = np.cumsum(self.rays) - self.rays
        angles = [_turn(eye.rays) for eye in eyes]
        self.ways = angles[0] if len(angles) == 1 else np.concatenate(angles, axis=1)
        self.nearest = np.full(self.ways.shape[1], np.inf)

    def spread(self, eye: Index, begin: Array, width: Array) -> tuple[Index, Index]:
        """The rays of lidars between the angles `begin` and `begin + width`, one more at each side: for each the
        number of the thing that is asked about, and its own."""
        each = self.rays[eye]
        step = math.tau / each
        lowest = np.floor(begin / step).astype(np.int64)
        count = np.minimum(np.ceil((begin + width) / step).astype(np.int64) - lowest + 1, each)
        thing = np.repeat(np.arange(len(eye)), count)
        ray = np.arange(len(thing)) + (lowest - (np.cumsum(count) - count))[thing]
        return thing, self.first[eye][thing] + ray % each[thing]

    def hit(self, ray: Index, distance: Array, seen: Mask) -> None:
        """Some rays end there, at the latest."""
        np.minimum.at(self.nearest, ray[seen], distance[seen])


_turns: dict[int, Array] = {}


def _turn(rays: int) -> Array:
    """The directions of so many rays, (2, n)."""
    if rays not in _turns:
        angles = np.arange(rays) * (math.tau / rays)
        _turns[rays] = np.stack((np.cos(angles), np.sin(angles)))
    return _turns[rays]


def _gathered(field: _Field, parts: list[Array]) -> tuple[Index, Array]:
    """The things of all lidars' slices, each with its lidar's number, seen from there."""
    eye = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    things = np.concatenate(parts)
    places = np.array([e.place[:2] for e in field.eyes])[eye]
    things[:, :2] -= places
    if things.shape[1] == 4:
        things[:, 2:] -= places
    return eye, things


def _see_segments(field: _Field, slices: list[Slice]) -> None:
    eye, ends = _gathered(field, [part.segments for part in slices])
    x, y, to_x, to_y = ends.T
    along_x, along_y = to_x - x, to_y - y
    across = x * along_y - y * along_x  # twice the area between the lidar and the segment, by which side it is on
    length = np.hypot(along_x, along_y)
    nearer = (np.abs(across) < field.range[eye] * length) & (across != 0.0)
    eye, x, y, to_x, to_y, along_x, along_y, across = (
        a[nearer] for a in (eye, x, y, to_x, to_y, along_x, along_y, across)
    )
    begin, end = np.arctan2(y, x), np.arctan2(to_y, to_x)
    begin, end = np.where(across > 0, begin, end), np.where(across > 0, end, begin)
    thing, ray = field.spread(eye, begin, (end - begin) % math.tau)
    way_x, way_y = field.ways[:, ray]
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = way_x * along_y[thing] - way_y * along_x[thing]
        distance = across[thing] / turned
        share = (x[thing] * way_y - y[thing] * way_x) / turned
    field.hit(ray, distance, (distance >= 0.0) & (share >= -_SEAM) & (share <= 1.0 + _SEAM))


def _see_circles(field: _Field, slices: list[Slice]) -> None:
    eye, circles = _gathered(field, [part.circles for part in slices])
    x, y, radius = circles.T
    away = np.hypot(x, y)
    nearer = (away > radius) & (away - radius < field.range[eye])
    eye, x, y, radius, away = eye[nearer], x[nearer], y[nearer], radius[nearer], away[nearer]
    half = np.arcsin(radius / away)
    thing, ray = field.spread(eye, np.arctan2(y, x) - half, 2 * half)
    way_x, way_y = field.ways[:, ray]
    nearest = way_x * x[thing] + way_y * y[thing]
    aside = way_x * y[thing] - way_y * x[thing]
    inside = (radius * radius)[thing] - aside * aside
    distance = nearest - np.sqrt(np.maximum(inside, 0.0))
    field.hit(ray, distance, (inside >= 0.0) & (distance >= 0.0))


def _see_bodies(field: _Field, bodies: Bodies) -> None:
    """Rays in the frame of the body: where each is within its limits along it, and across it."""
    places = np.array([eye.place for eye in field.eyes])
    apart = bodies.centres.T[None] - places[:, None]
    away = np.hypot(apart[:, :, 0], apart[:, :, 1])
    near = (np.abs(apart[:, :, 2]) < bodies.reach) & (away - bodies.reach < field.range[:, None])
    near &= bodies.numbers[None] != np.array([eye.unseen for eye in field.eyes])[:, None]
    eye, body = np.nonzero(near)
    if not len(eye):
        return
    away = away[eye, body]
    half = np.arcsin(np.minimum(1.0, bodies.reach[body] / away))
    half = np.where(half < math.pi / 2, half, math.pi)
    thing, ray = field.spread(eye, np.arctan2(apart[eye, body, 1], apart[eye, body, 0]) - half, 2 * half)
    turned = bodies.turned[:, :, body]
    origin = -total(turned * apart[eye, body].T[:, None])[:, thing]
    way_x, way_y = field.ways[:, ray]
    way = turned[0][:, thing] * way_x + turned[1][:, thing] * way_y
    limits = bodies.sizes[:, body[thing]] / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        # Along an axis that the ray is level with these are infinite, and both of one sign where it passes by.
        one, other = (-limits - origin) / way, (limits - origin) / way
        begins, ends = np.fmin(one, other), np.fmax(one, other)
        rounded = bodies.round[body[thing]]
        a, c = total(way[:2] * way[:2]), total(origin[:2] * origin[:2]) - limits[0] * limits[0]
        b = total(way[:2] * origin[:2])
        half_chord = np.sqrt(b * b - a * c)  # not a number where the ray passes by
        begins[:2] = np.where(rounded, (-b - half_chord) / a, begins[:2])
        ends[:2] = np.where(rounded, (half_chord - b) / a, ends[:2])
    distance = np.maximum.reduce(begins)
    field.hit(ray, distance, (distance >= 0.0) & (distance <= np.minimum.reduce(ends)))


def _cut(
    obstacle: Obstacle, z: float, segments: list[tuple[float, float, float, float]], circles: list[Vector]
) -> None:
    """An obstacle at a height."""
    match obstacle:
        case Block(lo, hi) if lo.z <= z <= hi.z:
            corners = ((lo.x, lo.y), (hi.x, lo.y), (hi.x, hi.y), (lo.x, hi.y))
            segments.extend((*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True))
        case Sphere(centre, radius) if abs(z - centre.z) < radius:
            circles.append((centre.x, centre.y, math.sqrt(radius**2 - (z - centre.z) ** 2)))
        case Cylinder(base, radius, height) if base.z <= z <= base.z + height:
            circles.append((base.x, base.y, radius))
        case Mesh(vertices, faces):
            for face in faces:
                cut = _crossed([vertices[i] for i in face], z)
                if cut is not None:
                    segments.append(cut)


def _crossed(corners: list[Point], z: float) -> tuple[float, float, float, float] | None:
    """Where a triangle is at a height: corners at that very height count as above it."""
    found: list[tuple[float, float]] = []
    for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
        if (p.z < z) != (q.z < z):
            share = (z - p.z) / (q.z - p.z)
            found.append((p.x + share * (q.x - p.x), p.y + share * (q.y - p.y)))
    return (*found[0], *found[1]) if len(found) == 2 else None
