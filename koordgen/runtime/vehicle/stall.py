"""Stalls: periods in which a robot's vehicle has no path to the target of its last command."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Literal

State = Literal["begins", "goes on", "ends"]

GRACE = 2.0  # seconds without a path before a stall is reported: a robot that lets another pass is not stalled
AGAIN = 10.0  # seconds between two reports of one stall
CLEAR = 1.0  # seconds with a path that end a stall: a robot that tries again and again has not found one


class Stalls:
    """Reporter of stalls: at the begin, every AGAIN seconds, at a new reason, and at the end.

    `report` receives state, reason, and duration in seconds. Times are on any one clock."""

    def __init__(self, report: Callable[[State, str, float], None]) -> None:
        self._report = report
        self._why = ""
        self._since = 0.0  # time when the vehicle first had no path
        self._seen = 0.0  # time when it last had no path
        self._reported: float | None = None  # time of this stall's last report
        self._kind = ""  # kind of the reason last reported

    def see(self, why: str, now: float) -> None:
        """Update with the reason why the vehicle has no path; "" while it has one or needs none."""
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
        kind = re.sub(r"[-\d.]+", "", self._why)  # reasons that differ in numbers only count as equal
        wait = AGAIN if kind == self._kind else GRACE
        if self._reported is None or now - self._reported >= wait:
            self._report("begins" if self._reported is None else "goes on", self._why, now - self._since)
            self._reported, self._kind = now, kind
