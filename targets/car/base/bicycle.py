"""Kinematic bicycle model of the car. The car's reference point in this target is the middle of the rear axle.

Formulas: S. M. LaValle, Planning Algorithms (2006), section 13.1.2.1, the simple car:
x' = v cos(yaw), y' = v sin(yaw), yaw' = v tan(steering) / wheelbase.
Frame: local ENU, metres and radians; steering is positive to the left, speed is negative in reverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class BicycleState:
    """State of the bicycle model, in local ENU."""

    x: float  # m
    y: float  # m
    yaw: float  # rad, counter-clockwise from east
    speed: float = 0.0  # m/s, negative in reverse
    steering: float = 0.0  # rad, positive to the left

    def finite(self) -> bool:
        """Return whether all fields are finite."""
        return all(map(math.isfinite, (self.x, self.y, self.yaw, self.speed, self.steering)))


def advance(state: BicycleState, seconds: float, wheelbase: float) -> BicycleState:
    """Return the exact state after driving for `seconds` with constant speed and steering, along a circular arc."""
    travel = state.speed * seconds
    turn = travel * math.tan(state.steering) / wheelbase
    # The chord of an arc of length `travel` is travel * sin(half) / half; on a straight line, half is 0, the ratio 1.
    half = turn / 2
    chord = travel * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    heading = state.yaw + half
    return replace(
        state,
        x=state.x + chord * math.cos(heading),
        y=state.y + chord * math.sin(heading),
        yaw=state.yaw + turn,
    )


def turning_radius(steering: float, wheelbase: float) -> float:
    """Return the radius, in metres, of the rear axle's circle at a steering angle."""
    return wheelbase / math.tan(abs(steering))


def wrap(angle: float) -> float:
    """Return an angle (rad), shifted by full turns into -pi to pi."""
    return math.remainder(angle, 2 * math.pi)
