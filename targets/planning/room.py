"""Free space of one planning question: obstacles, and the distance to keep from each obstacle.

If the start of a path is nearer to an obstacle, the distance to keep is lowered to LEAVING times the start's distance,
so that a robot can leave a tight place. If the start is not nearer than a least distance, paths must keep this least
distance. Otherwise paths that are planned again and again, from ever nearer places, could come arbitrarily near to an
obstacle.

The test whether a straight line is clear is exact (`exact.py`, `mesh.py`). Only obstacles whose bounding box is near
the bounding box of the line are measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np

from koordgen.runtime.values.geometry import segment_distance
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.planning.exact import Solid, solid_distance
from targets.planning.mesh import Surface
from targets.planning.world import Path, Scene, World

LEAVING = 0.95  # a path that starts too near to an obstacle must keep this share of the start's distance
HIGH = 1e5  # metres; infinitely high obstacles reach from -HIGH to HIGH
MANY = 48  # number of obstacles above which numpy finds the obstacles near a line faster than a loop

Measure = Callable[[Point, Point, float], float]
Bounds = tuple[float, float, float, float, float, float]  # west, south, bottom, east, north, top


@dataclass(frozen=True, slots=True)
class Thing:
    """Obstacle with its bounding box.

    `distance(a, b, within)`: exact distance (m) of the segment ab from the obstacle. If the distance is more than
    `within`, it may return any value above `within`. `name`: the obstacle's name in messages."""

    low: Point
    high: Point
    distance: Measure
    name: str

    def grown(self, by: float) -> Bounds:
        low, high = self.low, self.high
        return low.x - by, low.y - by, low.z - by, high.x + by, high.y + by, high.z + by


class Room:
    """Obstacles of a path from `start`, and the distances to keep from them.

    `inside`: name of the first obstacle that contains the start; "" if none does.
    `lowered`: lowered distances of the obstacles that are too near to the start, by name."""

    def __init__(self, start: Point) -> None:
        self._start = start
        self._kept: list[tuple[Bounds, float, Thing]] = []
        self._boxes: np.ndarray[tuple[int, int], np.dtype[np.float64]] | None = None
        self.inside = ""
        self.lowered: dict[str, float] = {}

    def keep(self, things: Iterable[Thing], kept: float, least: float = 0.0) -> None:
        """Add obstacles from which paths must keep the distance `kept` (m).

        If the start is nearer to an obstacle, paths must keep LEAVING times the start's distance from this obstacle,
        but no less than `least` if the start's distance is at least `least`."""
        at = self._start
        for thing in things:
            bounds, margin = thing.grown(kept), kept
            if _overlap(bounds, at.x, at.x, at.y, at.y, at.z, at.z):
                near = thing.distance(at, at, kept)
                if near < kept:
                    margin = LEAVING * near if near < least else max(LEAVING * near, least)
                    bounds = thing.grown(margin)
                    self.lowered[thing.name] = margin
                if not near:
                    self.inside = self.inside or thing.name
            self._add(thing, bounds, margin)

    def keep_all(self, things: Iterable[Thing], kept: Callable[[str], float]) -> None:
        """Add obstacles from which paths must keep the distance `kept(name)` (m), even if the start is nearer."""
        for thing in things:
            margin = kept(thing.name)
            self._add(thing, thing.grown(margin), margin)

    def _add(self, thing: Thing, bounds: Bounds, margin: float) -> None:
        if margin > 0.0:
            self._kept.append((bounds, margin, thing))
        self._boxes = None

    def clear(self, a: Point, b: Point) -> bool:
        """Return whether the whole segment from a to b keeps its distance from all obstacles."""
        return all(thing.distance(a, b, kept) >= kept for kept, thing in self._near(a, b))

    def nearest(self, a: Point, b: Point) -> tuple[float, str]:
        """Return distance (m) and name of the nearest obstacle that is too near to the line from a to b.

        Return (inf, "") if the line is clear."""
        found = ((thing.distance(a, b, kept), kept, thing.name) for kept, thing in self._near(a, b))
        return min(((d, name) for d, kept, name in found if d < kept), default=(math.inf, ""))

    def _near(self, a: Point, b: Point) -> Iterator[tuple[float, Thing]]:
        west, east = (a.x, b.x) if a.x < b.x else (b.x, a.x)
        south, north = (a.y, b.y) if a.y < b.y else (b.y, a.y)
        bottom, top = (a.z, b.z) if a.z < b.z else (b.z, a.z)
        if len(self._kept) <= MANY:
            for bounds, kept, thing in self._kept:
                if _overlap(bounds, west, east, south, north, bottom, top):
                    yield kept, thing
            return
        if self._boxes is None:
            self._boxes = np.array([bounds for bounds, _, _ in self._kept])
        boxes = self._boxes
        low = boxes[:, :3] < (east, north, top)
        high = boxes[:, 3:] > (west, south, bottom)
        for i in np.flatnonzero((low & high).all(axis=1)):
            _, kept, thing = self._kept[i]
            yield kept, thing


