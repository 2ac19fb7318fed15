"""Seeded arenas of 7 x 8 x 3 m with obstacles of all kinds, a lattice to search them, and python-fcl as a checker."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import fcl
import numpy as np

from koordgen.runtime.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.settings import Box
from koordgen.runtime.values import Point
from targets.planning.ask import Asked
from targets.planning.room import Room, fixed
from targets.planning.world import Path, Scene, World
from tests.planning.own import Lattice

ARENA = Box(Point(0.0, 0.0, 0.5), Point(7.0, 8.0, 3.0))
RADIUS, CLEARANCE = 0.2, 0.1
KEPT = RADIUS + CLEARANCE
START, GOAL = Point(0.4, 0.4, 1.5), Point(6.6, 7.6, 1.5)
NOWHERE = Scene()
GRAZE = 1e-3  # metres: by how much less than is kept the checker looks, for its own rounding


class Fine(Lattice):
    step = 0.2


def arena(seed: int) -> tuple[Obstacle, ...]:
    """Obstacles of all kinds that leave start and goal free."""
    source = random.Random(seed)
    found: list[Obstacle] = []
    wanted = source.randint(8, 20)
    while len(found) < wanted:
        body = _body(source)
        here = Room(START)
        here.keep(fixed((body,)), KEPT)
        if here.clear(GOAL, GOAL) and fixed((body,))[0].distance(START, START, KEPT) > KEPT:
            found.append(body)
    return tuple(found)


def _body(source: random.Random) -> Obstacle:
    x, y, size, high = source.uniform(0, 7), source.uniform(0, 8), source.uniform(0.15, 0.9), source.uniform(1.0, 3.5)
    match source.randrange(5):
        case 0:
            return Block(Point(x - size, y - size / 2, 0.0), Point(x + size, y + size / 2, high))
        case 1:
            return Block(Point(x - 0.1, y - 2 * size, 0.0), Point(x + 0.1, y + 2 * size, 3.5))  # a wall
        case 2:
            return Sphere(Point(x, y, source.uniform(0.5, 2.5)), size)
        case 3:
            return Cylinder(Point(x, y, 0.0), size / 2, high)
    top = Point(x, y, high)  # a pyramid
    around = [Point(x + size * math.cos(a), y + size * math.sin(a), 0.0) for a in (0.3, 1.9, 3.4, 5.0)]
    return Mesh((top, *around), ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)))


class Checker:
    """Independent of the planners: python-fcl."""

    def __init__(self, bodies: tuple[Obstacle, ...]) -> None:
        self.objects = [_fcl(body) for body in bodies]

    def collides(self, path: Path, kept: float = KEPT - GRAZE) -> bool:
        for a, b in pairwise(path):
            ball = capsule(a, b, kept)
            for thing in self.objects:
                if fcl.collide(ball, thing, fcl.CollisionRequest(), fcl.CollisionResult()):
                    return True
        return False


def _fcl(body: Obstacle) -> Any:
    match body:
        case Block(lo, hi):
            shape, middle = fcl.Box(hi.x - lo.x, hi.y - lo.y, hi.z - lo.z), (lo + hi) / 2
        case Sphere(middle, r):
            shape = fcl.Sphere(r)
        case Cylinder(base, r, h):
            shape, middle = fcl.Cylinder(r, h), Point(base.x, base.y, base.z + h / 2)
        case Mesh(vertices, faces):
            shape, middle = fcl.BVHModel(), Point()
            shape.beginModel(len(vertices), len(faces))
            shape.addSubModel(np.array([(p.x, p.y, p.z) for p in vertices]), np.array(faces))
            shape.endModel()
    return fcl.CollisionObject(shape, fcl.Transform(np.array((middle.x, middle.y, middle.z))))


def capsule(a: Point, b: Point, radius: float) -> Any:
    """A ball swept from a to b: fcl's lies along z."""
    d = np.array((b.x - a.x, b.y - a.y, b.z - a.z))
    long = float(np.linalg.norm(d))
    along = d / long if long else np.array((0.0, 0.0, 1.0))
    aside = np.cross(along, (1.0, 0.0, 0.0) if abs(along[0]) < 0.7 else (0.0, 1.0, 0.0))
    aside /= np.linalg.norm(aside)
    turn = np.column_stack((aside, np.cross(along, aside), along))
    middle = np.array(((a.x + b.x) / 2, (a.y + b.y) / 2, (a.z + b.z) / 2))
    return fcl.CollisionObject(fcl.Capsule(radius, long), fcl.Transform(turn, middle))


def many(seeds: list[int], count: int) -> tuple[int, int, int]:
    """Of so many random ways: found, colliding, infeasible by start or goal."""
    found = colliding = none = 0
    for k in range(count):
        source = random.Random(f"{k}")
        bodies = arena(seeds[k % len(seeds)])
        asked, checker = Asked("rrt-smoothed", World(ARENA, bodies, CLEARANCE, RADIUS)), Checker(bodies)
        lo, hi = ARENA.lo, ARENA.hi
        ends = [Point(source.uniform(lo.x, hi.x), source.uniform(lo.y, hi.y), source.uniform(lo.z, hi.z)) for _ in "sg"]
        if checker.collides(
            (ends[0], ends[0]), KEPT + GRAZE
        ):  # a start too near to something may come nearer: left out
            none += 1
            continue
        path, why = asked.answer(ends[0], ends[1], NOWHERE, 0.007)
        none += bool(why)
        found += bool(path)
        colliding += bool(path) and checker.collides(path)
    return found, colliding, none
