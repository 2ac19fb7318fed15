"""The slalom that the controller is measured on: arcs of 1 m radius at 1.5 m/s."""

from __future__ import annotations

import math
from itertools import pairwise

from targets.car.bicycle import State, advance
from targets.car.mpc import Limits
from targets.car.planner import PathPose, Segment

LIMITS = Limits(wheelbase=0.33, speed=1.5, acceleration=4.0, steering=0.4, steering_rate=3.0)
RADIUS, PACE = 1.0, 1.5  # m, m/s


def slalom_path(arcs: int) -> Segment:
    """Quarter circles, left and right in turn, 2 cm between poses."""
    at, step, quarter = State(0.0, 0.0, -math.pi / 4), 0.02, RADIUS * math.pi / 2
    poses, station = [PathPose(at.x, at.y, at.yaw, 1 / RADIUS)], 0.0
    while station < arcs * quarter:
        bend = (1 if int(station / quarter) % 2 == 0 else -1) / RADIUS
        steering = math.atan(LIMITS.wheelbase * bend)
        at = advance(State(at.x, at.y, at.yaw, step, steering), 1.0, LIMITS.wheelbase)
        station += step
        poses.append(PathPose(at.x, at.y, at.yaw, bend))
    return Segment(1, tuple(poses), station)


def aside(path: Segment, x: float, y: float) -> float:
    """The distance of a point from a path, metres."""
    nearest = math.inf
    for a, b in pairwise(path.poses):
        dx, dy = b.x - a.x, b.y - a.y
        along = max(0.0, min(1.0, ((x - a.x) * dx + (y - a.y) * dy) / (dx * dx + dy * dy)))
        nearest = min(nearest, math.hypot(x - a.x - along * dx, y - a.y - along * dy))
    return nearest
