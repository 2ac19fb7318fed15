"""Retransmission policy: when a robot requests missing entries (NACK), and from which robots.

A robot that wakes late probably runs on a busy computer, and the other robots may be late as well. Missing entries are
then late rather than lost, and requests would only cost more time. An entry counts as lost only if a later entry of its
author has arrived, or if another robot reports that it has the entry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FEW = 5  # largest number of missing entries or reports to request at once; if more are missing, they are probably late
HELPERS = 5  # number of robots that may send other authors' entries to the same robot in one round
LATE_FOR = 1  # rounds for which a robot remembers that it woke late
QUIET = 4  # rounds between two requests of a late robot while no missing entry is known to be lost
LOSSY_FOR = 16  # rounds for which a robot remembers that an entry was lost
SMALL = 8  # largest fleet in which all robots may send requests in a round without a recent loss
ASKERS = 2  # number of robots of a larger fleet that may send requests in a round without a recent loss


@dataclass(slots=True)
class RetransmissionPolicy:
    """Retransmission policy of robot `pid` in a fleet of `n_sys` robots.

    The methods must be called with ascending rounds. A robot that is on time may send requests at every tick. A late
    robot sends requests less often, and even less often while no entry is known to be lost."""

    pid: int
    n_sys: int
    _asked: int = 0
    _late: int = -LATE_FOR
    _lost: int = -LOSSY_FOR
    _lagging: int = 0
    _waits: bool = True

    def wakes(self, round_: int, on_time: bool) -> None:
        """Record whether the robot woke on time for a tick of round `round_`."""
        if not on_time:
            self._late = round_

    def is_strained(self, round_: int) -> bool:
        """Return whether the robot is late, or was late in the last LATE_FOR rounds."""
        return round_ <= self._late + LATE_FOR

    def is_hurried(self, round_: int) -> bool:
        """Return whether the robot is late and no entry was lost recently: missing entries are probably late."""
        return self.is_strained(round_) and round_ > self._lost + LOSSY_FOR

    def waits(self, round_: int) -> bool:
        """Return whether the robot keeps round `round_` open while it lacks entries of the round before.

        A hurried robot waits only in the first of consecutive rounds that lack entries. It closes the next ones at
        once, without an event. If a late fleet waited until the publish deadline in every round, only half of each
        round would be left for work, and the fleet would never catch up."""
        if round_ != self._lagging:
            again, self._lagging = round_ == self._lagging + 1, round_
            self._waits = not (again and self.is_hurried(round_))
        return self._waits

    def asks(self, round_: int, on_time: bool, lost: bool) -> bool:
        """Return whether the robot requests missing entries now.

        on_time: the robot woke when it was due.
        lost: some of the missing entries are known to have been sent.
        If no entry was lost recently, all other robots may be late. Then only ASKERS robots of a large fleet may send
        requests in a round, and the robots take turns."""
        if lost:
            self._lost = round_
        elif round_ > self._lost + LOSSY_FOR and self.n_sys > SMALL and not self._has_turn(round_):
            return False
        pause = QUIET if not lost else 0 if on_time else LATE_FOR
        if self.is_strained(round_) and round_ <= self._asked + pause:
            return False
        self._asked = round_
        return True

    def _has_turn(self, round_: int) -> bool:
        return (self.pid - ASKERS * round_) % self.n_sys < ASKERS


def recipients(
    missing: Sequence[int], unaware: Sequence[int], others: Sequence[int], turn: int
) -> tuple[Sequence[int], list[list[int]]]:
    """Return the authors whose entries are requested, and groups of recipients of the requests.

    missing: authors of missing entries.
    unaware: robots whose reports are missing. These robots get the request, too.
    others: all other robots. One of them gets the request, too, because it may hold the entries.
    turn: number of the request. If more than FEW authors are missing, one author is asked, a different one each turn:
        requests from all robots to all others would delay the entries of a large fleet.
    """
    authors = some(missing, turn)
    rest = [p for p in others if p not in missing] if missing else []
    to = sorted({*authors, *rest[turn % max(1, len(rest)) :][:1], *some(unaware, turn)})
    # A group message reaches all robots, and all would answer. So a request to few robots goes to each robot alone.
    return authors, [to] if 2 * len(to) > len(others) + 1 else [[p] for p in to]


def is_helper(pid: int, other: int, round_: int, n_sys: int) -> bool:
    """Return whether robot `pid` may send entries of other authors again to robot `other` in this round.

    HELPERS robots may do so in a round. If all robots did, a large fleet with one late robot would do nothing else."""
    return (pid - other - round_) % n_sys < HELPERS


def is_fleet_late(missing: int, n_sys: int) -> bool:
    """Return whether so many entries are missing that the fleet counts as late.

    Lost datagrams alone would leave fewer entries missing.
    """
    return missing > max(FEW, n_sys // 2)


def some(pids: Sequence[int], turn: int) -> Sequence[int]:
    """Return all of `pids` if there are at most FEW, else one pid, a different one for each `turn`."""
    return pids if len(pids) <= FEW else [pids[turn % len(pids)]]