def _overlap(bounds: Bounds, west: float, east: float, south: float, north: float, bottom: float, top: float) -> bool:
    return (
        bounds[0] < east and bounds[3] > west
        and bounds[1] < north and bounds[4] > south
        and bounds[2] < top and bounds[5] > bottom
    )  # fmt: skip


def fixed(obstacles: Iterable[Obstacle]) -> list[Thing]:
    """Return the obstacles of the fleet file, each named by its index in the file: `obstacle 0`."""
    return [_thing(obstacle, f"obstacle {number}") for number, obstacle in enumerate(obstacles)]


def room(world: World, standing: Iterable[Thing], scene: Scene, start: Point) -> Room:
    """Return the free space of a path from `start`. `standing`: the world's obstacles, made by `fixed`."""
    found = Room(start)
    found.keep(standing, world.kept, world.least)
    # If an obstacle that the program passes contains the start, `inside` does not name this obstacle. Such an obstacle
    # is an error, or the robot itself.
    stuck = found.inside
    found.keep(_columns(scene, world.kept, start), world.kept)
    for path in scene.others:
        found.keep(_capsules(path), world.radius + world.kept)
    found.inside = stuck
    return found


def _thing(obstacle: Obstacle, name: str) -> Thing:
    match obstacle:
        case Block(low, high):
            pass
        case Sphere(c, r):
            low, high = Point(c.x - r, c.y - r, c.z - r), Point(c.x + r, c.y + r, c.z + r)
        case Cylinder(c, r, h):
            low, high = Point(c.x - r, c.y - r, c.z), Point(c.x + r, c.y + r, c.z + h)
        case Mesh():
            surface = Surface(obstacle)
            return Thing(surface.low, surface.high, partial(_surface, surface, Block(surface.low, surface.high)), name)
    return Thing(low, high, partial(_solid, obstacle), name)


def _solid(body: Solid, a: Point, b: Point, within: float) -> float:
    return solid_distance(body, a, b)


def _surface(surface: Surface, around: Block, a: Point, b: Point, within: float) -> float:
    return math.inf if solid_distance(around, a, b) > within else surface.distance(a, b, within)


def _columns(scene: Scene, kept: float, start: Point) -> Iterator[Thing]:
    """Yield the grids and points of a scene as infinitely high obstacles.

    Touching cells of the grids are joined to one obstacle. Cells near the start stay single, because the lowered
    distance near the start must apply to these cells only, and not to a whole wall."""
    cells: dict[float, set[tuple[int, int]]] = {}
    for grid in scene.grids:
        x, y, size = grid.x, grid.y, grid.size
        dx = max(x * size - start.x, 0.0, start.x - (x + 1) * size)
        dy = max(y * size - start.y, 0.0, start.y - (y + 1) * size)
        if math.hypot(dx, dy) < kept:
            yield _column(x * size, y * size, (x + 1) * size, (y + 1) * size)
        else:
            cells.setdefault(size, set()).add((x, y))
    for size, places in cells.items():
        for x, y, right, upper in rectangles(places):
            yield _column(x * size, y * size, right * size, upper * size)
    for p in scene.points:
        yield _column(p.x, p.y, p.x, p.y)


def _column(west: float, south: float, east: float, north: float) -> Thing:
    return _thing(Block(Point(west, south, -HIGH), Point(east, north, HIGH)), "an obstacle of the program")


def rectangles(cells: set[tuple[int, int]]) -> Iterator[tuple[int, int, int, int]]:
    """Yield rectangles that cover the cells: (first x, first y, last x + 1, last y + 1).

    Each rectangle consists of equal runs of cells in successive rows."""
    grown: dict[tuple[int, int], int] = {}  # run (first x, last x + 1) in the last row -> first y of its rectangle
    last = 0
    rows: dict[int, list[int]] = {}
    for x, y in cells:
        rows.setdefault(y, []).append(x)
    for y in sorted(rows):
        xs = sorted(rows[y])
        breaks = [i for i in range(1, len(xs)) if xs[i] != xs[i - 1] + 1]
        runs = [(xs[i], xs[j - 1] + 1) for i, j in pairwise([0, *breaks, len(xs)])]
        going = {run: grown[run] for run in runs if run in grown and y == last + 1}
        yield from ((x, begin, right, last + 1) for (x, right), begin in grown.items() if (x, right) not in going)
        grown, last = {run: going.get(run, y) for run in runs}, y
    yield from ((x, begin, right, last + 1) for (x, right), begin in grown.items())


def _capsules(path: Path) -> Iterator[Thing]:
    """Yield the segments of another robot's path as obstacles of radius 0."""
    for p, q in pairwise(path if len(path) != 1 else path * 2):
        low = Point(min(p.x, q.x), min(p.y, q.y), min(p.z, q.z))
        high = Point(max(p.x, q.x), max(p.y, q.y), max(p.z, q.z))
        yield Thing(low, high, partial(_apart, p, q), "another robot's path")


def _apart(p: Point, q: Point, a: Point, b: Point, within: float) -> float:
    return segment_distance(p, q, a, b)


@runtime_checkable
class InRoom(Protocol):
    """Interface of a planner that accepts a prepared Room instead of a Scene."""

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path: ...
