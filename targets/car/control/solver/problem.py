"""What is solved at every control step, whoever solves it: limits, weights, and the interface of a solver.

The cost is the sum over 20 steps of 50 ms of the weighted squares of (state - wished state) and of the inputs.
States are (x, y, yaw, speed, steering), inputs acceleration and steering rate; m, rad, s, in local ENU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

STATE_WEIGHTS = (100.0, 100.0, 1.0, 1.0, 0.1)  # x, y, yaw, speed, steering
INPUT_WEIGHTS = (0.02, 0.02)  # acceleration, steering rate


@dataclass(frozen=True, slots=True)
class Limits:
    """What a car can do: metres, m/s (both directions), m/s^2, radians, rad/s."""

    wheelbase: float
    speed: float
    acceleration: float
    steering: float
    steering_rate: float


class Solver(Protocol):
    """Plans for one car."""

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """The inputs of the best plan from `present` (5 numbers, speed and steering within the limits) along `wished`
        (20 states), looked for from `inputs` (20 pairs) on; None when none was found. Everything given is finite."""
        ...
