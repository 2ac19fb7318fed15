"""Approach to a target: how long a car may drive without reaching it. A car that circles its target is given up."""

from __future__ import annotations

import math

from targets.car.planning.planner import Point2

AT_LEAST = 6.0  # seconds of driving that any target is worth
SHARE = 0.5  # of the speed in its sharpest curve: a car is at least so fast on average, along the way planned first
MANOEUVRE = 2.0  # seconds more for each segment of that way: the car stands between two


class Approach:
    """The time that the car may drive for one target follows from the first way that was planned to it, and is not
    extended by ways that are planned because the car has left the one before."""

    def __init__(self, speed: float, same: float) -> None:
        """`speed` is that in the sharpest curve, m/s. Targets nearer than `same` metres to one another are one."""
        self._pace, self._same = SHARE * speed, same
        self._target: Point2 | None = None
        self._driven = self._most = 0.0  # seconds; 0: no way was planned yet
        self.failed = False  # whether the target is given up

    def aim(self, target: Point2) -> None:
        """Take the target; another one begins a new approach."""
        if self._target is None or math.dist(self._target, target) > self._same:
            self._target, self._driven, self._most, self.failed = target, 0.0, 0.0, False

    def take(self, length: float, segments: int, anew: bool) -> None:
        """Take a planned way of so many metres; `anew`: it replaces one because other robots were in its way."""
        if self._most == 0.0 or anew:
            self._most = self._driven + AT_LEAST + length / self._pace + MANOEUVRE * segments

    def drive(self, seconds: float) -> None:
        """Add a time (s) during which the car was driven."""
        self._driven += seconds
        self.failed = self.failed or 0.0 < self._most < self._driven

    def why(self, away: float) -> str:
        """Return the reason why the target is given up, `away` metres from it."""
        return f"given up after {self._driven:.0f} s of driving, {away:.1f} m away; holding until another target comes"
