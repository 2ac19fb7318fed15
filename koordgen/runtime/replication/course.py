"""Which view counts in which round: the views from the next round to be applied on, nearly always one alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from koordgen.runtime.net.wire import Closing, View
from koordgen.runtime.replication.log import Log, shortened

FAR = 2**53  # a round that never comes


class Course:
    """`first` is the view of the next round to be applied, `members` who counts in it, `single` whether none comes
    after it."""

    def __init__(self, view: View) -> None:
        self._views = [view]
        self.drop(view.since - 1)

    def append(self, view: View) -> None:
        """The next view."""
        self._views.append(view)
        self.single = False

    def drop(self, applied: int) -> None:
        """All rounds up to this one are applied."""
        while len(self._views) > 1 and self._views[1].since <= applied + 1:
            del self._views[0]
        self.first, self.single = self._views[0], len(self._views) == 1
        self.members = [pid for pid, incarnation in enumerate(self.first.members) if incarnation >= 0]

    def at(self, round_: int) -> View:
        """The view of a round not before the next one to be applied."""
        return next(v for v in reversed(self._views) if v.since <= round_ or v is self.first)

    def end(self, round_: int) -> int:
        """The last round of the view that `round_` is in; one far away for the latest."""
        return min((v.since - 1 for v in self._views if v.since > round_), default=FAR)

    def of_this_life(self, closing: Closing) -> Closing | None:
        """The closing as far as its author counted in that incarnation, or None."""
        if self.at(closing.round).members[closing.author] == closing.incarnation:
            return closing
        for view in self._views:
            if view.since > closing.first and view.members[closing.author] != closing.incarnation:
                single = closing.writes or closing.acted or closing.lock >= 0
                began = self.at(closing.first).members[closing.author] == closing.incarnation
                return shortened(closing, view.since - 1) if began and not single else None
        return None

    def pass_over(self, logs: Sequence[Log]) -> None:
        """Take for held what is not to come: the rounds, before the latest view, in which a robot does not count."""
        for pid, log in enumerate(logs):
            for begins, ends in self._absences(pid):
                if begins <= log.held + 1 <= ends:
                    log.skip(ends)

    def _absences(self, pid: int) -> Iterator[tuple[int, int]]:
        """The rounds, first and last, in which a robot does not count, before the latest view."""
        for i, (view, following) in enumerate(pairwise(self._views)):
            if view.members[pid] < 0:
                yield view.since if i else 0, following.since - 1
