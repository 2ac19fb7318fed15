"""Time limit of a command: an alarm that interrupts whatever runs in the main thread, user code included."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from koordgen.lang.semantics.deadline import OutOfTime

GRACE = 0.5  # seconds: who looks at the clock in good time ends in its own way before


@contextmanager
def alarm(seconds: float | None) -> Iterator[None]:
    """Raise OutOfTime in the block once it has run for so many seconds, and GRACE; never, without `seconds`. Takes
    SIGALRM for that time. One call into C is not interrupted: limits of sizes keep these short."""
    if seconds is None:
        yield
        return
    armed = True

    def ring(number: int, frame: FrameType | None) -> None:
        if armed:
            raise OutOfTime(f"{seconds:g} s are over")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 0.0) + GRACE)
    try:
        yield
    finally:
        armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
