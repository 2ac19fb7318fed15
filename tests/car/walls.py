"""Rooms with walls to plan in, by seed: doors, dead ends, U shapes and pairs of walls with offset doors.

Each room is ROOM of `scenes.py`, 7 m by 8 m. Walls are 0.1 m thick; doors and corridors are 0.6 to 0.9 m wide, for a
car of 0.28 m that keeps 0.1 m on either side. A query is a pose of the car and a goal place, on different sides of the
walls. `SOLVABLE` lists the queries for which a drivable way is known.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass

from koordgen.runtime.obstacles import Block, Obstacle
from koordgen.runtime.values import Point
from targets.car.curves import Triple
from tests.car.exact import gap, outline
from tests.car.scenes import CAR, world

Place = tuple[float, float]

KINDS = ("door", "dead end", "U shape", "offset doors")
QUERIES = 5  # of a room
HALF = 0.05  # metres: half a wall's thickness
LOW, WIDE, LONG = 0.0, 7.0, 8.0  # metres: the room's walls


@dataclass(frozen=True, slots=True)
class Query:
    """From a pose to a place. `heading` is one at which the car can stand there."""

    start: Triple
    goal: Place
    heading: float


@dataclass(frozen=True, slots=True)
class Room:
    """Walls, and the queries in between."""

    kind: str
    walls: tuple[Obstacle, ...]
    queries: tuple[Query, ...]


def room(seed: int) -> Room:
    """The room of a seed; its kind is one of KINDS in turn."""
    dice = random.Random(1000 + seed)
    kind = KINDS[seed % len(KINDS)]
    walls, inside, outside = _BUILDERS[kind](dice)
    while len(walls) < 12 and dice.random() < 0.7:  # some things besides
        x, y, size = dice.uniform(0.5, WIDE - 0.5), dice.uniform(0.5, LONG - 0.5), dice.uniform(0.1, 0.3)
        walls.append(_block(x - size, y - size, x + size, y + size))
    if dice.random() < 0.5:  # the other way round: the room is turned by half a circle
        walls = [_block(WIDE - b.hi.x, LONG - b.hi.y, WIDE - b.lo.x, LONG - b.lo.y) for b in walls]
        inside, outside = _turned(inside), _turned(outside)
    queries = []
    for i in range(QUERIES):
        begin, end = (inside, outside) if i % 2 == 0 else (outside, inside)
        x, y, heading = _free(dice, walls, end)
        queries.append(Query(_free(dice, walls, begin), (x, y), heading))
    return Room(kind, tuple(walls), tuple(queries))


Region = tuple[float, float, float, float]  # west, south, east, north
Built = tuple[list[Block], Region, Region]


def _door(dice: random.Random) -> Built:
    """A wall across the room with one door."""
    y, width = dice.uniform(2.5, 5.5), dice.uniform(0.6, 0.9)
    x = dice.uniform(0.3, WIDE - 0.3 - width)
    return _wall_with_door(y, x, width), (LOW, LOW, WIDE, y - 0.4), (LOW, y + 0.4, WIDE, LONG)


def _dead_end(dice: random.Random) -> Built:
    """A corridor that ends blindly: the car is in it, or is to drive into it."""
    width, deep = dice.uniform(0.6, 0.9), dice.uniform(1.2, 2.5)
    x, y = dice.uniform(1.0, 5.0), dice.uniform(2.0, 3.5)
    walls = [
        _block(x - 2 * HALF, y, x, y + deep),
        _block(x + width, y, x + width + 2 * HALF, y + deep),
        _block(x - 2 * HALF, y - 2 * HALF, x + width + 2 * HALF, y),
    ]
    return walls, (x, y, x + width, y + deep), (LOW, LOW, WIDE, y - 0.4)


def _u_shape(dice: random.Random) -> Built:
    """Three walls, open to the side that is away from where the other end of the way lies."""
    wide, deep = dice.uniform(1.4, 3.0), dice.uniform(1.0, 2.5)
    x, y = dice.uniform(0.8, WIDE - 0.8 - wide), dice.uniform(2.2, 3.6)
    walls = [
        _block(x - HALF, y, x + HALF, y + deep),
        _block(x + wide - HALF, y, x + wide + HALF, y + deep),
        _block(x - HALF, y - HALF, x + wide + HALF, y + HALF),
    ]
    mouth = dice.uniform(0.6, 0.9)  # a lip on either side narrows the opening
    left = dice.uniform(0.0, wide - mouth)
    for west, east in ((x, x + left), (x + left + mouth, x + wide)):
        if east - west > 0.1:
            walls.append(_block(west, y + deep - HALF, east, y + deep + HALF))
    return walls, (x, y, x + wide, y + deep), (LOW, LOW, WIDE, y - 0.4)


def _offset(dice: random.Random) -> Built:
    """Two walls across the room, each with a door, one door not in front of the other."""
    y, between = dice.uniform(2.0, 4.0), dice.uniform(0.9, 1.5)
    walls: list[Block] = []
    x = dice.uniform(0.5, 2.5)
    for level in (y, y + between):
        width = dice.uniform(0.6, 0.9)
        walls += _wall_with_door(level, x, width)
        x += dice.uniform(1.2, 3.0)
    return walls, (LOW, LOW, WIDE, y - 0.4), (LOW, y + between + 0.4, WIDE, LONG)


_BUILDERS = {"door": _door, "dead end": _dead_end, "U shape": _u_shape, "offset doors": _offset}


def _wall_with_door(y: float, x: float, width: float) -> list[Block]:
    return [_block(LOW - 1, y - HALF, x, y + HALF), _block(x + width, y - HALF, WIDE + 1, y + HALF)]


def _block(west: float, south: float, east: float, north: float) -> Block:
    return Block(Point(west, south, 0.0), Point(east, north, 1.0))


def _turned(region: Region) -> Region:
    west, south, east, north = region
    return WIDE - east, LONG - north, WIDE - west, LONG - south


def _free(dice: random.Random, walls: list[Block], region: Region) -> Triple:
    """A pose in a region that keeps 2 cm more than it must."""
    empty = world()
    west, south, east, north = region
    while True:
        pose = dice.uniform(west, east), dice.uniform(south, north), dice.uniform(-math.pi, math.pi)
        corners = outline(empty, *pose)
        fits = all(0.1 <= x <= WIDE - 0.1 and 0.1 <= y <= LONG - 0.1 for x, y in corners)
        if fits and min(gap(corners, wall) for wall in walls) > CAR.clearance + 0.02:
            return pose


ROOMS = 64
# No planner that we had finds a way here in 6 s of CPU time: neither this one nor trees of curves (RRT-Connect).
# Nearly all have none: something stands in the door or fills the corridor, or the walls are too close for the car.
UNSOLVED = frozenset(
    [(seed, i) for seed in (11, 15, 16, 17, 27) for i in range(QUERIES)] + [(1, 2), (29, 4), (45, 0), (49, 2), (57, 2)]
)


def solvable() -> Iterator[tuple[int, int]]:
    """Yield seeds of rooms and numbers of queries for which a drivable way is known."""
    return ((seed, i) for seed in range(ROOMS) for i in range(QUERIES) if (seed, i) not in UNSOLVED)
