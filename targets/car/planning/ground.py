"""Collision check of the car's footprint along a curve.

A pose is checked, which gives its slack: the distance that every place of the outline can move without a collision. The
next checked pose is as far away as that slack allows, whichever way the car turns. So a curve that is found clear is
clear between the checked poses as well; in narrow places, more poses are checked. A search first checks many single
poses at once (`Way.free`); that check does not cover the path between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np

from targets.car.planning.curves import Curve, Triple
from targets.car.planning.field import Cells
from targets.car.planning.overlap import Floats, Mask, ShapeTable
from targets.car.planning.planner import Area
from targets.car.planning.shapes import Footprint, Shape, standing
from targets.planning.world import World

FAR = 0.5  # metres; a larger slack is reported as this
CELL = 0.5  # metres; width of the square cells for which near obstacles are cached
LEAST_STEP = 0.004  # minimum metres between two checked poses
PAD = 0.006  # metres kept in addition on planned paths: the outline moves by less than this in a least step
LEAVING = 0.95  # share of the start's distance from an obstacle that is too near, which is kept while leaving
# Lower limit of that distance as a share of the clearance, if the start has it. Without this limit, a car whose paths
# are planned again and again, from ever nearer places, would touch the obstacle in the end.
LEAST = 0.5
MARGIN = 0.05  # metres kept from the arena's edge, for tracking errors
POINT = Footprint(0.02, 0.02, 0.01)  # metres; nearly a point, for the distance field around obstacles of a search
WIDE = 0.17  # width of the cells of that distance field, in turning radii
DIP = 0.0015  # metres kept in addition at samples of an arc, between which the outline may come nearer by 2 mm
FENCE_STEP = 0.02  # metres between two checks of the geofence; an arc bulges by less than 0.1 mm in between

Kept = tuple[float, float, float, float, float, Shape]  # west, south, east, north, distance kept, shape


class Things:
    """Shapes, each with the distance that is kept from it, and which of them are near a place."""

    def __init__(self, kept: list[Kept], reach: float) -> None:
        """`reach`: metres from the middle of the footprint within which it may get to something."""
        self.kept = kept
        self._reach = reach + CELL  # a cell's middle is less than that from its corners
        self._near: dict[tuple[int, int], list[Kept]] = {}

    def around(self, x: float, y: float) -> list[Kept]:
        """Return the obstacles that a footprint with this centre may touch (broad phase)."""
        key = (math.floor(x / CELL), math.floor(y / CELL))
        found = self._near.get(key)
        if found is None:
            x, y, reach = (key[0] + 0.5) * CELL, (key[1] + 0.5) * CELL, self._reach
            found = self._near[key] = [
                thing
                for thing in self.kept
                if thing[0] - x < reach + thing[4]
                and x - thing[2] < reach + thing[4]
                and thing[1] - y < reach + thing[4]
                and y - thing[3] < reach + thing[4]
            ]
        return found


class Ground:
    """What does not change: the car, where it may be, and what stands there. Metres, local ENU."""

    def __init__(self, body: Footprint, curvature: float, area: Area, fixed: Iterable[Shape], clearance: float) -> None:
        """`curvature` is the sharpest, 1/m; `clearance` is kept between the outline and all else."""
        self.body, self.area, self.clearance = body, area, clearance
        self.least = LEAST * clearance
        self.pace = body.pace(curvature)
        self._radius = 1 / curvature
        self.middle = body.length / 2 - body.overhang
        self.round = math.hypot(body.length, body.width) / 2
        self.fixed = self.things((*shape.bounds, clearance, shape) for shape in fixed)
        self.table = self.table_of([(shape, clearance) for *_, shape in self.fixed.kept])

    @cached_property
    def cells(self) -> Cells:
        """The ground in cells."""
        return Cells(self.area, WIDE * self._radius)

    @cached_property
    def passable(self) -> Mask:
        """Which of the cells a point that keeps the car's distances may be in."""
        return _passable(self.table, self.cells)

    def table_of(self, kept: list[tuple[Shape, float]]) -> ShapeTable:
        """Return shapes, each with the distance that is kept from it, for checks of many poses."""
        area, out = self.area, self.body.reach
        extent = (area.west - out, area.south - out, area.east + out, area.north + out)
        return ShapeTable([shape for shape, _ in kept], [away for _, away in kept], self.body, extent)

    def things(self, kept: Iterable[Kept]) -> Things:
        return Things(list(kept), self.round + FAR)

    def around(self, start: Triple, goal: tuple[float, float], seen: Iterable[Shape] = ()) -> Way:
        """Of one question: with what others tell of."""
        return Way(self, start, goal, seen)


