"""Limit of a planner's work: by time or by iterations."""

from __future__ import annotations

import time

STARTS = 6  # maximum number of searches of a question if iterations limit the work


class Limit:
    """Limit of a planner's work, by time (`seconds`) or by `iterations` in each search.

    If `iterations` is None, the time counts. The limit is called in each iteration, and returns True once it is
    reached."""

    def __init__(self, seconds: float, iterations: int | None) -> None:
        self._end = time.perf_counter() + seconds
        self._begun = self._end - seconds
        self._iterations, self._done = iterations, 0

    def __call__(self) -> bool:
        self._done += 1
        return time.perf_counter() > self._end if self._iterations is None else self._done > self._iterations

    def later(self, seconds: float) -> Limit:
        """Return a limit with the same beginning that ends `seconds` after it, but not before this limit."""
        found = Limit(seconds, self._iterations)
        found._begun = self._begun
        found._end = max(self._end, self._begun + seconds)
        return found

    @property
    def late(self) -> bool:
        return self._iterations is None and time.perf_counter() > self._end

    def spent(self, turn: int) -> bool:
        """Return whether there is no time for another search after `turn` searches."""
        if self._iterations is not None:
            self._done = 0
            return turn >= STARTS
        now = time.perf_counter()
        return now + (now - self._begun) / turn > self._end
