"""Brakes before the geofence: whether the car could still stop inside it, if it drove on until the next look.

The rollout is the kinematic bicycle's (bicycle.py) with the steering held: at the present speed, and at the commanded
one, for REACTION, then with constant deceleration. Frame: local ENU; the point is the middle of the rear axle, as the
geofence is about a robot's position.
"""

from __future__ import annotations

from dataclasses import replace

from koordgen.runtime.settings import Box
from targets.car.bicycle import State, advance
from targets.car.mpc import STEP, Command

LAG = 0.1  # seconds until the motor has followed
REACTION = STEP + LAG  # seconds: the next look comes a step later
_PIECE = 0.02  # metres of the way between two places that are looked at


def beyond(fence: Box, x: float, y: float) -> float:
    """How far outside the geofence a place is, metres along its worst axis; negative inside."""
    (west, east), (south, north) = sorted((fence.lo.x, fence.hi.x)), sorted((fence.lo.y, fence.hi.y))
    return max(west - x, x - east, south - y, y - north)


def stops_inside(fence: Box, state: State, command: Command, deceleration: float, wheelbase: float) -> bool:
    """Whether the car can be braked before it leaves the geofence after this command. `state.speed` is measured. A car
    that is outside may drive where that brings it no farther out. What is not finite is not driven."""
    if not state.finite() or not replace(state, speed=command.speed, steering=command.steering).finite():
        return False
    now = beyond(fence, state.x, state.y)
    for moving in {state.speed, command.speed}:
        speed = abs(moving)
        way = speed * REACTION + speed * speed / (2 * deceleration)
        if now + way <= 0.0:  # no way of this length leads out
            continue
        pieces = max(1, round(way / _PIECE))
        unit = replace(state, speed=way / pieces if moving >= 0 else -way / pieces, steering=command.steering)
        for _ in range(pieces):
            unit = advance(unit, 1.0, wheelbase)
            if beyond(fence, unit.x, unit.y) > max(0.0, now):
                return False
    return True