class Way:
    """`inside` names the first thing that stands there and that the car has a point in common with at the start, so
    that it cannot keep away from it; of what was only told, such is left out: it was seen wrongly, or is the car. From
    what else is too near at the start, nearly the distance there is kept. Start and goal may be in the margin."""

    def __init__(self, ground: Ground, start: Triple, goal: tuple[float, float], seen: Iterable[Shape]) -> None:
        self._ground, self._start = ground, start
        self._area = ground.area.with_point(start[0], start[1]).with_point(*goal)
        self.inside = ""
        near = {id(shape): self._beginning(shape) for *_, shape in ground.fixed.around(*self._middle(*start))}
        told = [(shape, kept) for shape in seen if (kept := self._beginning(shape)) is not None]
        own = [(*shape.bounds, kept, shape) for shape, kept in told]
        self._things = [ground.fixed]
        self._told, self._near = told, near
        if any(kept != ground.clearance for kept in near.values()):
            own += [
                (*shape.bounds, kept, shape)
                for *_, shape in ground.fixed.kept
                if (kept := near.get(id(shape), ground.clearance)) is not None
            ]
            self.inside = next((s.name for *_, s in ground.fixed.kept if near.get(id(s), 0.0) is None), "")
            self._things = []
        if own:
            self._things.append(ground.things(own))

    @property
    def area(self) -> Area:
        """Where the reference point may be."""
        return self._area

    @cached_property
    def _tables(self) -> list[ShapeTable]:
        """For `free`, which not every question needs."""
        ground, near = self._ground, self._near
        away = [kept for *_, shape in ground.fixed.kept if (kept := near.get(id(shape), ground.clearance)) is not None]
        changed = any(kept != ground.clearance for kept in away)
        fixed = ground.table.lowered(away) if changed else ground.table
        return [fixed, ground.table_of(self._told)] if self._told else [fixed]

    @property
    def cells(self) -> Cells:
        """The ground in cells."""
        return self._ground.cells

    def passable(self) -> Mask:
        """Return which of the cells a point that keeps the car's distances may be in."""
        told = self._tables[1:]
        return self._ground.passable & _passable(told[0], self.cells) if told else self._ground.passable

    def free(self, x: Floats, y: Floats, yaw: Floats) -> Mask:
        """Return for each of many poses whether the car keeps its distances there, and PAD more."""
        area = self._area
        free: Mask = (area.west <= x) & (x <= area.east) & (area.south <= y) & (y <= area.north)
        for table in self._tables:
            free &= table.free(self._ground.body, x, y, yaw, PAD + DIP)
        return free

    def _beginning(self, shape: Shape) -> float | None:
        """Return the distance to keep from a shape; None: the car is in it."""
        clearance = self._ground.clearance
        west, south, east, north = shape.bounds
        x, y = self._middle(*self._start)
        if (
            math.hypot(max(west - x, 0.0, x - east), max(south - y, 0.0, y - north))
            > self._ground.round + clearance + PAD
        ):
            return clearance
        away = self._ground.body.distance(*self._start, shape)
        if away < 0:
            return None
        if away >= clearance + PAD:
            return clearance
        nearly, least = LEAVING * away - PAD, self._ground.least
        return nearly if away < least + PAD else max(nearly, least)

    def _middle(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        return x + self._ground.middle * math.cos(yaw), y + self._ground.middle * math.sin(yaw)

    def slack(self, x: float, y: float, yaw: float) -> float:
        """Return the slack of a pose (m), at most FAR; below 0 if an obstacle is too near or the car outside."""
        if not self._area.contains(x, y):
            return -1.0
        best, around, distance = FAR, self._ground.round, self._ground.body.distance
        cx, cy = self._middle(x, y, yaw)
        for things in self._things:
            for west, south, east, north, kept, shape in things.around(cx, cy):
                dx = west - cx if cx < west else cx - east if cx > east else 0.0
                dy = south - cy if cy < south else cy - north if cy > north else 0.0
                reach = best + kept + around
                if dx < reach and dy < reach and dx * dx + dy * dy < reach * reach:
                    best = min(best, distance(x, y, yaw, shape) - kept)
                    if best < 0:
                        return best
        return best

    def obstacle(self, x: float, y: float, yaw: float) -> str:
        """Return the name of an obstacle that is too near at a pose; "" if there is none."""
        for things in self._things:
            for *_, kept, shape in things.around(*self._middle(x, y, yaw)):
                if self._ground.body.distance(x, y, yaw, shape) < kept + PAD:
                    return shape.name
        return ""

    def clear(self, curve: Curve, pad: float = PAD) -> bool:
        """Return whether the car keeps its distances, and `pad` more, all along a curve.

        The ends of pieces are checked, too: at a change of gear, the car could leave the area and return between two
        checked poses."""
        area = self._area
        return all(area.contains(x, y) for x, y, _ in curve.ends) and self.open(curve.at, curve.length, pad)

    def surely_clear(self, curve: Curve) -> bool:
        """Return whether the car keeps its distances all along, also between the poses that are looked at."""
        return self.clear(curve, min(PAD, self._ground.pace * LEAST_STEP))

    def open(self, at: Callable[[float], Triple], length: float, pad: float = PAD) -> bool:
        """The same of poses at stations from 0 to `length` metres. The middle first: what is in the way is met soon."""
        todo = [(0.0, length)]
        pace, area = self._ground.pace, self._area
        for begin, end in todo:
            middle = (begin + end) / 2
            x, y, yaw = at(middle)
            slack = self.slack(x, y, yaw) - pad
            if slack < 0:
                return False
            step = max(slack / pace, LEAST_STEP)
            if step > FENCE_STEP:
                step = max(min(step, area.depth(x, y)), FENCE_STEP)
            if middle - step > begin:
                todo.append((begin, middle - step))
            if middle + step < end:
                todo.append((middle + step, end))
        return True


def _passable(table: ShapeTable, cells: Cells) -> Mask:
    return table.free(POINT, cells.x, cells.y, np.zeros(len(cells.x)), 0.0)


def area(world: World, margin: float = MARGIN) -> Area:
    """Return the free space of the reference point."""
    lo, hi = world.arena.lo, world.arena.hi
    (west, east), (south, north) = sorted((lo.x, hi.x)), sorted((lo.y, hi.y))
    margin = min(margin, (east - west) / 2, (north - south) / 2)
    return Area(west + margin, south + margin, east - margin, north - margin)


def ground(world: World) -> Ground:
    """Return the car and what stands there. Raises ZeroDivisionError for a car that turns on the spot."""
    body = Footprint(*world.footprint, world.overhang)
    fixed = standing(world.obstacles, world.height)
    return Ground(body, 1 / world.turning_radius, area(world), fixed, max(world.clearance, world.error))
