"""What the other robots last said of themselves: how far they have applied, and what they lack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from koordgen.runtime.views import majority
from koordgen.runtime.wire import View


@dataclass(slots=True)
class Word:
    """A peer goes by this view, has applied, holds (when it lacked something), wanted closings up to `through`; and
    whether it was sent what it lacked."""

    held: Sequence[int]
    view: int = -1
    applied: int = 0
    through: int = 0
    answered: bool = True


class Words:
    """Of the others, as robot `pid` of `n_sys` has heard them. `unanswered`: those that by their last word lack
    something, and were not sent it yet."""

    def __init__(self, pid: int, n_sys: int) -> None:
        self._n = n_sys
        self._words = {p: Word((0,) * n_sys) for p in range(n_sys) if p != pid}
        self.unanswered: set[int] = set()
        self._sure = -1  # a round that is stable, as are all before it; -1: none is known in this view
        self._watched, self._reached = -1, 0  # a round, and how many have said to have applied it

    def renew(self) -> None:
        """There is another view."""
        self._sure = self._watched = -1

    def forget(self, pid: int) -> None:
        """It no longer counts, or counts anew."""
        self.unanswered.discard(pid)
        self._words[pid] = Word((0,) * self._n)

    def hear(self, pid: int, ours: bool, view: int, applied: int, held: Sequence[int], through: int,
             asks: bool) -> None:  # fmt: skip
        """Note a peer's word: see Memory.heard. `ours`: it goes by the present view."""
        word = self._words[pid]
        if view >= word.view and applied >= word.applied:
            if ours and applied >= self._watched > (word.applied if word.view == view else -1):
                self._reached += 1
            word.view, word.applied = view, applied
        if through > word.through or (asks and through == word.through):
            word.through = through
            if (min(held) if held else applied) < through:
                word.answered, word.held = False, held or (applied,) * self._n
                self.unanswered.add(pid)
            elif not word.answered:
                word.answered = True
                self.unanswered.discard(pid)

    def unanswered_by(self, pid: int) -> Word | None:
        """The word of a peer that lacks something, from now on answered; None when there is nothing to answer."""
        word = self._words[pid]
        if word.answered:
            return None
        word.answered = True
        self.unanswered.discard(pid)
        return word

    def stable(self, round_: int, applied: int, view: View) -> bool:
        """Whether no view can leave out what was done up to this round, where all is applied up to `applied`."""
        if round_ <= self._sure:
            return True
        if round_ < view.since:
            return applied >= round_
        if round_ > applied:
            return False
        needed = majority(self._n) - 1  # of the others
        if round_ != self._watched:
            said = sorted([w.applied if w.view == view.number else -1 for w in self._words.values()], reverse=True)
            self._sure = min(applied, said[needed - 1]) if needed else applied
            self._watched, self._reached = round_, len([a for a in said if a >= round_])
        return self._reached >= needed

    def unaware(self, round_: int, view: View) -> list[int]:
        """The members that have not said to have applied a round."""
        number, members = view.number, view.members
        return [p for p, w in self._words.items() if members[p] >= 0 and not (w.view == number and w.applied >= round_)]

    def applied(self, view: View) -> dict[int, int]:
        """How far the other members, by their words in this view, have applied."""
        members, number = view.members, view.number
        return {p: w.applied if w.view == number else 0 for p, w in self._words.items() if members[p] >= 0}
