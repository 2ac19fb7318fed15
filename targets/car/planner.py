"""Plans how a car gets to a point: the best Reeds-Shepp or Dubins curve over a set of headings at the goal.

OMPL measures and interpolates the curves. Of its Python binding only these calls are relied on: the two state spaces,
`allocState`, `setXY`, `setYaw`, `getX`, `getY`, `getYaw`, `distance` and `interpolate` (version 2.0.1 returns nothing
through out-parameters, and its path types tell no more than a length; hence gear changes are found from samples).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from targets.car.bicycle import wrap

HEADINGS = 24  # candidates at the goal, besides those at which the shortest simple turns arrive
SPACING = 0.05  # metres between the samples of a path, at most
REVERSE_PRICE = 0.5  # a metre driven backwards counts this much more than one forwards
GEAR_PRICE = 0.5  # a change of gear counts like these metres: the car has to stop for it
# A step that covers less than this part of its length has a gear change in it; arcs within a step bend it far less.
SHORTEST_ARC = 0.005  # metres
STRAIGHTNESS = 0.995

Point2 = tuple[float, float]
Triple = tuple[float, float, float]  # x, y (metres), yaw (radians)


@dataclass(frozen=True, slots=True)
class PathPose:
    """A pose on a path: metres and radians in local ENU, `yaw` running on without jumps; curvature, 1/m, is
    tan(steering)/wheelbase: positive when the wheels point to the left, in either gear."""

    x: float
    y: float
    yaw: float
    curvature: float


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a path in one gear: direction 1 is forward, -1 reverse. At least two poses."""

    direction: int
    poses: tuple[PathPose, ...]
    length: float


@dataclass(frozen=True, slots=True)
class Area:
    """The rectangle that the car's reference point stays in, metres, local ENU."""

    west: float
    south: float
    east: float
    north: float

    def contains(self, x: float, y: float) -> bool:
        return self.west <= x <= self.east and self.south <= y <= self.north

    def with_point(self, x: float, y: float) -> Area:
        """The smallest area that contains this one and a point."""
        return Area(min(self.west, x), min(self.south, y), max(self.east, x), max(self.north, y))


class Planner:
    """Plans for one car: `radius` is its smallest turning radius in metres, `area` where it may be."""

    def __init__(self, radius: float, area: Area) -> None:
        from ompl import base, util

        util.setLogLevel(util.LogLevel.LOG_ERROR)
        self._radius = radius
        self._area = area
        self._spaces = (base.DubinsStateSpace(radius), base.ReedsSheppStateSpace(radius))
        self._states = [[space.allocState() for _ in range(3)] for space in self._spaces]

    def plan(self, start: Triple, goal: Point2, gear: int = 0, arrival: float | None = None) -> list[Segment]:
        """The cheapest path found from a pose (x, y, yaw) to a point, or [] when every one leaves the area.

        `gear` is the direction in which the car rolls (0: it stands): starting the other way is priced. `arrival`,
        the heading at which an earlier plan arrives, is tried too: a plan made on the way agrees with its beginning.
        """
        # Noise can put a car that stands at the fence outside of it: from there, it may come back in.
        area = self._area.with_point(start[0], start[1])
        if not self._area.contains(*goal) or not all(map(math.isfinite, start)) or math.dist(start[:2], goal) < 1e-3:
            return []
        headings = [start[2] + i * 2 * math.pi / HEADINGS for i in range(HEADINGS)]
        headings += self._tangents(start, goal)
        if arrival is not None:
            headings.append(arrival)
        curves = []
        for kind, space in enumerate(self._spaces):
            begin, end, _ = self._states[kind]
            _put(begin, *start)
            for heading in headings:
                _put(end, goal[0], goal[1], wrap(heading))
                curves.append((space.distance(begin, end), heading, kind))
        best: list[Segment] = []
        least = math.inf
        for length, heading, kind in sorted(curves):
            if length >= least:  # a price is never below the length: nothing better can follow
                break
            path = self._sample(kind, start, (goal[0], goal[1], heading), length)
            price = _price(path, gear)
            if path and price < least and all(area.contains(p.x, p.y) for part in path for p in part.poses):
                best, least = path, price
        return best

    def arc(
        self, start: Triple, goal: Point2, gear: int, tolerance: float, through: Point2 | None = None
    ) -> list[Segment]:
        """One arc without a change of gear that ends within `tolerance` metres of the goal, or [] when there is none:
        what a target that has moved by centimetres calls for. `gear` 0 leaves the gear open. The arc is
        the one through the goal, or `through` another point beyond it, as far as the turning radius allows."""
        ahead, aside = _seen_from(start, goal if through is None else through)
        bend = max(-1 / self._radius, min(1 / self._radius, 2 * aside / max(math.hypot(ahead, aside), 1e-9) ** 2))
        bend = math.copysign(max(abs(bend), 1e-6), bend)  # a straight line is an arc of 1000 km
        ahead, aside = _seen_from(start, goal)
        along = math.atan2(bend * ahead, 1 - bend * aside) / bend  # the place on it that is nearest to the goal
        if abs(along) < SHORTEST_ARC or gear * along < 0 or abs(along) > math.pi / 2 * self._radius:
            return []
        steps = max(2, math.ceil(abs(along) / SPACING))
        points = [_on_arc(start, bend, along * i / steps) for i in range(steps + 1)]
        area = self._area.with_point(start[0], start[1])
        if math.dist(points[-1][:2], goal) > tolerance or not all(area.contains(x, y) for x, y, _ in points):
            return []
        return [_segment(1 if along > 0 else -1, points)]

    def _tangents(self, start: Triple, goal: Point2) -> Iterator[float]:
        """The headings at which one turn and a straight line arrive, to either side and in either gear: the shortest
        ways to a point, which a grid of headings would only come near to."""
        x, y, yaw = start
        for side in (1, -1):
            cx, cy = x - side * self._radius * math.sin(yaw), y + side * self._radius * math.cos(yaw)
            away = math.hypot(goal[0] - cx, goal[1] - cy)
            if away > self._radius:
                bearing = math.atan2(goal[1] - cy, goal[0] - cx)
                aside = math.asin(self._radius / away)
                yield bearing + side * aside
                yield bearing - side * aside + math.pi

    def _sample(self, kind: int, start: Triple, goal: Triple, length: float) -> list[Segment]:
        """The curve as segments; [] when a piece is too short to be told from its neighbours."""
        steps = max(16, math.ceil(length / SPACING))
        step = length / steps
        points = self._points(kind, start, goal, steps)
        forward = []  # how much of each step is driven forwards, metres
        for (x0, y0, yaw0), (x1, y1, yaw1) in pairwise(points):
            middle = (yaw0 + yaw1) / 2
            along = (x1 - x0) * math.cos(middle) + (y1 - y0) * math.sin(middle)
            if abs(along) > STRAIGHTNESS * step:
                along = math.copysign(step, along)
            forward.append((step + along) / 2)
        return _segments(points, forward, step)

    def _points(self, kind: int, start: Triple, goal: Triple, steps: int) -> list[Triple]:
        begin, end, at = self._states[kind]
        interpolate = self._spaces[kind].interpolate
        _put(begin, *start)
        _put(end, goal[0], goal[1], wrap(goal[2]))
        points = [start]
        for i in range(1, steps + 1):
            interpolate(begin, end, i / steps, at)
            last = points[-1][2]
            points.append((at.getX(), at.getY(), last + wrap(at.getYaw() - last)))
        return points


