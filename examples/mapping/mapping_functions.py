"""What mapping.koord leaves to Python: where to look next, what is in the way, what a scan tells, when all is seen.

All of them are pure: the same map and scan give the same answer on every robot. Lengths in metres, local ENU frame.
The map is parted into strips from west to east, one a robot; each drives within its own, a cell away from the next.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from koordgen.runtime.gridmap import GridMap, cell, center, is_known, is_occupied, mark_free, mark_occupied
from koordgen.runtime.values import Grid, Point, Scan

Cell = tuple[int, int]
NEAR = ((1, 0), (-1, 0), (0, 1), (0, -1))
AROUND = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))


def pickFrontierPos(known: GridMap, own: Point, part: int, parts: int) -> Point:
    """The edge of what is known that is nearest to drive to, or else as the crow flies; without any, where the robot
    is."""
    edge = _edge(known, part, parts)
    if not edge:
        return own
    size, room = known.resolution, _room(known, part, parts)
    here = cell(own, size)
    queue, seen = deque([(here.x, here.y)]), {(here.x, here.y)}
    while queue:
        x, y = queue.popleft()
        if (x, y) in edge:
            return center(Grid(x, y, size))
        for i, j in NEAR:
            following = (x + i, y + j)
            if following in room and following not in seen:
                seen.add(following)
                queue.append(following)
    return min((center(Grid(x, y, size)) for x, y in sorted(edge)), key=lambda p: math.hypot(p.x - own.x, p.y - own.y))


def findObs(known: GridMap) -> list[Grid]:
    """The cells that are known to be occupied."""
    cells = (Grid(x, y, known.resolution) for x, y in _cells(known))
    return [g for g in cells if is_occupied(known, g)]


def explored(known: GridMap, part: int, parts: int) -> bool:
    """Whether a strip has no edge left to drive to."""
    return not _edge(known, part, parts)


def scanToMap(own: Point, seen: Scan, area: GridMap) -> GridMap:
    """`area` with the cells free that rays crossed, and those occupied at which rays ended."""
    size = area.resolution
    free: set[Cell] = set()
    hit: set[Cell] = set()
    for angle, range_ in zip(seen.angles, seen.ranges, strict=True):
        east, north = math.cos(angle) / size, math.sin(angle) / size
        x, y = own.x / size, own.y / size
        steps = max(1, int(3 * range_ / size))
        for i in range(steps):
            way = range_ * i / steps
            free.add((math.floor(x + way * east), math.floor(y + way * north)))
        if range_ < seen.max_range:
            way = range_ + 1e-6  # the surface itself belongs to the cell behind it
            hit.add((math.floor(x + way * east), math.floor(y + way * north)))
    result = area
    for x_, y_ in free & set(_cells(area)):
        result = mark_free(result, Grid(x_, y_, size))
    for x_, y_ in hit & set(_cells(area)):
        result = mark_occupied(result, Grid(x_, y_, size))
    return result


def _edge(known: GridMap, part: int, parts: int) -> set[Cell]:
    """The cells of a strip with room for a robot, beside a cell of which nothing is known."""
    unknown = {c for c in _cells(known) if not is_known(known, Grid(*c, known.resolution))}
    return {(x, y) for x, y in _room(known, part, parts) if any((x + i, y + j) in unknown for i, j in NEAR)}


def _room(known: GridMap, part: int, parts: int) -> set[Cell]:
    """The cells of a strip that are known to be free and have nothing occupied around them."""
    west = known.x + known.width * part // parts + (1 if part > 0 else 0)
    east = known.x + known.width * (part + 1) // parts - (1 if part < parts - 1 else 0)
    taken = {c for c in _cells(known) if is_occupied(known, Grid(*c, known.resolution))}
    return {
        (x, y)
        for x, y in _cells(known)
        if west <= x < east
        and is_known(known, Grid(x, y, known.resolution))
        and not any((x + i, y + j) in taken for i, j in AROUND)
    }


def _cells(m: GridMap) -> Iterator[Cell]:
    return ((m.x + i, m.y + j) for j in range(m.height) for i in range(m.width))
