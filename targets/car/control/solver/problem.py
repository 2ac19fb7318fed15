"""MPC problem that a solver solves at every control step: limits, weights, and the interface of a solver.

The cost is the sum, over 20 steps of 50 ms, of the weighted squares of (state - wished state) and of the inputs.
States are (x, y, yaw, speed, steering), inputs are acceleration and steering rate; m, rad, s, in local ENU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

STATE_WEIGHTS = (100.0, 100.0, 1.0, 1.0, 0.1)  # x, y, yaw, speed, steering
INPUT_WEIGHTS = (0.02, 0.02)  # acceleration, steering rate


@dataclass(frozen=True, slots=True)
class ControlLimits:
    """Wheelbase and limits of a car. Each limit holds in both directions."""

    wheelbase: float  # m
    speed: float  # m/s
    acceleration: float  # m/s^2
    steering: float  # rad
    steering_rate: float  # rad/s


class Solver(Protocol):
    """Solver of the MPC problem for one car."""

    def __call__(
        self, present: Sequence[float], wished: Sequence[float], inputs: Sequence[float]
    ) -> list[float] | None:
        """Return the inputs of the best plan (20 pairs); None if the solver found no plan.

        `present`: the initial state (5 numbers); its speed and steering are within the limits.
        `wished`: the reference states (20 times 5 numbers).
        `inputs`: the initial guess (20 pairs).

        All numbers must be finite."""
        ...
