"""Ray casting of planar lidars: distances to obstacles and robots in each direction, in closed form.

Obstacles are cut at the lidar's height into line segments and circles. Other robots stay boxes and cylinders, which may
be tilted. For each shape, only the rays within the angles at which it is visible are computed. All these rays, of all
lidars of a call, are one array."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.physics.rigid import Array, Mask, total

Index = NDArray[np.int64]
_LEVEL = 1.0 - 5e-7  # cosine of the tilt up to which a body counts as upright: 0.001 rad, less than 0.1 mm on a car
_SEAM = 1e-9  # share of its length by which a segment is extended, so that no ray passes between two segments


@dataclass(frozen=True, slots=True)
class LidarMount:
    """A lidar: position (m), number of rays, range (m), and number of the body that it is mounted on.

    Rays are spread evenly over the full turn; the first points east. The lidar does not see its own body."""

    place: Vector
    rays: int
    range: float
    unseen: int = -1


@dataclass(frozen=True, slots=True)
class Bodies:
    """The robots: centres (3, n), rotation matrices (3, 3, n), sizes (3, n), shapes, radii and numbers.

    `sizes`: edges of the box, or of the box around the upright cylinder. `round`: cylinders. `reach`: how far each
    extends from its centre."""

    centres: Array
    turned: Array
    sizes: Array
    round: Mask
    reach: Array
    numbers: Index

    @property
    def level(self) -> Mask:
        """Mask of the upright bodies."""
        found: Mask = self.turned[2, 2] > _LEVEL
        return found


@dataclass(frozen=True, slots=True)
class Slice:
    """Obstacles at one height.

    `segments` (n, 4): x, y of both ends; visible only from the side where the second end is to the right of the first.
    `circles` (n, 3): x, y, radius."""

    segments: Array
    circles: Array


class ObstacleMap:
    """All obstacles, numbered from 0 in the order of creation."""

    def __init__(self) -> None:
        self._obstacles: list[Obstacle] = []
        self._last: tuple[float, Slice] | None = None

    def stand(self, obstacle: Obstacle) -> None:
        """Add an obstacle."""
        self._obstacles.append(obstacle)
        self._last = None

    def move(self, number: int, by: Vector) -> Obstacle:
        """Move an obstacle by a vector (m); return it at its new place."""
        self._obstacles[number] = moved = shifted(self._obstacles[number], Point(*by))
        self._last = None
        return moved

    def cut(self, z: float) -> Slice:
        """Return the obstacles at a height (m).

        The last result is kept, for a car always asks for the same height."""
        if self._last is None or self._last[0] != z:
            segments: list[tuple[float, float, float, float]] = []
            circles: list[Vector] = []
            for obstacle in self._obstacles:
                _cut(obstacle, z, segments, circles)
            self._last = z, Slice(np.array(segments).reshape(-1, 4), np.array(circles).reshape(-1, 3))
        return self._last[1]


def shifted(obstacle: Obstacle, by: Point) -> Obstacle:
    """Return an obstacle moved by a vector (m)."""
    match obstacle:
        case Block(lo, hi):
            return Block(lo + by, hi + by)
        case Sphere(centre, radius):
            return Sphere(centre + by, radius)
        case Cylinder(base, radius, height):
            return Cylinder(base + by, radius, height)
        case Mesh(vertices, faces):
            return Mesh(tuple(each + by for each in vertices), faces)


def cast_rays(eyes: Sequence[LidarMount], scenery: ObstacleMap, bodies: Bodies) -> list[Array]:
    """Return the distance (m) along each ray to the first obstacle or other body; inf beyond the range.

    The floor ends no ray, nor does a solid that contains the lidar."""
    field = _Rays(eyes)
    slices = [scenery.cut(eye.place[2]) for eye in eyes]
    others = field.others(bodies)
    with np.errstate(divide="ignore", invalid="ignore"):
        segments = _Segments(field, [part.segments for part in slices], _outlines(bodies, others))
        circles = _Circles(field, [part.circles for part in slices], _sections(bodies, others))
        things, rays = field.spread(*(np.concatenate(pair) for pair in zip(segments.seen, circles.seen, strict=True)))
        split = int(np.searchsorted(things, segments.count))
        directions = field.directions[:, rays]
        distances = np.concatenate(
            (
                segments.distances(things[:split], directions[:, :split]),
                circles.distances(things[split:] - segments.count, directions[:, split:]),
            )
        )
        field.shorten(rays, distances)
        if not bodies.level.all():
            _cast_at_tilted(field, bodies, others)
    found = []
    for eye, first in zip(eyes, field.first.tolist(), strict=True):
        ranges = field.nearest[first : first + eye.rays]
        ranges[ranges > eye.range] = np.inf
        found.append(ranges)
    return found


def _outlines(bodies: Bodies, others: Mask) -> tuple[Index, Array]:
    """Return the sides of the upright boxes as segments, each with a lidar that may see it."""
    eye, body = np.nonzero(others & bodies.level & ~bodies.round)
    if not len(eye):
        return eye, np.zeros((4, 0))
    ahead = bodies.turned[:2, 0, body] * (bodies.sizes[0, body] / 2)
    left = bodies.turned[:2, 1, body] * (bodies.sizes[1, body] / 2)
    centre = bodies.centres[:2, body]
    front, rear = centre + ahead, centre - ahead
    corners = np.stack((front + left, rear + left, rear - left, front - left))
    sides = np.concatenate((corners, corners[[1, 2, 3, 0]]), axis=1)  # side, coordinate, body
    return np.repeat(eye, 4), sides.transpose(1, 2, 0).reshape(4, -1)


def _sections(bodies: Bodies, others: Mask) -> tuple[Index, Array]:
    """Return the upright cylinders as circles, each with a lidar that may see it."""
    eye, body = np.nonzero(others & bodies.level & bodies.round)
    return eye, np.concatenate((bodies.centres[:2, body], bodies.sizes[:1, body] / 2))


class _Rays:
    """Rays of all lidars in one array, with the nearest distance of each so far."""

    def __init__(self, eyes: Sequence[LidarMount]) -> None:
        self.eyes = eyes
        self.rays = np.array([eye.rays for eye in eyes], dtype=np.int64)
        self.range = np.array([eye.range for eye in eyes])
        self.places = np.array([eye.place[:2] for eye in eyes]).T
        self.first: Index = np.cumsum(self.rays) - self.rays
        angles = [_ray_directions(eye.rays) for eye in eyes]
        self.directions = angles[0] if len(angles) == 1 else np.concatenate(angles, axis=1)
        self.nearest = np.full(self.directions.shape[1], np.inf)

    def others(self, bodies: Bodies) -> Mask:
        """Return which bodies each lidar may see, (lidars, n): all at its height except its own."""
        heights = np.array([[eye.place[2]] for eye in self.eyes])
        unseen = np.array([[eye.unseen] for eye in self.eyes])
        tall = np.where(bodies.level, bodies.sizes[2] / 2, bodies.reach)
        found: Mask = (np.abs(bodies.centres[2] - heights) <= tall) & (bodies.numbers != unseen)
        return found

    def spread(self, eye: Index, begin: Array, width: Array) -> tuple[Index, Index]:
        """Return the rays of lidars between the angles `begin` and `begin + width`, plus one at each side.

        For each ray: index of the shape it is tested with, and its own index."""
        each = self.rays[eye]
        step = math.tau / each
        lowest = np.floor(begin / step).astype(np.int64)
        count = np.minimum(np.ceil((begin + width) / step).astype(np.int64) - lowest + 1, each)
        thing = np.repeat(np.arange(len(eye)), count)
        ray = np.arange(len(thing)) + (lowest - (np.cumsum(count) - count))[thing]
        return thing, self.first[eye][thing] + ray % each[thing]

    def shorten(self, ray: Index, distance: Array) -> None:
        """Shorten rays to at most these distances."""
        np.minimum.at(self.nearest, ray, distance)


_directions: dict[int, Array] = {}


def _ray_directions(rays: int) -> Array:
    """Return the directions of evenly spread rays, (2, n)."""
    if rays not in _directions:
        angles = np.arange(rays) * (math.tau / rays)
        _directions[rays] = np.stack((np.cos(angles), np.sin(angles)))
    return _directions[rays]


def _gathered(field: _Rays, parts: list[Array], others: tuple[Index, Array]) -> tuple[Index, Array]:
    """Return all shapes relative to their lidars, one column each, and the lidar of each column."""
    eye = np.concatenate((np.repeat(np.arange(len(parts)), [len(part) for part in parts]), others[0]))
    things = np.concatenate((*(part.T for part in parts), others[1]), axis=1)
    places = field.places[:, eye]
    things[:2] -= places
    if len(things) == 4:
        things[2:] -= places
    return eye, things


class _Segments:
    """Segments within the lidars' ranges. `seen` holds the arguments of `_Rays.spread`."""

    def __init__(self, field: _Rays, parts: list[Array], others: tuple[Index, Array]) -> None:
        eye, ends = _gathered(field, parts, others)
        along = ends[2:] - ends[:2]
        # length times distance of the line, signed by the side on which the lidar is
        area = ends[0] * along[1] - ends[1] * along[0]
        near = area * area < (field.range * field.range)[eye] * total(along * along)
        near &= area < 0.0  # the lidar is on the outer side
        self._of_each = np.concatenate((ends[:2], along, area[None]))[:, near]
        end, begin = np.arctan2(ends[1::2, near], ends[::2, near])
        self.seen = eye[near], begin, (end - begin) % math.tau
        self.count = len(begin)

    def distances(self, thing: Index, way: Array) -> Array:
        """Return the distances along rays to their segments; inf for a miss."""
        x, y, along_x, along_y, area = self._of_each[:, thing]
        turned = way[0] * along_y - way[1] * along_x
        distance: Array = area / turned
        share = (x * way[1] - y * way[0]) / turned
        distance[(distance < 0.0) | ~(np.abs(share - 0.5) <= 0.5 + _SEAM)] = np.inf
        return distance


