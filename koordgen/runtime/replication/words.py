"""What the other robots last said of themselves: how far they have applied, and what they lack.

Acknowledgements of each peer, as it sent them last.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from koordgen.runtime.net.ledger import REACHED, WANTING, WATCHED, Ledger
from koordgen.runtime.net.wire import View
from koordgen.runtime.replication.views import majority


class Words:
    """Of the others; in columns of the `ledger`, where the gate notes most of them."""

    def __init__(self, ledger: Ledger) -> None:
        pid, n = ledger.pid, ledger.n_sys
        self._others = [p for p in range(n) if p != pid]
        self._n = n
        self._view, self._applied, self._through = ledger.view, ledger.applied, ledger.through
        self._wanting, self._number = ledger.wanting, ledger.number
        self._lacks = ledger.lacks
        self.sure = -1  # a round that is stable, as are all before it; -1: none is known in this view
        self._number[WATCHED] = -1  # a round; and how many have said to have applied it is REACHED

    def unanswered(self) -> list[int]:
        """Those that by their last word lack something, and were not sent it yet."""
        return [pid for pid, wanting in enumerate(self._wanting) if wanting]

    def renew(self) -> None:
        """There is another view."""
        self.sure = self._number[WATCHED] = -1

    def forget(self, pid: int) -> None:
        """It no longer counts, or counts anew."""
        self._want(pid, False)
        self._view[pid], self._applied[pid], self._through[pid] = -1, 0, 0

    def content(self, pid: int, view: int, applied: int, through: int) -> bool:
        """Note the word of one that goes by the present view, as it did before, and lacks nothing, now or before; False
        where there is more to be noted of it, and nothing was."""
        before = self._applied[pid]
        if self._view[pid] != view or self._wanting[pid] or not before <= applied >= through:
            return False
        if applied >= self._number[WATCHED] > before:
            self._number[REACHED] += 1
        self._applied[pid] = applied
        if through > self._through[pid]:
            self._through[pid] = through
        return True

    def hear(self, pid: int, ours: bool, view: int, applied: int, held: Sequence[int], through: int,
             asks: bool) -> None:  # fmt: skip
        """Note a peer's word: see Memory.heard. `ours`: it goes by the present view."""
        before, so_far = self._view[pid], self._applied[pid]
        if view >= before and applied >= so_far:
            if ours and applied >= self._number[WATCHED] > (so_far if before == view else -1):
                self._number[REACHED] += 1
            self._view[pid], self._applied[pid] = view, applied
        if through > self._through[pid] or (asks and through == self._through[pid]):
            self._through[pid] = through
            if (min(held) if held else applied) < through:
                self._lacks[pid * self._n : (pid + 1) * self._n] = array("q", held or (applied,) * self._n)
                self._want(pid, True)
            else:
                self._want(pid, False)

    def answer(self, pid: int) -> tuple[Sequence[int], int] | None:
        """What a peer that lacks something holds, and up to which round it wants the rest, answered from now on; None
        when there is nothing to answer."""
        if not self._wanting[pid]:
            return None
        self._want(pid, False)
        return self._lacks[pid * self._n : (pid + 1) * self._n], self._through[pid]

    def stable(self, round_: int, applied: int, view: View) -> bool:
        """Whether no view can leave out what was done up to this round, where all is applied up to `applied`."""
        if round_ <= self.sure:
            return True
        if round_ < view.since:
            return applied >= round_
        if round_ > applied:
            return False
        needed = majority(self._n) - 1  # of the others
        counts = self._number
        if round_ != counts[WATCHED]:
            number, views, applieds = view.number, self._view, self._applied
            every = views.count(number) == len(self._others)  # nearly always; its own column counts as 0
            said = sorted(applieds if every else [applieds[p] if views[p] == number else -1 for p in self._others])
            self.sure = min(applied, said[-needed]) if needed else applied
            if round_ <= self.sure:
                return True
            counts[WATCHED], counts[REACHED] = round_, len([a for a in said if a >= round_])
        return counts[REACHED] >= needed

    def unaware(self, round_: int, view: View) -> list[int]:
        """The members that have not said to have applied a round."""
        return [p for p, applied in self.applied(view).items() if applied < round_]

    def applied(self, view: View) -> dict[int, int]:
        """How far the other members, by their words in this view, have applied; -1: not heard in it."""
        members, number, views, applied = view.members, view.number, self._view, self._applied
        return {p: applied[p] if views[p] == number else -1 for p in self._others if members[p] >= 0}

    def _want(self, pid: int, wanting: bool) -> None:
        self._number[WANTING] += wanting - self._wanting[pid]
        self._wanting[pid] = wanting
