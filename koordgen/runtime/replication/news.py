"""Of whom there has been news lately: a robot whose closings stay away for too long is doubted.

Failure detector (dead-robot detection): suspects a member whose round messages have been missing for too long. A view
change (`views`) then decides whether it still counts.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence


class News:
    """Of the `n_sys` robots of a fleet; rounds only go up."""

    def __init__(self, n_sys: int) -> None:
        # What is held of each robot's closings, -1: that it is held at all is news; and the round of the last news.
        self._held, self._anew = [-1] * n_sys, True  # there may be a -1
        self._last = [0] * n_sys
        self._complete = -1

    def complete(self, present: int) -> None:
        """All closings of round `present` are here in that round: there is news of everyone who counts."""
        self._complete = present
        if self._anew:
            self._held, self._anew = [max(0, held) for held in self._held], False

    def note(self, held: Sequence[int], present: int) -> None:
        """So much is held of each robot's closings in round `present`."""
        complete = self._complete
        for pid, (before, now) in enumerate(zip(self._held, held, strict=True)):
            if before != now:
                self._held[pid] = now
                self._last[pid] = complete if before >= 0 and now <= complete else present

    def renew(self, pid: int) -> None:
        """A robot's time begins anew."""
        self._held[pid], self._anew = -1, True

    def silent(self, pids: Collection[int], since: int) -> list[int]:
        """Those of whom there was no news since before a round."""
        return [p for p in pids if self._last[p] < since]
