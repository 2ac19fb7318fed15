"""Failure detector: suspects a member whose entries have been missing for too long.

A view change (`views`) then decides who counts. The detector may be wrong: the protocol stays safe, and a robot that
was suspected in error rejoins.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence


class FailureDetector:
    """Failure detector for a fleet of `n_sys` robots. Silence before round `round_` does not count."""

    def __init__(self, n_sys: int, round_: int) -> None:
        self._since = [round_] * n_sys  # for each robot, the round from which on its silence counts

    def restart(self, pid: int, round_: int) -> None:
        """Begin anew with a robot whose membership has changed."""
        self._since[pid] = round_

    def restart_all(self, round_: int) -> None:
        """Begin anew with all robots: this robot itself was cut off, so silence says nothing about them."""
        self._since = [round_] * len(self._since)

    def suspects(self, pids: Collection[int], arrived: Sequence[int], since: int) -> list[int]:
        """Return those of which no new entry has arrived since round `since`.

        `arrived`: of each robot, the round in which a new entry of it arrived last. An entry that arrives before the
        first tick of a round is noted in the round before, so its author gets one round more.
        """
        return [p for p in pids if max(self._since[p], arrived[p] + 1) < since]
