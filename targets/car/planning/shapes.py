"""Obstacles on the ground in two dimensions: convex shapes with a radius, and the car outline's distance from them.

A disc is a point with a radius. Another robot's path consists of lines with a radius. A box, a grid cell or a triangle
of a mesh is a polygon. Only the part of an obstacle between the ground and the car's height counts. Metres, local ENU.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.planning.room import rectangles
from targets.planning.world import Path, Scene

Place = tuple[float, float]
Core = tuple[Place, ...]  # corners, counter-clockwise; one corner is a point, two are a line
Bounds = tuple[float, float, float, float]  # west, south, east, north

NEXT = 0.05  # metres beyond the clearance within which a grid cell counts as near to the start
OVERLAP = -1.0  # returned as the distance (m) of a shape that overlaps the footprint


@dataclass(frozen=True, slots=True)
class Shape:
    """Set of the places within `radius` (m) of a convex core, with the bounding box of this set.

    `name` is for messages. `upright`: the core is an axis-parallel box."""

    core: Core
    radius: float
    name: str
    upright: bool = False
    bounds: Bounds = field(init=False)

    def __post_init__(self) -> None:
        xs, ys, r = [x for x, _ in self.core], [y for _, y in self.core], self.radius
        object.__setattr__(self, "bounds", (min(xs) - r, min(ys) - r, max(xs) + r, max(ys) + r))


@dataclass(frozen=True, slots=True)
class Footprint:
    """Outline of the car on the ground: a rectangle in the frame of the rear axle's middle; metres."""

    length: float
    width: float
    overhang: float  # length of the part behind the rear axle

    @property
    def front(self) -> float:
        return self.length - self.overhang

    @property
    def reach(self) -> float:
        """Distance (m) of the outline's farthest corner from the reference point, the rear axle's middle."""
        return math.hypot(max(self.front, self.overhang), self.width / 2)

    def pace(self, curvature: float) -> float:
        """Return the most metres that a place of the outline moves per metre of the reference point."""
        return math.hypot(1 + curvature * self.width / 2, curvature * max(self.front, self.overhang))

    def distance(self, x: float, y: float, yaw: float, shape: Shape) -> float:
        """Return the exact distance (m) of the outline at a pose from a shape; below 0 if they overlap."""
        c, s = math.cos(yaw), math.sin(yaw)
        if shape.upright:
            gap = _to_box(self, x, y, c, s, shape.bounds)
        else:
            local = [(c * (px - x) + s * (py - y), c * (py - y) - s * (px - x)) for px, py in shape.core]
            match local:
                case [(px, py)]:
                    gap = _to_point(self, px, py)
                case [a, b]:
                    gap = _to_line(self, a, b)
                case _:
                    gap = _to_polygon(self, local)
        return gap - shape.radius if gap > 0 else OVERLAP


def _to_box(body: Footprint, x: float, y: float, c: float, s: float, bounds: Bounds) -> float:
    """Return the distance (m) of the outline from an axis-parallel box; 0 if they overlap.

    This is `_to_polygon`, written out for speed: most of the time of a collision check is spent on boxes."""
    west, south, east, north = bounds
    front, back, half = body.front, -body.overhang, body.width / 2
    best = math.inf
    before = behind = left = right = True
    for px, py in ((west, south), (east, south), (east, north), (west, north)):
        rx, ry = px - x, py - y
        ahead, aside = c * rx + s * ry, c * ry - s * rx
        dx = ahead - front if ahead > front else back - ahead if ahead < back else 0.0
        dy = aside - half if aside > half else -half - aside if aside < -half else 0.0
        before, behind = before and ahead > front, behind and ahead < back
        left, right = left and aside > half, right and aside < -half
        square = dx * dx + dy * dy
        if square < best:
            best = square
    apart = before or behind or left or right
    before = behind = left = right = True
    for ahead, aside in ((back, -half), (front, -half), (front, half), (back, half)):
        px, py = x + c * ahead - s * aside, y + s * ahead + c * aside
        dx = west - px if px < west else px - east if px > east else 0.0
        dy = south - py if py < south else py - north if py > north else 0.0
        before, behind = before and px > east, behind and px < west
        left, right = left and py > north, right and py < south
        square = dx * dx + dy * dy
        if square < best:
            best = square
    return math.sqrt(best) if apart or before or behind or left or right else 0.0


def _to_point(body: Footprint, px: float, py: float) -> float:
    return math.hypot(max(-body.overhang - px, 0.0, px - body.front), max(0.0, abs(py) - body.width / 2))


def _to_line(body: Footprint, a: Place, b: Place) -> float:
    """Return the distance (m) of the outline from a line; 0 if they overlap.

    This is `_to_polygon`, written out for speed: lines of other robots' paths are checked very often."""
    front, back, half = body.front, -body.overhang, body.width / 2
    (ax, ay), (bx, by) = a, b
    ex, ey = bx - ax, by - ay
    length = ex * ex + ey * ey
    dx = ax - front if ax > front else back - ax if ax < back else 0.0
    dy = ay - half if ay > half else -half - ay if ay < -half else 0.0
    best = dx * dx + dy * dy
    dx = bx - front if bx > front else back - bx if bx < back else 0.0
    dy = by - half if by > half else -half - by if by < -half else 0.0
    best = min(best, dx * dx + dy * dy)
    apart = (ax > front and bx > front) or (ax < back and bx < back)
    apart = apart or (ay > half and by > half) or (ay < -half and by < -half)
    left = right = True  # whether the whole footprint is on the left, or right, of the line
    for cx, cy in ((back, -half), (front, -half), (front, half), (back, half)):
        rx, ry = cx - ax, cy - ay
        aside = rx * ey - ry * ex
        left, right = left and aside < 0.0, right and aside > 0.0
        share = (rx * ex + ry * ey) / length if length else 0.0
        share = 0.0 if share < 0.0 else 1.0 if share > 1.0 else share
        dx, dy = rx - share * ex, ry - share * ey
        square = dx * dx + dy * dy
        if square < best:
            best = square
    return math.sqrt(best) if apart or left or right else 0.0


