"""Time limit of the approach to a target: a car that drives too long without reaching it gives the target up."""

from __future__ import annotations

import math

from targets.car.planning.planner import Point2

AT_LEAST = 6.0  # seconds of driving that every target is allowed
SHARE = 0.5  # assumed average speed along the first planned path, as a share of the speed in the sharpest curve
MANOEUVRE = 2.0  # seconds added for each segment of the first planned path: the car stops between segments


class Approach:
    """Time limit of one target. It is computed from the first path planned to the target.

    A path that is planned because the car has left the previous path does not extend the limit."""

    def __init__(self, speed: float, same: float) -> None:
        """`speed`: speed in the sharpest curve, m/s. Targets within `same` metres of each other count as one."""
        self._pace, self._same = SHARE * speed, same
        self._target: Point2 | None = None
        self._driven = self._most = 0.0  # seconds driven, and limit; limit 0: no path was planned yet
        self.failed = False  # whether the target is given up

    def aim(self, target: Point2) -> None:
        """Set the target. A target that differs from the present one begins a new approach."""
        if self._target is None or math.dist(self._target, target) > self._same:
            self._target, self._driven, self._most, self.failed = target, 0.0, 0.0, False

    def record_path(self, length: float, segments: int, anew: bool) -> None:
        """Record a planned path of `length` metres.

        `anew`: it replaces a path that other robots' paths crossed, so the time limit is computed anew."""
        if self._most == 0.0 or anew:
            self._most = self._driven + AT_LEAST + length / self._pace + MANOEUVRE * segments

    def drive(self, seconds: float) -> None:
        """Add a time (s) during which the car was driven."""
        self._driven += seconds
        self.failed = self.failed or 0.0 < self._most < self._driven

    def why(self, away: float) -> str:
        """Return a message that the target is given up. `away`: distance (m) of the car from the target."""
        return f"given up after {self._driven:.0f} s of driving, {away:.1f} m away; holding until another target comes"
