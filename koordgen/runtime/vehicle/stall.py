"""Stalls: periods in which a robot's vehicle has no path to the target of its last command."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Literal

State = Literal["begins", "goes on", "ends"]

GRACE = 2.0  # seconds without a path until a stall is reported: a robot that waits for another to pass is not stalled
AGAIN = 10.0  # seconds between two reports of one stall
CLEAR = 1.0  # seconds with a path until a stall ends: a path that is lost sooner does not end the stall


class Stalls:
    """Reporter of stalls: reports the beginning, each new reason, and the end of a stall.

    A stall that goes on is reported again every AGAIN seconds. `report` is called with the state of the stall, its
    reason, and its duration in seconds. All times are of the same clock."""

    def __init__(self, report: Callable[[State, str, float], None]) -> None:
        self._report = report
        self._why = ""
        self._since = 0.0  # time at which the present stall began
        self._seen = 0.0  # last time at which the vehicle had no path
        self._reported: float | None = None  # time of the last report on the present stall
        self._kind = ""  # kind of the reason last reported

    def see(self, why: str, now: float) -> None:
        """Update the stall. `why`: reason why the vehicle has no path; "" while it has a path or needs no path."""
        if why:
            if not self._why:
                self._since = now
            self._why, self._seen = why, now
            if now - self._since >= GRACE:
                self._go_on(now)
        elif self._why and now - self._seen >= CLEAR:
            if self._reported is not None:
                self._report("ends", self._why, now - self._since)
            self._why, self._reported = "", None

    def _go_on(self, now: float) -> None:
        kind = re.sub(r"[-\d.]+", "", self._why)  # two reasons that differ only in numbers are of one kind
        wait = AGAIN if kind == self._kind else GRACE
        if self._reported is None or now - self._reported >= wait:
            self._report("begins" if self._reported is None else "goes on", self._why, now - self._since)
            self._reported, self._kind = now, kind
