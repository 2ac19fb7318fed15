"""Retransmission policy.

When to request missing entries (NACK) and from whom, and when to repeat own ones.

A robot that wakes late shares a busy computer, and the other robots may be as late. Its missing entries are then late
rather than lost, and a fleet that is short of time must not spend it on requests. Loss is detected soon: a later entry
of the same robot arrives, or another robot reports that it has the entry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FEW = 5  # missing entries or reports that may have been lost; if more are missing, they are late
HELPERS = 5  # robots that repeat third robots' entries at the same time
LATE_FOR = 1  # rounds for which a robot remembers that it woke late
QUIET = 4  # rounds after which a late robot requests again entries that are probably late, too
LOSSY_FOR = 16  # rounds for which a robot remembers that something was lost
SMALL = 8  # robots that may all send requests at once for entries not known to be sent
ASKERS = 2  # robots of a larger fleet that may do so in each round


@dataclass(slots=True)
class RetransmissionPolicy:
    """Policy of robot `pid` in a fleet of `n_sys`. Rounds only increase.

    A punctual robot may send requests at every tick. A late robot sends them once a round, or less often if nothing is
    known to be lost."""

    pid: int
    n_sys: int
    _asked: int = 0
    _late: int = -LATE_FOR
    _lost: int = -LOSSY_FOR
    _lagging: int = 0
    _waits: bool = True

    def wakes(self, round_: int, on_time: bool) -> None:
        """Record that the robot has reached a tick of this round, on time or late."""
        if not on_time:
            self._late = round_

    def is_strained(self, round_: int) -> bool:
        """Return whether the robot is late, or was in the round before."""
        return round_ <= self._late + LATE_FOR

    def is_hurried(self, round_: int) -> bool:
        """Return whether the robot is late without recent loss: missing entries are probably late, too."""
        return self.is_strained(round_) and round_ > self._lost + LOSSY_FOR

    def waits(self, round_: int) -> bool:
        """Return whether the robot keeps a round open while it lacks entries of the round before.

        A fleet that waits in every round has only half of each for work that takes a whole one, and never catches up.
        So a hurried robot skips every second such round at once, until all entries arrive in time again."""
        if round_ != self._lagging:
            again, self._lagging = round_ == self._lagging + 1, round_
            self._waits = not (again and self.is_hurried(round_))
        return self._waits

    def asks(self, round_: int, on_time: bool, lost: bool) -> bool:
        """Return whether the robot requests missing entries now; `lost`: some are known to have been sent.

        Without recent loss, all other robots may be late. Then only ASKERS of a large fleet send requests, in turn."""
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
    """Return the authors whose `missing` entries are requested, and lists of recipients.

    Requests go to these authors, to one of the `others` that may hold their entries, and to the robots in `unaware`,
    whose reports are missing. If many are missing, only one author is asked, a different one each `turn`: in a large
    fleet, requests of all to all would take the time that the entries need."""
    authors = some(missing, turn)
    rest = [p for p in others if p not in missing] if missing else []
    to = sorted({*authors, *rest[turn % max(1, len(rest)) :][:1], *some(unaware, turn)})
    # A group message reaches all robots, and all would answer: a request to few robots goes to each alone.
    return authors, [to] if 2 * len(to) > len(others) + 1 else [[p] for p in to]


def is_helper(pid: int, other: int, round_: int, n_sys: int) -> bool:
    """Return whether it is this robot's turn to repeat third robots' entries to another robot.

    If all did so at once, a large fleet with one late robot would have no time for other work."""
    return (pid - other - round_) % n_sys < HELPERS


def is_fleet_late(missing: int, n_sys: int) -> bool:
    """Return whether so many entries are missing that the fleet is late. Loss alone loses fewer."""
    return missing > max(FEW, n_sys // 2)


def some(pids: Sequence[int], turn: int) -> Sequence[int]:
    """Return all robots if they are few, otherwise one of them, a different one each `turn`."""
    return pids if len(pids) <= FEW else [pids[turn % len(pids)]]
