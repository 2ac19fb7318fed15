"""Collision check of the car's footprint along a curve.

The check of a pose returns its slack: the distance (m) that every place of the outline can move without a collision.
The next checked pose is as far away as this slack allows, whichever way the car turns. So a curve that is found clear
is also clear between the checked poses, and a narrow place needs more checks. A search first checks many single poses
at once (`Terrain.free`); that check does not cover the path between the poses.
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

FAR = 0.5  # maximum slack (m) that `Terrain.slack` returns
CELL = 0.5  # metres: width of the square cells for which nearby obstacles are cached
LEAST_STEP = 0.004  # minimum distance (m) between two checked poses
PAD = 0.006  # metres added to the distances of planned paths; the outline moves less than this in LEAST_STEP

# If an obstacle is too near to the car at the start, the path keeps this share of the start's distance from it.
LEAVING = 0.95
# Lower limit of the distance that LEAVING gives, as a share of the clearance; it applies if the start is farther away.
# Without this limit, a car that plans again and again, from ever nearer places, would touch the obstacle in the end.
LEAST = 0.5
MARGIN = 0.05  # metres kept from the arena's edge, for tracking errors
POINT = Footprint(0.02, 0.02, 0.01)  # metres: an outline that is nearly a point, for a search's distance field
WIDE = 0.17  # width of a distance field's cells, in turning radii
DIP = 0.0015  # metres added to the distances at an arc's samples: between them the outline may come nearer by 2 mm
FENCE_STEP = 0.02  # metres between two checks of the geofence; between them an arc bulges by less than 0.1 mm

Kept = tuple[float, float, float, float, float, Shape]  # bounds (west, south, east, north), distance to keep (m), shape


class Things:
    """Obstacles with a spatial index. Each obstacle is a shape and the distance (m) to keep from it."""

    def __init__(self, kept: list[Kept], reach: float) -> None:
        """`reach`: distance (m) from the footprint's middle within which obstacles are checked."""
        self.kept = kept
        self._reach = reach + CELL  # the middle of a cell is less than CELL from its corners
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
    """Fixed surroundings of a car: its outline, its area and the obstacles of the fleet file. Metres, local ENU."""

    def __init__(self, body: Footprint, curvature: float, area: Area, fixed: Iterable[Shape], clearance: float) -> None:
        """`curvature`: maximum curvature (1/m). `clearance`: distance (m) to keep between outline and obstacles."""
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
        """Square cells that cover the car's area, for distance fields."""
        return Cells(self.area, WIDE * self._radius)

    @cached_property
    def passable(self) -> Mask:
        """Mask of the cells whose middle is at least the clearance away from all fixed obstacles."""
        return _passable(self.table, self.cells)

    def table_of(self, kept: list[tuple[Shape, float]]) -> ShapeTable:
        """Return a table of shapes, each with its distance to keep (m), to check many poses at once."""
        area, out = self.area, self.body.reach
        extent = (area.west - out, area.south - out, area.east + out, area.north + out)
        return ShapeTable([shape for shape, _ in kept], [away for _, away in kept], self.body, extent)

    def things(self, kept: Iterable[Kept]) -> Things:
        return Things(list(kept), self.round + FAR)

    def around(self, start: Triple, goal: tuple[float, float], seen: Iterable[Shape] = ()) -> Terrain:
        """Return the surroundings for one question; `seen` are obstacles that the program or other robots reported."""
        return Terrain(self, start, goal, seen)


