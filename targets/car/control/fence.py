"""Braking path of the car after a command, and the check that it stays inside the geofence.

The path is a rollout of the kinematic bicycle model (bicycle.py) with constant steering. The car drives for REACTION
seconds, then brakes with constant deceleration. There are two rollouts: at the present speed and at the commanded one.
Frame: local ENU. The checked point is the middle of the rear axle, because the geofence limits a robot's position.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from koordgen.runtime.config.settings import Box
from targets.car.base.bicycle import BicycleState, advance
from targets.car.control.mpc import STEP, Command

LAG = 0.1  # seconds until the motor follows a brake command
REACTION = STEP + LAG  # seconds until the car brakes, because the next check is one control step later
_PIECE = 0.02  # metres between two checked places of the braking path


def beyond(fence: Box, x: float, y: float) -> float:
    """Return how far outside the geofence a place is, metres along its worst axis; negative inside."""
    (west, east), (south, north) = sorted((fence.lo.x, fence.hi.x)), sorted((fence.lo.y, fence.hi.y))
    return max(west - x, x - east, south - y, y - north)


def stops_inside(fence: Box, state: BicycleState, command: Command, deceleration: float, wheelbase: float) -> bool:
    """Return whether the car, after this command, can still brake before it leaves the geofence.

    `state.speed` is measured. A car that is already outside may drive if the command takes it no farther out. Return
    False for a state or command that is not finite."""
    if not state.finite() or not replace(state, speed=command.speed, steering=command.steering).finite():
        return False
    now = beyond(fence, state.x, state.y)
    if now + max(_way(speed, deceleration) for speed in (state.speed, command.speed)) <= 0.0:
        return True  # the distance to the geofence's edge is longer than the stopping distance
    poses = braked(state, command, deceleration, wheelbase)
    return all(beyond(fence, pose.x, pose.y) <= max(0.0, now) for pose in poses)


def braked(state: BicycleState, command: Command, deceleration: float, wheelbase: float) -> Iterator[BicycleState]:
    """Yield the poses of the braking path, 2 or 3 cm apart, until the car stands.

    `state.speed` is measured. All numbers must be finite."""
    for moving in {state.speed, command.speed}:
        way = _way(moving, deceleration)
        pieces = max(1, round(way / _PIECE))
        pose = replace(state, speed=math.copysign(way / pieces, moving), steering=command.steering)
        for _ in range(pieces):
            pose = advance(pose, 1.0, wheelbase)
            yield pose


def _way(speed: float, deceleration: float) -> float:
    return abs(speed) * REACTION + speed * speed / (2 * deceleration)