def _seen_from(start: Triple, point: Point2) -> Point2:
    """A point in the car's own frame: metres ahead and to the left."""
    east, north = point[0] - start[0], point[1] - start[1]
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    return cosine * east + sine * north, cosine * north - sine * east


def _on_arc(start: Triple, bend: float, along: float) -> Triple:
    half = bend * along / 2
    chord = 2 * math.sin(half) / bend
    heading = start[2] + half
    return (start[0] + chord * math.cos(heading), start[1] + chord * math.sin(heading), start[2] + 2 * half)


def _segments(points: list[Triple], forward: list[float], step: float) -> list[Segment]:
    """Cut a sampled curve where the gear changes. A step in which it does is divided at the point that leaves each
    gear its share of the way."""
    gears = [1 if f == step else -1 if f == 0.0 else 0 for f in forward]
    if gears[0] == 0 or gears[-1] == 0:
        return []
    segments: list[Segment] = []
    run, gear = [points[0]], gears[0]
    for i, now in enumerate(gears):
        if now == 0:
            if gears[i + 1] != -gear:  # two changes within two steps
                return []
            cusp = _cusp(points[i - 1], points[i], gear, (forward[i] if gear == 1 else step - forward[i]) / step)
            # A sliver of a step has no curvature that could be told: the sample beside it serves as the cusp.
            if math.dist(cusp[:2], points[i][:2]) > 0.02 * step:
                run.append(cusp)
            segments.append(_segment(gear, run))
            run, gear = run[-1:], -gear
            if math.dist(cusp[:2], points[i + 1][:2]) <= 0.02 * step:
                run = []
        elif now != gear:
            segments.append(_segment(gear, run))
            run, gear = run[-1:], now
        run.append(points[i + 1])
    return [*segments, _segment(gear, run)]


def _cusp(before: Triple, last: Triple, gear: int, share: float) -> Triple:
    """Where a curve that drives this share of a step on beyond its last sample gets to: it goes on turning as in the
    step before."""
    turn = (last[2] - before[2]) * share
    ahead = gear * math.dist(before[:2], last[:2]) * share
    heading = last[2] + turn / 2
    return (last[0] + ahead * math.cos(heading), last[1] + ahead * math.sin(heading), last[2] + turn)


def _segment(gear: int, run: list[Triple]) -> Segment:
    ways = [math.dist(a[:2], b[:2]) for a, b in pairwise(run)]
    bends = [gear * (b[2] - a[2]) / way for (a, b), way in zip(pairwise(run), ways, strict=True)]
    poses = tuple(PathPose(*at, bend) for at, bend in zip(run, [bends[0], *bends], strict=True))
    return Segment(gear, poses, sum(ways))


def _price(path: list[Segment], gear: int) -> float:
    if not path:
        return math.inf
    length = sum(part.length * (1.0 if part.direction == 1 else 1.0 + REVERSE_PRICE) for part in path)
    changes = len(path) - 1 + (gear not in (0, path[0].direction))
    return length + GEAR_PRICE * changes


def _put(state: Any, x: float, y: float, yaw: float) -> None:
    state.setXY(x, y)
    state.setYaw(yaw)