class Terrain:
    """Terrain of a car for one question: fixed obstacles, reported obstacles and the area.

    `inside`: name of the first fixed obstacle that overlaps the car at the start; "" if there is none. A reported
    obstacle that overlaps the car there is ignored: its position is wrong, or it is the car itself. From other
    obstacles that are too near at the start, a path keeps nearly the start's distance (LEAVING). Start and goal may be
    in the margin of the area."""

    def __init__(self, ground: Ground, start: Triple, goal: tuple[float, float], seen: Iterable[Shape]) -> None:
        self._ground, self._start = ground, start
        self._area = ground.area.with_point(start[0], start[1]).with_point(*goal)
        self.inside = ""
        near = {id(shape): self._beginning(shape) for *_, shape in ground.fixed.around(*self._middle(*start))}
        told = [(shape, kept) for shape in seen if (kept := self._beginning(shape)) is not None]
        own = [(*shape.bounds, kept, shape) for shape, kept in told]
        self._things = [ground.fixed]
        self._reported, self._near = told, near
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
        """Area in which the car's reference point may be; it contains start and goal."""
        return self._area

    @cached_property
    def _tables(self) -> list[ShapeTable]:
        """Tables of fixed and of reported obstacles. Built at first use, because not every question needs them."""
        ground, near = self._ground, self._near
        away = [kept for *_, shape in ground.fixed.kept if (kept := near.get(id(shape), ground.clearance)) is not None]
        changed = any(kept != ground.clearance for kept in away)
        fixed = ground.table.lowered(away) if changed else ground.table
        return [fixed, ground.table_of(self._reported)] if self._reported else [fixed]

    @property
    def cells(self) -> Cells:
        """Square cells that cover the car's area, for distance fields."""
        return self._ground.cells

    def passable(self) -> Mask:
        """Return the mask of the cells whose middle keeps the required distances from all obstacles."""
        told = self._tables[1:]
        return self._ground.passable & _passable(told[0], self.cells) if told else self._ground.passable

    def free(self, x: Floats, y: Floats, yaw: Floats) -> Mask:
        """Return for each pose whether the car is in its area and keeps its distances, plus PAD and DIP."""
        area = self._area
        free: Mask = (area.west <= x) & (x <= area.east) & (area.south <= y) & (y <= area.north)
        for table in self._tables:
            free &= table.free(self._ground.body, x, y, yaw, PAD + DIP)
        return free

    def _beginning(self, shape: Shape) -> float | None:
        """Return the distance (m) to keep from a shape; None if the car overlaps it at the start."""
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
        """Return the slack of a pose (m), at most FAR; negative outside of the area or too near to an obstacle."""
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
        """Return the name of an obstacle that is too near to the car at a pose; "" if there is none."""
        for things in self._things:
            for *_, kept, shape in things.around(*self._middle(x, y, yaw)):
                if self._ground.body.distance(x, y, yaw, shape) < kept + PAD:
                    return shape.name
        return ""

    def clear(self, curve: Curve, pad: float = PAD) -> bool:
        """Return whether the car keeps its distances, and `pad` metres more, along a whole curve.

        The ends of pieces are checked, too: at a change of gear, the car could leave the area and return between two
        checked poses."""
        area = self._area
        return all(area.contains(x, y) for x, y, _ in curve.ends) and self.open(curve.at, curve.length, pad)

    def is_fully_clear(self, curve: Curve) -> bool:
        """Return whether the car keeps its distances along a whole curve, also between the checked poses."""
        return self.clear(curve, min(PAD, self._ground.pace * LEAST_STEP))

    def open(self, at: Callable[[float], Triple], length: float, pad: float = PAD) -> bool:
        """Return whether the car keeps its distances at all poses `at(station)`, for stations from 0 to `length` (m).

        The search bisects: it checks the middle of each stretch first, so that it finds an obstacle early."""
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
    """Return the area of the reference point: the arena less a margin (m) at each edge."""
    lo, hi = world.arena.lo, world.arena.hi
    (west, east), (south, north) = sorted((lo.x, hi.x)), sorted((lo.y, hi.y))
    margin = min(margin, (east - west) / 2, (north - south) / 2)
    return Area(west + margin, south + margin, east - margin, north - margin)


def ground(world: World) -> Ground:
    """Return the fixed surroundings of a car. Raises ZeroDivisionError if its turning radius is 0."""
    body = Footprint(*world.footprint, world.overhang)
    fixed = standing(world.obstacles, world.height)
    return Ground(body, 1 / world.turning_radius, area(world), fixed, max(world.clearance, world.error))
