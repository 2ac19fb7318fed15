"""Stalls: times in which a robot's body has no way to what the program commanded last."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Literal

State = Literal["begins", "goes on", "ends"]

GRACE = 2.0  # seconds without a way before a stall is reported: a robot that lets another pass is not stalled
AGAIN = 10.0  # seconds between two reports of one stall
CLEAR = 1.0  # seconds with a way that end a stall: a robot that tries again and again has not found one


class Stalls:
    """Reports a stall when it begins, every AGAIN seconds while it lasts, when its reason changes, and when it ends.
    `report` takes the state, the reason and the seconds that the stall has lasted; times are on any one clock."""

    def __init__(self, report: Callable[[State, str, float], None]) -> None:
        self._report = report
        self._why = ""
        self._since = 0.0  # when the body had no way for the first time
        self._seen = 0.0  # ... and for the last time
        self._reported: float | None = None  # when this stall was reported last
        self._kind = ""  # of the reason that was reported last

    def see(self, why: str, now: float) -> None:
        """Take the reason why the body has no way; "" while it has one or needs none."""
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
        kind = re.sub(r"[-\d.]+", "", self._why)  # other numbers are no other reason
        wait = AGAIN if kind == self._kind else GRACE
        if self._reported is None or now - self._reported >= wait:
            self._report("begins" if self._reported is None else "goes on", self._why, now - self._since)
            self._reported, self._kind = now, kind
