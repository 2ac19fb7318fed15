"""Braking path of the car after a command, and the check that it ends inside the geofence.

The rollout is the kinematic bicycle's (bicycle.py) with the steering held: at the present speed, and at the commanded
one, for REACTION, then with constant deceleration. Frame: local ENU; the point is the middle of the rear axle, as the
geofence is about a robot's position.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from koordgen.runtime.config.settings import Box
from targets.car.base.bicycle import State, advance
from targets.car.control.mpc import STEP, Command

LAG = 0.1  # seconds until the motor has followed
REACTION = STEP + LAG  # seconds: the next look comes a step later
_PIECE = 0.02  # metres of the way between two places that are looked at


def beyond(fence: Box, x: float, y: float) -> float:
    """Return how far outside the geofence a place is, metres along its worst axis; negative inside."""
    (west, east), (south, north) = sorted((fence.lo.x, fence.hi.x)), sorted((fence.lo.y, fence.hi.y))
    return max(west - x, x - east, south - y, y - north)


def stops_inside(fence: Box, state: State, command: Command, deceleration: float, wheelbase: float) -> bool:
    """Whether the car can be braked before it leaves the geofence after this command. `state.speed` is measured. A car
    that is outside may drive where that brings it no farther out. What is not finite is not driven."""
    if not state.finite() or not replace(state, speed=command.speed, steering=command.steering).finite():
        return False
    now = beyond(fence, state.x, state.y)
    if now + max(_way(speed, deceleration) for speed in (state.speed, command.speed)) <= 0.0:
        return True  # no way of this length leads out
    poses = braked(state, command, deceleration, wheelbase)
    return all(beyond(fence, pose.x, pose.y) <= max(0.0, now) for pose in poses)


def braked(state: State, command: Command, deceleration: float, wheelbase: float) -> Iterator[State]:
    """Yield the poses of the car, 2 or 3 cm apart, if it obeys this command and is then braked until it stands.
    `state.speed` is measured; all numbers are finite."""
    for moving in {state.speed, command.speed}:
        way = _way(moving, deceleration)
        pieces = max(1, round(way / _PIECE))
        pose = replace(state, speed=math.copysign(way / pieces, moving), steering=command.steering)
        for _ in range(pieces):
            pose = advance(pose, 1.0, wheelbase)
            yield pose


def _way(speed: float, deceleration: float) -> float:
    return abs(speed) * REACTION + speed * speed / (2 * deceleration)
