"""Clock of a robot: the interface, the operating system's monotonic clock, and a simulated one."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds, local to the robot."""

    def now(self) -> float: ...


class SystemClock:
    """The operating system's monotonic clock: setting the time of day does not move it."""

    now = staticmethod(time.monotonic)


class SimulatedClock:
    """Simulated time; `rate` and `offset` derive a robot's drifting clock from `base`."""

    def __init__(self, base: SimulatedClock | None = None, offset: float = 0.0, rate: float = 1.0) -> None:
        self._base = base
        self._offset = offset
        self._rate = rate
        self.time = 0.0

    def now(self) -> float:
        return self.time if self._base is None else self._offset + self._rate * self._base.now()

    def true(self, local: float) -> float:
        """Return the base's time at which this clock shows `local`."""
        return local if self._base is None else (local - self._offset) / self._rate
