"""The kinematic bicycle: how the car moves. Its reference point, in the whole target, is the rear axle's middle.

Formulas: S. M. LaValle, Planning Algorithms (2006), section 13.1.2.1, the simple car:
x' = v cos(yaw), y' = v sin(yaw), yaw' = v tan(steering) / wheelbase.
Frame: local ENU, metres and radians; steering is positive to the left, speed is negative in reverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class State:
    """Where the car is and how it moves: metres, radians (yaw counter-clockwise from east), m/s, radians."""

    x: float
    y: float
    yaw: float
    speed: float = 0.0
    steering: float = 0.0

    def finite(self) -> bool:
        """Return whether all fields are finite."""
        return all(map(math.isfinite, (self.x, self.y, self.yaw, self.speed, self.steering)))


def advance(state: State, seconds: float, wheelbase: float) -> State:
    """Return the state after driving on with constant speed and steering: exact, an arc of a circle."""
    travel = state.speed * seconds
    turn = travel * math.tan(state.steering) / wheelbase
    # The chord of an arc of this length: the ratio sin(h)/h stays exact for a straight line, where h is 0.
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
    """Return the same angle within -pi to pi."""
    return math.remainder(angle, 2 * math.pi)
