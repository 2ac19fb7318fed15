"""Representations of a planned path, for the planner's messages and for the tracker, and planning of single arcs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby

import msgspec

from targets.car.planning.curves import Curve, Piece, Triple, along, seen_from

JUDGE = "targets.car.planning.ask:CarJudge"
SPACING = 0.05  # maximum metres between the poses of a path
REVERSE_PRICE = 0.1  # additional cost (m) of each metre in reverse
GEAR_PRICE = 0.5  # cost (m) of a change of gear, for which the car has to stop
SHORTEST_ARC = 0.005  # metres; `arc` returns no shorter arcs
SLIVER = 1e-4  # metres; shorter pieces are left out of a path
NEAR_POINTS = 0.1  # maximum metres between a path and the polyline of points that represents it

Point2 = tuple[float, float]


class Wish(msgspec.Struct, frozen=True, array_like=True):
    """Further data of a question to a car's planner: radians, seconds."""

    yaw: float = 0.0  # yaw of the car
    gear: int = 0  # direction in which the car rolls: 1 forward, -1 reverse, 0: it stands
    heading: float | None = None  # required heading at the goal; None: any
    arrival: float | None = None  # heading at the present path's end; also tried, so that a new path resembles it
    time_limit: float = 0.0  # time limit that counts if no path was found within the question's `seconds`


class Plan(msgspec.Struct, frozen=True, array_like=True):
    """Further data of an answer: the curve. Answers of a user's own planner have points only, and no Plan."""

    start: Triple
    pieces: tuple[Piece, ...]


@dataclass(frozen=True, slots=True)
class PathPose:
    """Pose on a path: metres and radians in local ENU; `yaw` is continuous along the path.

    `curvature` (1/m) is tan(steering)/wheelbase: positive if the wheels point to the left, in either gear."""

    x: float
    y: float
    yaw: float
    curvature: float


@dataclass(frozen=True, slots=True)
class Segment:
    """Part of a path in one gear: direction 1 is forward, -1 reverse. It has two poses or more; length in metres."""

    direction: int
    poses: tuple[PathPose, ...]
    length: float


@dataclass(frozen=True, slots=True)
class Area:
    """Rectangle in which the car's reference point stays, metres, local ENU."""

    west: float
    south: float
    east: float
    north: float

    def contains(self, x: float, y: float) -> bool:
        return self.west <= x <= self.east and self.south <= y <= self.north

    def depth(self, x: float, y: float) -> float:
        """Return the distance (m) of a place in the area from the area's edge."""
        return min(x - self.west, self.east - x, y - self.south, self.north - y)

    def with_point(self, x: float, y: float) -> Area:
        """Return the smallest area that contains this one and a point.

        It lets a car drive back whose position is outside the geofence because of noise."""
        return Area(min(self.west, x), min(self.south, y), max(self.east, x), max(self.north, y))


def segments(curve: Curve) -> list[Segment]:
    """Return a curve, split at each change of gear, as segments for the tracker."""
    found = []
    at = curve.start
    for forward, group in groupby((p for p in curve.pieces if abs(p[1]) > SLIVER), key=lambda piece: piece[1] > 0):
        pieces = tuple(group)
        poses = [PathPose(*at, pieces[0][0])]
        for curvature, way in pieces:
            steps = math.ceil(abs(way) / SPACING - 1e-9)
            poses += [PathPose(*along(at, curvature, way * i / steps), curvature) for i in range(1, steps + 1)]
            at = along(at, curvature, way)
        found.append(Segment(1 if forward else -1, tuple(poses), sum(abs(way) for _, way in pieces)))
    return found


def price(pieces: tuple[Piece, ...], gear: int = 0) -> float:
    """Return the cost of driving these pieces, in metres. `gear`: direction in which the car rolls (0: it stands)."""
    total = 0.0
    for _, way in pieces:
        total += way if way > 0 else -way * (1 + REVERSE_PRICE)
        if gear * way < 0:
            total += GEAR_PRICE
        gear = 1 if way > 0 else -1
    return total


def points(curve: Curve) -> list[Point2]:
    """Return a few points that represent a curve, the curve's first and last point among them.

    The polyline of these points and the curve are nowhere farther than NEAR_POINTS apart. The function samples the
    curve, also where pieces meet, so it samples each change of gear. Between two samples an arc bulges by less than
    SPACING ** 2 / 8 times its curvature; the allowed distance is reduced by that."""
    places = [curve.start[:2]]
    at, bend = curve.start, 0.0
    for curvature, way in curve.pieces:
        steps = max(1, math.ceil(abs(way) / SPACING))
        places += [along(at, curvature, way * i / steps)[:2] for i in range(1, steps + 1)]
        at, bend = along(at, curvature, way), max(bend, abs(curvature))
    last = len(places) - 1
    kept = [0, last]
    for begin, end in (todo := [(0, last)]):
        off, i = max(
            ((_off(places[begin], places[end], places[i]), i) for i in range(begin + 1, end)), default=(0.0, 0)
        )
        if off > NEAR_POINTS - bend * SPACING**2 / 8:
            kept.append(i)
            todo += [(begin, i), (i, end)]
    return [places[i] for i in sorted(kept)]


def _off(a: Point2, b: Point2, p: Point2) -> float:
    """Return the distance (m) of the point p from the straight line between the points a and b."""
    ex, ey, px, py = b[0] - a[0], b[1] - a[1], p[0] - a[0], p[1] - a[1]
    square = ex * ex + ey * ey
    share = max(0.0, min(1.0, (px * ex + py * ey) / square)) if square else 0.0
    return math.hypot(px - share * ex, py - share * ey)


def arc(
    radius: float, start: Triple, goal: Point2, gear: int, tolerance: float, through: Point2 | None = None
) -> Curve | None:
    """Return one arc in one gear that ends within `tolerance` metres of the goal; None if there is none.

    It serves a target that has moved by centimetres. `gear`: 1 forward, -1 reverse, 0 either. The arc passes through
    the goal, or through the point `through` beyond it, as far as the turning radius (m) allows."""
    ahead, aside, _ = seen_from(start, (*(goal if through is None else through), 0.0))
    bend = max(-1 / radius, min(1 / radius, 2 * aside / max(math.hypot(ahead, aside), 1e-9) ** 2))
    bend = math.copysign(max(abs(bend), 1e-6), bend)  # a straight line is represented by an arc of 1000 km radius
    ahead, aside, _ = seen_from(start, (*goal, 0.0))
    # Signed length (m) of the arc up to its place nearest to the goal.
    way = math.atan2(bend * ahead, 1 - bend * aside) / bend
    if abs(way) < SHORTEST_ARC or gear * way < 0 or abs(way) > math.pi / 2 * radius:
        return None
    curve = Curve(start, ((bend, way),))
    return curve if math.dist(curve.end[:2], goal) <= tolerance else None
