"""Where the car may be on its way from a start: whether its footprint keeps its distance all along a curve.

A curve is looked at where it says how far no place of the outline can get into anything: from a pose with some slack,
the car goes on until that slack may be used up, whichever way it turns. So a curve that is found clear is clear between
the poses as well; the narrower it is, the more of them are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from targets.car.curves import Curve, Triple
from targets.car.planner import Area
from targets.car.shapes import Footprint, Shape, standing
from targets.planning.world import World

FAR = 0.5  # metres of slack: more is not told apart
CELL = 0.5  # metres: what is near is remembered for squares of this size
LEAST_STEP = 0.004  # metres between two poses that are looked at
PAD = 0.006  # metres kept besides on planned ways: the outline moves less than this in a least step
LEAVING = 0.95  # of the distance that the start has from what is too near: so much is kept on the way out
MARGIN = 0.05  # metres kept from the arena's edge, for tracking errors
FENCE_STEP = 0.02  # metres between two looks at the fence: an arc bulges less than 0.1 mm in between

Kept = tuple[float, float, float, float, float, Shape]  # west, south, east, north, distance kept, shape


class Things:
    """Shapes, each with the distance that is kept from it, and which of them are near a place."""

    def __init__(self, kept: list[Kept], reach: float) -> None:
        """`reach`: metres from the middle of the footprint within which it may get to something."""
        self.kept = kept
        self._reach = reach + CELL  # a cell's middle is less than that from its corners
        self._near: dict[tuple[int, int], list[Kept]] = {}

    def around(self, x: float, y: float) -> list[Kept]:
        """What may be within reach of a footprint whose middle is there."""
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
        self.pace = body.pace(curvature)
        self.middle = body.length / 2 - body.overhang
        self.round = math.hypot(body.length, body.width) / 2
        self.fixed = self.things((*shape.bounds, clearance, shape) for shape in fixed)

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
        told = [(shape, self._beginning(shape)) for shape in seen]
        own = [(*shape.bounds, kept, shape) for shape, kept in told if kept is not None]
        self._things = [ground.fixed]
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

    def _beginning(self, shape: Shape) -> float | None:
        """The distance to keep from a shape; None: the car is in it."""
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
        return clearance if away >= clearance + PAD else LEAVING * away - PAD

    def _middle(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        return x + self._ground.middle * math.cos(yaw), y + self._ground.middle * math.sin(yaw)

    def slack(self, x: float, y: float, yaw: float) -> float:
        """How much nearer anything may come, metres, at most FAR; below 0 when it is too near, or the car outside."""
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

    def beside(self, x: float, y: float) -> bool:
        """Whether the reference point may be there, whatever the heading: half the outline's width is always around
        it, if no end of the outline is nearer."""
        body = self._ground.body
        around = min(body.width / 2, body.overhang, body.front)
        if around < 0 or not self._area.contains(x, y):
            return around < 0
        for things in self._things:
            for west, south, east, north, kept, shape in things.around(x, y):
                reach = around + kept
                dx = west - x if x < west else x - east if x > east else 0.0
                dy = south - y if y < south else y - north if y > north else 0.0
                if dx < reach and dy < reach and dx * dx + dy * dy < reach * reach and shape.near(x, y) < reach:
                    return False
        return True

    def obstacle(self, x: float, y: float, yaw: float) -> str:
        """The name of what is too near at a pose; "" when nothing is."""
        for things in self._things:
            for *_, kept, shape in things.around(*self._middle(x, y, yaw)):
                if self._ground.body.distance(x, y, yaw, shape) < kept + PAD:
                    return shape.name
        return ""

    def clear(self, curve: Curve, pad: float = PAD) -> bool:
        """Whether the car keeps its distances, and `pad` more, all along."""
        return self.open(curve.at, curve.length, pad)

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


def area(world: World, margin: float = MARGIN) -> Area:
    """Where the reference point may be."""
    lo, hi = world.arena.lo, world.arena.hi
    (west, east), (south, north) = sorted((lo.x, hi.x)), sorted((lo.y, hi.y))
    margin = min(margin, (east - west) / 2, (north - south) / 2)
    return Area(west + margin, south + margin, east - margin, north - margin)


def ground(world: World) -> Ground:
    """The car and what stands there. Raises ZeroDivisionError for a car that turns on the spot."""
    body = Footprint(*world.footprint, world.overhang)
    fixed = standing(world.obstacles, world.height)
    return Ground(body, 1 / world.turning_radius, area(world), fixed, world.clearance)