def _to_polygon(body: Footprint, corners: list[Place]) -> float:
    """Return the distance (m) of the outline from a convex polygon; 0 if they overlap.

    If two convex polygons do not overlap, their distance is that of a corner of one from the other."""
    half = body.width / 2
    own = ((-body.overhang, -half), (body.front, -half), (body.front, half), (-body.overhang, half))
    best = math.inf
    before, behind, left, right = True, True, True, True
    for px, py in corners:
        best = min(best, _to_point(body, px, py))
        before, behind = before and px > body.front, behind and px < -body.overhang
        left, right = left and py > half, right and py < -half
    apart = before or behind or left or right
    for (ax, ay), (bx, by) in pairwise((*corners, corners[0])):
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        if square == 0.0:
            continue
        beyond = True  # whether the whole footprint is on the outer side of this edge
        for cx, cy in own:
            rx, ry = cx - ax, cy - ay
            beyond = beyond and rx * ey - ry * ex > 0
            share = max(0.0, min(1.0, (rx * ex + ry * ey) / square))
            best = min(best, math.hypot(rx - share * ex, ry - share * ey))
        apart = apart or beyond
    return best if apart else 0.0


def standing(obstacles: Iterable[Obstacle], height: float) -> list[Shape]:
    """Return the shapes of the fleet file's obstacles, named by number, without those above the car's height."""
    return [shape for number, body in enumerate(obstacles) for shape in _shapes(body, height, f"obstacle {number}")]


def named(scene: Scene, body: Footprint, start: Place, clearance: float) -> Iterator[Shape]:
    """Yield shapes of the obstacles that a program passes, and of other robots' paths, except those above the car.

    A program's obstacles count as infinitely high. Other robots' paths are widened by this car's reach. Grid cells that
    touch are joined to one shape. Cells near the start stay single: a path may keep less distance from a shape that is
    near the start, and this must apply to the near cells only, not to a whole wall."""
    cells: dict[float, set[tuple[int, int]]] = {}
    reach = body.reach + clearance + NEXT
    for grid in scene.grids:
        x, y, size = grid.x, grid.y, grid.size
        if max(abs((x + 0.5) * size - start[0]), abs((y + 0.5) * size - start[1])) < reach + size:
            yield _box(x * size, y * size, (x + 1) * size, (y + 1) * size, "an obstacle that the program named")
        else:
            cells.setdefault(size, set()).add((x, y))
    for size, places in cells.items():
        for x, y, right, upper in rectangles(places):
            yield _box(x * size, y * size, right * size, upper * size, "an obstacle that the program named")
    for p in scene.points:
        yield Shape(((p.x, p.y),), 0.0, "an obstacle that the program named")
    for path in scene.others:
        yield from _path_shapes(path, body.reach)


def _path_shapes(path: Path, reach: float) -> Iterator[Shape]:
    for p, q in pairwise(path if len(path) != 1 else path * 2):
        if min(p.z, q.z) > 2 * reach:  # a path that is higher than this does not concern a car
            continue
        core = ((p.x, p.y),) if (p.x, p.y) == (q.x, q.y) else ((p.x, p.y), (q.x, q.y))
        yield Shape(core, reach, "another robot's path")


def _box(west: float, south: float, east: float, north: float, name: str) -> Shape:
    return Shape(((west, south), (east, south), (east, north), (west, north)), 0.0, name, True)


def _shapes(body: Obstacle, height: float, name: str) -> Iterator[Shape]:
    match body:
        case Block(lo, hi):
            if lo.z <= height and hi.z >= 0.0:
                yield _box(lo.x, lo.y, hi.x, hi.y, name)
        case Cylinder(base, radius, high):
            if base.z <= height and base.z + high >= 0.0:
                yield Shape(((base.x, base.y),), radius, name)
        case Sphere(centre, radius):
            off = centre.z - max(0.0, min(height, centre.z))
            if abs(off) <= radius:
                yield Shape(((centre.x, centre.y),), math.sqrt(radius * radius - off * off), name)
        case Mesh(vertices, faces):
            for face in faces:
                part = _cut([vertices[i] for i in face], 0.0, height)
                if part:
                    yield Shape(_outline(part), 0.0, name)


def _cut(corners: list[Point], low: float, high: float) -> list[Point]:
    """Return the part of a convex polygon between two heights (I. E. Sutherland and G. W. Hodgman, 1974)."""
    for level, sign in ((low, 1.0), (high, -1.0)):
        kept: list[Point] = []
        for p, q in pairwise((*corners, *corners[:1])):
            a, b = sign * (p.z - level), sign * (q.z - level)
            if a >= 0:
                kept.append(p)
            if (a >= 0) != (b >= 0):
                kept.append(p + (q - p) * (a / (a - b)))
        corners = kept
    return corners


def _outline(corners: list[Point]) -> Core:
    """Return the outline of a polygon seen from above, counter-clockwise. An upright polygon becomes a line."""
    places = [(p.x, p.y) for p in corners]
    area = sum(ax * by - bx * ay for (ax, ay), (bx, by) in pairwise((*places, places[0])))
    return tuple(places if area >= 0 else places[::-1])
