"""Extern functions of mapper.koord: choice of the next place to look at, obstacles, maps from scans, and completeness.

All functions are pure: for the same map and scan they return the same value on every robot. Lengths in metres, local
ENU frame. The map is divided into strips from west to east, one for each robot, which drives only within its strip.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache

from koordgen.runtime.values.gridmap import FREE, OCCUPIED, GridMap, cell, center, merge
from koordgen.runtime.values.points import Grid, Point, Scan

Cell = tuple[int, int]
NEAR = ((1, 0), (-1, 0), (0, 1), (0, -1))
GAP = 0.5  # metres from a strip's edge to the next strip; at least one cell
BODY = 0.9  # metres around a robot's published position within which a scan may show the robot: its body, and
# the distance that it drives until it publishes again


def pickFrontierPos(known: GridMap, own: Point, part: int, parts: int, refused: list[Point]) -> Point:
    """Return the frontier position with the shortest drive; without a drivable one, the nearest in a straight line.

    A frontier is a free cell beside unknown cells. Without any frontier, return the robot's position.
    """
    edge = _left(known, part, parts, refused)
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
    """Return the cells that are known to be occupied."""
    return [Grid(x, y, known.resolution) for (x, y), code in _codes(known).items() if code == OCCUPIED]


def explored(known: GridMap, part: int, parts: int, refused: list[Point]) -> bool:
    """Return whether a strip has no frontier left that the robot could drive to."""
    return not _left(known, part, parts, refused)


def scanToMap(own: Point, seen: Scan, area: GridMap, robots: list[Point], me: int) -> GridMap:
    """Return the map of one scan, in the window of `area`: crossed cells are free, cells at ends of rays are occupied.

    Ends of rays at another robot are left out.
    """
    size = area.resolution
    others = [p for pid, p in enumerate(robots) if pid != me]
    free: set[Cell] = set()
    hit: set[Cell] = set()
    for angle, range_ in zip(seen.angles, seen.ranges, strict=True):
        east, north = math.cos(angle), math.sin(angle)
        steps = max(1, int(3 * range_ / size))
        for i in range(steps):
            way = range_ * i / steps
            free.add((math.floor((own.x + way * east) / size), math.floor((own.y + way * north) / size)))
        if range_ < seen.max_range:
            way = range_ + 1e-6  # the surface belongs to the cell behind it
            x, y = own.x + way * east, own.y + way * north
            if all(math.hypot(x - p.x, y - p.y) > BODY for p in others):
                hit.add((math.floor(x / size), math.floor(y / size)))
    return merge(_marked(area, free, FREE), _marked(area, hit, OCCUPIED))


def _marked(area: GridMap, cells: set[Cell], code: int) -> GridMap:
    """Return a map in which only these cells are known."""
    bits = bytearray(len(area.cells))
    for x, y in cells:
        i, j = x - area.x, y - area.y
        if 0 <= i < area.width and 0 <= j < area.height:
            k = j * area.width + i
            bits[k >> 2] |= code << 2 * (k & 3)
    return GridMap(area.resolution, area.x, area.y, area.width, area.height, bytes(bits))


def _left(known: GridMap, part: int, parts: int, refused: list[Point]) -> frozenset[Cell]:
    """Return the frontier cells, except those that no path reached."""
    places = (cell(p, known.resolution) for p in refused)
    return _edge(known, part, parts).difference((g.x, g.y) for g in places)


@lru_cache(maxsize=64)  # several calls use the same map in each round
def _edge(known: GridMap, part: int, parts: int) -> frozenset[Cell]:
    """Return the cells of a strip with room for a robot that are beside an unknown cell.

    At the strip's edge these are also cells from which free cells lead across the gap to an unknown one."""
    codes = _codes(known)
    room, columns = _room(known, part, parts), _columns(known, part, parts)
    found = {(x, y) for x, y in room if any(codes.get((x + i, y + j)) == 0 for i, j in NEAR)}
    sides = [(columns[0], -1)] * (part > 0) + [(columns[-1], 1)] * (part < parts - 1) if columns else []
    for x, step in sides:
        for y in range(known.y, known.y + known.height):
            across = [codes.get((x + step * k, y)) for k in range(1, _gap(known) + 1)]
            if (x, y) in room and 0 in across and OCCUPIED not in across[: across.index(0)]:
                found.add((x, y))
    return frozenset(found)


def _gap(known: GridMap) -> int:
    """Return the number of cells from a strip's edge to the next strip."""
    return max(1, math.ceil(GAP / known.resolution))


def _columns(known: GridMap, part: int, parts: int) -> range:
    """Return the columns of a strip in which its robot may drive."""
    west = known.x + known.width * part // parts + (_gap(known) if part > 0 else 0)
    return range(west, known.x + known.width * (part + 1) // parts - (_gap(known) if part < parts - 1 else 0))


@lru_cache(maxsize=64)
def _room(known: GridMap, part: int, parts: int) -> frozenset[Cell]:
    """Return the free cells of a strip with no occupied cell within the distance that a car needs."""
    codes, columns = _codes(known), _columns(known, part, parts)
    reach = range(-_need(known.resolution), _need(known.resolution) + 1)
    around = [(i, j) for i in reach for j in reach]
    return frozenset(
        (x, y)
        for (x, y), code in codes.items()
        if x in columns and code == FREE and not any(codes.get((x + i, y + j)) == OCCUPIED for i, j in around)
    )


def _need(size: float) -> int:
    """Return the number of cells around a place that a car needs."""
    return max(1, math.ceil(0.3 / size))


@lru_cache(maxsize=8)
def _codes(m: GridMap) -> dict[Cell, int]:
    """Return the state of each cell of the window, row by row: 0 unknown, FREE, OCCUPIED."""
    cells = ((m.x + i, m.y + j) for j in range(m.height) for i in range(m.width))
    return {c: (m.cells[k >> 2] >> 2 * (k & 3)) & 3 for k, c in enumerate(cells)}
