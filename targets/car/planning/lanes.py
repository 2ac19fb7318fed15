"""Lanes: the ground that other robots' paths cover, and how far a car may drive along its own path because of them.

A published path shows where its robot will be, not where it is now. So a car outside a lane stops before it.

A car inside a lane may leave it over a short distance. Until it is out, it must not come nearer to the middle of the
lane, nor to the start of the other robot's path, because a waiting robot stands there. So two cars in each other's lane
do not collide.
Metres, local ENU.
"""

from __future__ import annotations

import math

from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.points import Point
from targets.car.planning.curves import Curve, Triple
from targets.car.planning.shapes import Footprint, named
from targets.planning.world import Path, Scene

LOOK = 0.05  # metres between two checked poses of a path
ROUGH = 0.01  # metres: the accuracy of the car's position


class Lane:
    """Lane of another robot's path, for a car with the outline `body` whose rear axle is at `here`.

    `inside`: whether the car is in the lane now."""

    def __init__(self, path: Path, body: Footprint, here: Triple, clearance: float) -> None:
        self._shapes = list(named(Scene(others=(path,)), body, here[:2], clearance))
        self._line = tuple(Point(p.x, p.y) for p in path)
        self._body, self._here = body, here
        self._depth = self._away(here)
        self.inside = self._depth < 0.0

    def free(self, curve: Curve, station: float, ahead: float) -> float:
        """Return how many metres of a curve may be driven, from a station on; infinite if at least `ahead` may be.

        The result is 0 if the car is in the lane and the curve is no admissible way out of it."""
        out = self._way_out(curve, station) if self.inside else 0.0
        if out == math.inf:
            return 0.0
        least = 0.0 if self.inside else min(0.0, self._depth - ROUGH)
        steps = math.ceil(min(ahead, curve.length - station) / LOOK)
        for i in range(round(out / LOOK) + 1, steps + 1):
            if self._away(curve.at(min(station + i * LOOK, curve.length))) < least:
                return (i - 1) * LOOK
        return math.inf

    def _way_out(self, curve: Curve, station: float) -> float:
        """Return after how many metres of a curve the car is out of the lane; infinite if the curve is not allowed."""
        longest = self._body.length + 2 * self._body.reach
        middle, begin = self._distances(self._here)
        for i in range(1, math.ceil(longest / LOOK) + 1):
            if station + i * LOOK > curve.length:
                return math.inf
            pose = curve.at(station + i * LOOK)
            to_middle, to_begin = self._distances(pose)
            if to_middle < middle - ROUGH or (to_begin < 2 * longest and to_begin < begin - ROUGH):
                return math.inf
            middle = max(middle, to_middle)
            if self._away(pose) >= 0.0:
                return i * LOOK
        return math.inf

    def _distances(self, pose: Triple) -> tuple[float, float]:
        """Return the distances (m) of the outline's middle from the other robot's path and from its start."""
        x, y, yaw = pose
        ahead = self._body.length / 2 - self._body.overhang
        place = Point(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw))
        return path_distance((place,), self._line), path_distance((place,), self._line[:1])

    def _away(self, pose: Triple) -> float:
        """Return the distance (m) of the outline from the lane; negative inside, infinite if it is far away."""
        x, y, yaw = pose
        reach, best = self._body.reach, math.inf
        for shape in self._shapes:
            west, south, east, north = shape.bounds
            if west - reach <= x <= east + reach and south - reach <= y <= north + reach:
                best = min(best, self._body.distance(x, y, yaw, shape))
        return best
