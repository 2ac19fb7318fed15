"""Time limit of a command: an alarm that interrupts the main thread, even in the user's own Python code."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from koordgen.lang.semantics.deadline import OutOfTime

GRACE = 0.5  # seconds after the limit: code that checks the clock itself ends regularly before the alarm
AGAIN = 0.5  # seconds until the alarm is repeated, if the block has not ended


@contextmanager
def alarm(seconds: float | None) -> Iterator[None]:
    """Raise OutOfTime in the block after `seconds` + GRACE; never if `seconds` is None.

    Raises it again if the block goes on: a bare `except` or a destructor may swallow it.
    Uses SIGALRM during the block. A single call into C is not interrupted; limits of sizes keep such calls short.
    """
    if seconds is None:
        yield
        return
    armed = True

    def ring(number: int, frame: FrameType | None) -> None:
        if armed:
            raise OutOfTime(f"{seconds:g} s are over")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 0.0) + GRACE, AGAIN)
    try:
        yield
    finally:
        armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