class _Circles:
    """Circles within the lidars' ranges, with the interface of `_Segments`."""

    def __init__(self, field: _Rays, parts: list[Array], others: tuple[Index, Array]) -> None:
        eye, circles = _gathered(field, parts, others)
        away = np.hypot(circles[0], circles[1])
        near = (away > circles[2]) & (away - circles[2] < field.range[eye])
        self._of_each = circles = circles[:, near]
        half = np.arcsin(circles[2] / away[near])
        self.seen = eye[near], np.arctan2(circles[1], circles[0]) - half, 2 * half

    def distances(self, thing: Index, way: Array) -> Array:
        """Return the distances along rays to their circles; inf for a miss."""
        x, y, radius = self._of_each[:, thing]
        aside = way[0] * y - way[1] * x
        distance: Array = way[0] * x + way[1] * y - np.sqrt(radius * radius - aside * aside)
        distance[~(distance >= 0.0)] = np.inf  # NaN for a miss
        return distance


def _cast_at_tilted(field: _Rays, bodies: Bodies, others: Mask) -> None:
    """Shorten the rays that hit tilted bodies, computed in each body's frame."""
    places = np.array([eye.place for eye in field.eyes])
    apart = bodies.centres.T[None] - places[:, None]
    away = np.hypot(apart[:, :, 0], apart[:, :, 1])
    near = others & ~bodies.level & (away - bodies.reach < field.range[:, None])
    eye, body = np.nonzero(near)
    if not len(eye):
        return
    away = away[eye, body]
    half = np.arcsin(np.minimum(1.0, bodies.reach[body] / away))
    half = np.where(half < math.pi / 2, half, math.pi)
    thing, ray = field.spread(eye, np.arctan2(apart[eye, body, 1], apart[eye, body, 0]) - half, 2 * half)
    turned = bodies.turned[:, :, body]
    origin = -total(turned * apart[eye, body].T[:, None])[:, thing]
    way_x, way_y = field.directions[:, ray]
    way = turned[0][:, thing] * way_x + turned[1][:, thing] * way_y
    limits = bodies.sizes[:, body[thing]] / 2
    # Infinite along an axis that the ray is perpendicular to; both of the same sign for a miss.
    one, other = (-limits - origin) / way, (limits - origin) / way
    begins, ends = np.fmin(one, other), np.fmax(one, other)
    rounded = bodies.round[body[thing]]
    a, c = total(way[:2] * way[:2]), total(origin[:2] * origin[:2]) - limits[0] * limits[0]
    b = total(way[:2] * origin[:2])
    half_chord = np.sqrt(b * b - a * c)  # NaN for a miss
    begins[:2] = np.where(rounded, (-b - half_chord) / a, begins[:2])
    ends[:2] = np.where(rounded, (half_chord - b) / a, ends[:2])
    distance = np.maximum.reduce(begins)
    distance[~((distance >= 0.0) & (distance <= np.minimum.reduce(ends)))] = np.inf
    field.shorten(ray, distance)


def _cut(
    obstacle: Obstacle, z: float, segments: list[tuple[float, float, float, float]], circles: list[Vector]
) -> None:
    """Cut an obstacle at a height."""
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
                cut = _triangle_section([vertices[i] for i in face], z)
                if cut is not None:  # visible from both sides
                    segments += [cut, (*cut[2:], *cut[:2])]


def _triangle_section(corners: list[Point], z: float) -> tuple[float, float, float, float] | None:
    """Return the section of a triangle at a height. A corner at exactly that height counts as above it."""
    found: list[tuple[float, float]] = []
    for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
        if (p.z < z) != (q.z < z):
            share = (z - p.z) / (q.z - p.z)
            found.append((p.x + share * (q.x - p.x), p.y + share * (q.y - p.y)))
    return (*found[0], *found[1]) if len(found) == 2 else None
