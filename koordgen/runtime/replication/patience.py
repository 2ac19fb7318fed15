"""When and whom a robot asks for what it lacks, how long it waits for that, and when it repeats unasked what others
lack.

Retransmission policy: when to ask for missing round messages (NACK), and when to send own ones again.

Who wakes late shares a busy computer, and the others may be as late: what it lacks is then late rather than lost, and
a fleet that is short of time must not spend it on asking itself. What is lost soon shows: more of the same robot comes,
or another tells that it has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FEW = 5  # missing closings or words that may have been lost; more of them are late
HELPERS = 5  # robots that at once repeat what others wrote
MEMORY = 1  # rounds for which a robot remembers that it woke late
QUIET = 4  # rounds after which a late robot asks again for what is probably as late as itself
LOSSY = 16  # rounds for which a robot remembers that something was lost
SMALL = 8  # robots that may all ask at once for what is not known to have been sent; of more than that
ASKERS = 2  # may in each round


@dataclass(slots=True)
class Patience:
    """Of robot `pid` in a fleet of `n_sys`; rounds only go up. A punctual robot may ask at every slot; one that was
    late asks once a round, while it is late in every second round, and where nothing is known to be lost, seldom."""

    pid: int
    n_sys: int
    _asked: int = 0
    _late: int = -MEMORY
    _lost: int = -LOSSY
    _lagging: int = 0
    _waits: bool = True

    def wakes(self, round_: int, timely: bool) -> None:
        """It comes to a slot of this round, in time or not."""
        if not timely:
            self._late = round_

    def strained(self, round_: int) -> bool:
        """Whether it was late, or is."""
        return round_ <= self._late + MEMORY

    def hurried(self, round_: int) -> bool:
        """Whether it was, and nothing has been lost lately: all that it lacks is probably late."""
        return round_ <= self._late + MEMORY and round_ > self._lost + LOSSY

    def waits(self, round_: int) -> bool:
        """Whether it leaves a round open in which it lacks something of the last. A fleet that does so in one round
        after the other has only half of each for what a whole round is too short for, and stays behind for good: who
        is hurried gives every further round up at once, until all is there in time."""
        if round_ != self._lagging:
            again, self._lagging = round_ == self._lagging + 1, round_
            self._waits = not (again and self.hurried(round_))
        return self._waits

    def asks(self, round_: int, timely: bool, lost: bool) -> bool:
        """Whether it asks now, where it lacks something; `lost`: of that, something is known to have been sent. Where
        nothing has been lost lately it may be late at all the others too: few of a large fleet ask then, others in each
        round."""
        if lost:
            self._lost = round_
        elif round_ > self._lost + LOSSY and self.n_sys > SMALL and (self.pid - ASKERS * round_) % self.n_sys >= ASKERS:
            return False
        if self.strained(round_) and round_ <= self._asked + (QUIET if not lost else 0 if timely else MEMORY):
            return False
        self._asked = round_
        return True


def asked(
    missing: Sequence[int], unaware: Sequence[int], others: Sequence[int], turn: int
) -> tuple[Sequence[int], list[list[int]]]:
    """Which of those are asked whose closings are `missing`; and to whom questions go, each list's at once: to them, to
    one of the `others` who may hold them, and to those whose word is wanted. Where much is missing it is late rather
    than lost, and a large fleet in which all ask all has no time to be anything but late: then only one of them is
    asked, another each `turn`."""
    peers = few(missing, turn)
    rest = [p for p in others if p not in missing] if missing else []
    to = sorted({*peers, *rest[turn % max(1, len(rest)) :][:1], *few(unaware, turn)})
    # Who merely hears a question answers it too: one to few goes to each alone.
    return peers, [to] if 2 * len(to) > len(others) + 1 else [[p] for p in to]


def helps(pid: int, other: int, round_: int, n_sys: int) -> bool:
    """Whether it is this robot's turn to repeat to another what third ones wrote: if all did so at once, a large fleet
    in which one is late would have no time for anything else."""
    return (pid - other - round_) % n_sys < HELPERS


def many(missing: int, n_sys: int) -> bool:
    """Whether so much is missing that the fleet is late: loss leaves more."""
    return missing > max(FEW, n_sys // 2)


def few(pids: Sequence[int], turn: int) -> Sequence[int]:
    """All of them, or of many one in turn."""
    return pids if len(pids) <= FEW else [pids[turn % len(pids)]]
