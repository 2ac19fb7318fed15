"""Deadlines of runs: a limit of time after which the semantics stops a program, even within an event.

    with ends(Deadline(time.monotonic, time.monotonic() + 0.25)):
        execute(program, block, state, pid)  # raises OutOfTime

Each turn of an event checks the clock. Without a deadline only the number of turns is limited.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class OutOfTime(BaseException):
    """The run of a program has passed its deadline and has no result.

    A BaseException, so that no `except Exception` of an extern function or of the evaluator catches it.
    """


class Deadline(NamedTuple):
    """Deadline of a run: the time `until` of `clock`, in seconds."""

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
    """Set a deadline for runs within the `with` block."""
    token = _present.set(deadline)
    try:
        yield
    finally:
        _present.reset(token)
