"""Failure detector: suspects a member whose entries have been missing for too long.

A view change (`views`) then decides which robots are members. The detector may be wrong: the protocol stays safe, and a
robot that was suspected in error rejoins.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence


class FailureDetector:
    """Failure detector for a fleet of `n_sys` robots. Silence before round `round_` does not count."""

    def __init__(self, n_sys: int, round_: int) -> None:
        self._since = [round_] * n_sys  # for each robot, the first round in which silence of the robot counts

    def restart(self, pid: int, round_: int) -> None:
        """Count the silence of a robot only from `round_` on, because its membership has changed."""
        self._since[pid] = round_

    def restart_all(self, round_: int) -> None:
        """Count the silence of all robots only from `round_` on.

        Called while this robot hears no majority: its own network may have failed, so others' silence proves nothing.
        """
        self._since = [round_] * len(self._since)

    def suspects(self, pids: Collection[int], arrived: Sequence[int], since: int) -> list[int]:
        """Return the robots of `pids` of which no new entry has arrived since round `since`.

        arrived: for each robot, the round in which its last new entry arrived. An entry that arrives before the first
            tick of a round is recorded for the round before, so one round is added in its author's favour.
        """
        return [p for p in pids if max(self._since[p], arrived[p] + 1) < since]
