"""Of whom there has been news lately: a robot whose closings stay away for too long is doubted."""

from __future__ import annotations

from collections.abc import Collection, Sequence


class News:
    """Of the `n_sys` robots of a fleet; rounds only go up."""

    def __init__(self, n_sys: int) -> None:
        self._held = [-1] * n_sys  # of each robot's closings, and the round in which there was the last news of them
        self._last = [0] * n_sys
        self._complete = -1

    def complete(self, present: int) -> None:
        """All closings of round `present` are here in that round: there is news of everyone who counts."""
        self._complete = present

    def note(self, held: Sequence[int], present: int) -> None:
        """So much is held of each robot's closings in round `present`."""
        complete = self._complete
        for pid, (before, now) in enumerate(zip(self._held, held, strict=True)):
            if before != now:
                self._held[pid] = now
                self._last[pid] = complete if before >= 0 and now <= complete else present

    def renew(self, pid: int) -> None:
        """A robot's time begins anew."""
        self._held[pid] = -1

    def silent(self, pids: Collection[int], since: int) -> list[int]:
        """Those of whom there was no news since before a round."""
        return [p for p in pids if self._last[p] < since]
