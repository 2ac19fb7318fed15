"""When a robot asks for what it lacks, and repeats unasked what others lack.

Who wakes late shares a busy computer, and the others may be as late: what it lacks is then late rather than lost, and
a fleet that is short of time must not spend it on asking itself.
"""

from __future__ import annotations

from dataclasses import dataclass

MEMORY = 1  # rounds for which a robot remembers that it woke late


@dataclass(slots=True)
class Patience:
    """Rounds only go up. A punctual robot may ask at every slot; one that was late asks once a round, and while it is
    late in every second round."""

    _asked: int = 0
    _late: int = -MEMORY

    def wakes(self, round_: int, timely: bool) -> None:
        """It comes to a slot of this round, in time or not."""
        if not timely:
            self._late = round_

    def strained(self, round_: int) -> bool:
        """Whether it was late, or is."""
        return round_ <= self._late + MEMORY

    def asks(self, round_: int, timely: bool) -> bool:
        """Whether it asks now, where it lacks something."""
        if self.strained(round_) and round_ <= self._asked + (0 if timely else MEMORY):
            return False
        self._asked = round_
        return True
