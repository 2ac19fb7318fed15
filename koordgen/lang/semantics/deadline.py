"""Deadline of a run: the time after which the evaluator stops a program, even in the middle of an event.

    with ends(Deadline(time.monotonic, time.monotonic() + 0.25)):
        execute(program, block, state, pid)  # raises OutOfTime

The evaluator checks the clock at each iteration of a loop and at each call of a function. Without a deadline, only the
event's budget of loop turns limits how long the event runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class OutOfTime(BaseException):
    """Signal that the run of a program has passed its deadline and has no result.

    The class derives from BaseException, so that no `except Exception` in an extern function or in the evaluator
    catches the signal.
    """


class Deadline(NamedTuple):
    """Deadline of a run: it ends when `clock()` exceeds `until`, both in seconds."""

    clock: Callable[[], float]
    until: float

    def look(self) -> None:
        """Raise OutOfTime if the deadline has passed."""
        if self.clock() > self.until:
            raise OutOfTime("the time for this run is over")


_present: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def present() -> Deadline | None:
    """Return the deadline of the current run, or None."""
    return _present.get()


@contextmanager
def ends(deadline: Deadline) -> Iterator[None]:
    """Set a deadline for all runs of programs within the `with` block."""
    token = _present.set(deadline)
    try:
        yield
    finally:
        _present.reset(token)
