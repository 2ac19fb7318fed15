"""Clocks of robots: the interface, the operating system's monotonic clock, and a simulated clock."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic clock of one robot, in seconds."""

    def now(self) -> float: ...


class SystemClock:
    """Monotonic clock of the operating system. A change of the time of day does not move this clock."""

    now = staticmethod(time.monotonic)


class SimulatedClock:
    """Simulated clock in seconds. With `base`, it shows `offset + rate * base.now()`: a robot's drifting clock."""

    def __init__(self, base: SimulatedClock | None = None, offset: float = 0.0, rate: float = 1.0) -> None:
        self._base = base
        self._offset = offset
        self._rate = rate
        self.time = 0.0

    def now(self) -> float:
        return self.time if self._base is None else self._offset + self._rate * self._base.now()

    def true(self, local: float) -> float:
        """Return the time of the clock `base` at which this clock shows `local`."""
        return local if self._base is None else (local - self._offset) / self._rate
