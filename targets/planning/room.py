"""Where a robot may go: the obstacles of one question, each with the distance to be kept from it.

What stands nearer to the start than that is kept at nearly the distance that it has there: a robot may leave a tight
place. It keeps a least distance where it has that at the start: a way that is asked for again and again from ever
nearer places would come as near as can be otherwise. The answer to "is this straight line clear" is exact (`exact.py`,
`mesh.py`): of all obstacles, those whose box comes near the line's are measured.
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

LEAVING = 0.95  # of the distance that the start has from what is too near: so much is kept on the way out
HIGH = 1e5  # metres: how far what is as high as anything reaches up and down
MANY = 48  # obstacles from which on numpy finds those that are near sooner than a loop does

Measure = Callable[[Point, Point, float], float]
Bounds = tuple[float, float, float, float, float, float]  # west, south, bottom, east, north, top


@dataclass(frozen=True, slots=True)
class Thing:
    """An obstacle with a box around it. `distance(a, b, within)` is that of the segment ab, exactly; when it is above
    `within`, any such value. `name` is for people."""

    low: Point
    high: Point
    distance: Measure
    name: str

    def grown(self, by: float) -> Bounds:
        low, high = self.low, self.high
        return low.x - by, low.y - by, low.z - by, high.x + by, high.y + by, high.z + by


class Room:
    """What is to be kept away from on the way from `start`, and how far. `inside` names the first that contains the
    start, and so cannot be kept away from; else it is "". `lowered` has the distances that are kept from what is too
    near to the start, by names."""

    def __init__(self, start: Point) -> None:
        self._start = start
        self._kept: list[tuple[Bounds, float, Thing]] = []
        self._boxes: np.ndarray[tuple[int, int], np.dtype[np.float64]] | None = None
        self.inside = ""
        self.lowered: dict[str, float] = {}

    def keep(self, things: Iterable[Thing], kept: float, least: float = 0.0) -> None:
        """Keep so many metres away from these; from one that is nearer to the start, nearly what it has there, but no
        less than `least` if it has that."""
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
        """Keep the distance `kept(name)` to each thing, even if the start is nearer to it."""
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
        """Of those that the line comes too near to the nearest: its distance and name; (inf, "") when it is clear."""
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
    """Those of the fleet file, named by their number in it."""
    return [_thing(obstacle, f"obstacle {number}") for number, obstacle in enumerate(obstacles)]


def room(world: World, standing: Iterable[Thing], scene: Scene, start: Point) -> Room:
    """What is to be kept away from on the way from `start`; `standing` are the world's obstacles, made by `fixed`."""
    found = Room(start)
    found.keep(standing, world.kept, world.least)
    stuck = found.inside  # of what a program names, what it stands in is left out: it was seen wrongly, or is itself
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
    """Grids and points, as high as anything. Cells that touch are one obstacle, but for those that the start is near
    to: the robot may leave these, not the whole wall."""
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
    return _thing(Block(Point(west, south, -HIGH), Point(east, north, HIGH)), "what the program named")


def rectangles(cells: set[tuple[int, int]]) -> Iterator[tuple[int, int, int, int]]:
    """The same cells as rectangles (x, y, and behind the last of each): runs along a row, joined with equal ones of the
    row before."""
    grown: dict[tuple[int, int], int] = {}  # run (x, behind) in the row before -> where its rectangle begins
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
    """Another robot's path, part by part."""
    for p, q in pairwise(path if len(path) != 1 else path * 2):
        low = Point(min(p.x, q.x), min(p.y, q.y), min(p.z, q.z))
        high = Point(max(p.x, q.x), max(p.y, q.y), max(p.z, q.z))
        yield Thing(low, high, partial(_apart, p, q), "another robot's path")


def _apart(p: Point, q: Point, a: Point, b: Point, within: float) -> float:
    return segment_distance(p, q, a, b)


@runtime_checkable
class InRoom(Protocol):
    """A planner that takes a Room for what is to be kept away from."""

    def plan_in(self, here: Room, start: Point, goal: Point, seconds: float) -> Path: ...
