"""Time on a robot: its own clock, and the fleet's, which is the clock of the robot with the lowest pid.

Local clocks are monotonic seconds of unknown origin. `FleetClock` estimates the offset to the reference by four
timestamps (a datagram out, and the echo of it back), from the exchange of a window that bounds it best.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

DRIFT = 100e-6  # two crystals of 50 ppm each, running apart
SLEW = 0.05  # the share of elapsed time by which a locked clock may be corrected: keeps it monotonic, no round jumps
WINDOW = 64


class Clock(Protocol):
    """Monotonic seconds, local to the robot."""

    def now(self) -> float: ...


class SystemClock:
    """The operating system's monotonic clock: setting the time of day does not move it."""

    def now(self) -> float:
        return time.monotonic()


class SimulatedClock:
    """Time owned by a simulation; `rate` and `offset` make it a robot's clock that runs off the `base`."""

    def __init__(self, base: SimulatedClock | None = None, offset: float = 0.0, rate: float = 1.0) -> None:
        self._base = base
        self._offset = offset
        self._rate = rate
        self.time = 0.0

    def now(self) -> float:
        return self.time if self._base is None else self._offset + self._rate * self._base.now()

    def true(self, local: float) -> float:
        """The base's time at which this clock shows `local`."""
        return local if self._base is None else (local - self._offset) / self._rate


@dataclass(frozen=True, slots=True)
class _Exchange:
    offset: float  # seconds to be added to the local clock
    half: float  # half the round trip: the true offset is within offset +- half
    at: float  # local time of its end

    def bound(self, now: float) -> float:
        return self.half + DRIFT * max(0.0, now - self.at)


class FleetClock:
    """Fleet time from local time. Until `lock` it steps to a better estimate; from then on it slews."""

    def __init__(self, reference: bool) -> None:
        self._reference = reference
        self._exchanges: deque[_Exchange] = deque(maxlen=WINDOW)
        self._best: _Exchange | None = None
        self._offset = 0.0
        self._locked = False
        self._last = float("-inf")

    @property
    def known(self) -> bool:
        """Whether there is an estimate at all."""
        return self._reference or self._best is not None

    def bound(self, now: float) -> float:
        """How far fleet time may be off at local time `now`, in seconds; infinite while nothing is known."""
        if self._reference:
            return 0.0
        if self._best is None:
            return float("inf")
        return self._best.bound(now) + abs(self._best.offset - self._offset)

    def take(self, sent: float, received: float, answered: float, now: float) -> bool:
        """Learn from an exchange: sent and back (`now`) by the local clock, received and answered by the reference's.
        False for stamps that no honest exchange yields."""
        trip = (now - sent) - (answered - received)
        if self._reference or sent > now or answered < received or trip < -1e-3:
            return False
        offset = ((received - sent) + (answered - now)) / 2
        self._exchanges.append(_Exchange(offset, max(0.0, trip) / 2, now))
        self._best = min(self._exchanges, key=lambda e: e.bound(now))
        return True

    def lock(self) -> None:
        """The mission's start is fixed: no more steps."""
        self._locked = True

    def read(self, now: float) -> float:
        """Fleet time at local time `now`; never decreases once locked, as long as `now` does not."""
        if self._best is not None:
            wanted = self._best.offset - self._offset
            if self._locked:
                most = SLEW * max(0.0, now - self._last)
                wanted = max(-most, min(most, wanted))
            self._offset += wanted
        self._last = max(self._last, now)
        return now + self._offset

    def local(self, fleet: float) -> float:
        """The local time at which fleet time will be `fleet`, as far as is known now."""
        return fleet - self._offset
