"""Time limit of the approach to a target: a car that drives too long without reaching it gives the target up."""

from __future__ import annotations

import math

from targets.car.planning.planner import Point2

AT_LEAST = 6.0  # seconds of driving that every target is allowed
SHARE = 0.5  # assumed average speed along the first planned path, as a share of the speed in the car's sharpest curve
MANOEUVRE = 2.0  # further seconds for each segment of that path, because the car stops between segments


class Approach:
    """Time limit of one target. It follows from the first path planned to the target.

    It is not extended by paths that are planned because the car has left the one before."""

    def __init__(self, speed: float, same: float) -> None:
        """`speed`: speed in the sharpest curve, m/s. Targets within `same` metres of each other count as one."""
        self._pace, self._same = SHARE * speed, same
        self._target: Point2 | None = None
        self._driven = self._most = 0.0  # seconds; 0: no way was planned yet
        self.failed = False  # whether the target is given up

    def aim(self, target: Point2) -> None:
        """Set the target; a different one begins a new approach."""
        if self._target is None or math.dist(self._target, target) > self._same:
            self._target, self._driven, self._most, self.failed = target, 0.0, 0.0, False

    def take(self, length: float, segments: int, anew: bool) -> None:
        """Record a planned path of `length` metres; `anew`: it replaces one that other robots' paths crossed."""
        if self._most == 0.0 or anew:
            self._most = self._driven + AT_LEAST + length / self._pace + MANOEUVRE * segments

    def drive(self, seconds: float) -> None:
        """Add a time (s) during which the car was driven."""
        self._driven += seconds
        self.failed = self.failed or 0.0 < self._most < self._driven

    def why(self, away: float) -> str:
        """Return the reason why the target is given up, `away` metres from it."""
        return f"given up after {self._driven:.0f} s of driving, {away:.1f} m away; holding until another target comes"
