"""Deadlines of runs: when the semantics gives up the program that it runs, however long one event of it turns.

    with ends(Deadline(time.monotonic, time.monotonic() + 0.25)):
        execute(program, block, state, pid)  # raises OutOfTime

Every turn that an event takes looks at the clock. Without a deadline only the number of turns is limited.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class OutOfTime(BaseException):
    """The run of a program has passed its deadline: it has no result. No `except Exception` of an extern function or of
    an event's faults catches it."""


class Deadline(NamedTuple):
    """When a run ends without a result: at the time `until` of `clock`, seconds."""

    clock: Callable[[], float]
    until: float

    def look(self) -> None:
        """Raise OutOfTime when it has passed."""
        if self.clock() > self.until:
            raise OutOfTime("the time for this run is over")


_present: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def present() -> Deadline | None:
    """Return the deadline of what runs here, if it has one."""
    return _present.get()


@contextmanager
def ends(deadline: Deadline) -> Iterator[None]:
    """Give what runs in the block a deadline."""
    token = _present.set(deadline)
    try:
        yield
    finally:
        _present.reset(token)
