"""What mapping.koord leaves to Python: where to look next, what is in the way, what a scan tells.

All three are pure: the same map and scan give the same answer on every robot. Lengths in metres, local ENU frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from koordgen.runtime.gridmap import GridMap, cell, center, is_free, is_known, is_occupied, mark_free, mark_occupied
from koordgen.runtime.values import Grid, Point, Scan

AROUND = ((1, 0), (-1, 0), (0, 1), (0, -1))
ROOM = 1  # cells between a place to drive to and what is occupied


def pickFrontierPos(known: GridMap, own: Point) -> Point:
    """The nearest free cell beside an unknown one, with some room around it; without any, where the robot is."""
    frontier = [
        center(g)
        for g in _cells(known)
        if is_free(known, g)
        and any(not is_known(known, n) and _inside(known, n) for n in _near(g))
        and not any(is_occupied(known, n) for n in _square(g, ROOM))
    ]
    if not frontier:
        here = cell(own, known.resolution)
        unknown = [center(g) for g in _cells(known) if not is_known(known, g)]
        return own if is_known(known, here) or not unknown else center(here)
    return min(frontier, key=lambda p: (math.hypot(p.x - own.x, p.y - own.y), p.x, p.y))


def findObs(known: GridMap) -> list[Grid]:
    """The cells that are known to be occupied."""
    return [g for g in _cells(known) if is_occupied(known, g)]


def scanToMap(own: Point, seen: Scan, area: GridMap) -> GridMap:
    """`area` with the cells free that rays crossed, and those occupied at which rays ended."""
    result = area
    for angle, range_ in zip(seen.angles, seen.ranges, strict=True):
        east, north = math.cos(angle), math.sin(angle)
        steps = max(1, int(range_ / (area.resolution / 4)))
        for i in range(steps):
            way = range_ * i / steps
            g = cell(Point(own.x + way * east, own.y + way * north, 0.0), area.resolution)
            if _inside(result, g) and not is_known(result, g):
                result = mark_free(result, g)
        if range_ < seen.max_range:
            way = range_ + 1e-6  # the surface itself belongs to the cell behind it
            g = cell(Point(own.x + way * east, own.y + way * north, 0.0), area.resolution)
            if _inside(result, g):
                result = mark_occupied(result, g)
    return result


def _cells(m: GridMap) -> Iterator[Grid]:
    return (Grid(m.x + i, m.y + j, m.resolution) for j in range(m.height) for i in range(m.width))


def _near(g: Grid) -> Iterator[Grid]:
    return (Grid(g.x + i, g.y + j, g.size) for i, j in AROUND)


def _square(g: Grid, room: int) -> Iterator[Grid]:
    span = range(-room, room + 1)
    return (Grid(g.x + i, g.y + j, g.size) for i in span for j in span)


def _inside(m: GridMap, g: Grid) -> bool:
    return m.x <= g.x < m.x + m.width and m.y <= g.y < m.y + m.height
