"""View schedule: the view of each round, from the next round to be applied on.

It usually contains one view. It contains several while rounds of an old view are still to be applied."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from koordgen.runtime.net.wire import Entry, View
from koordgen.runtime.replication.log import Log, is_silent, shortened

FAR = 2**53  # a round that is never reached


class Schedule:
    """View schedule, which begins with the view of the next round to be applied.

    first: the view of that round.
    members: pids of the members of `first`.
    is_single: no later view is known.
    Invariant: the views have consecutive numbers, and each begins no earlier than the one before it."""

    def __init__(self, view: View) -> None:
        self._views = [view]
        self.drop(view.since - 1)

    def append(self, view: View) -> None:
        """Add the next view."""
        self._views.append(view)
        self.is_single = False

    def drop(self, applied: int) -> None:
        """Drop the views that have ended: all rounds up to `applied` are applied."""
        while len(self._views) > 1 and self._views[1].since <= applied + 1:
            del self._views[0]
        self.first, self.is_single = self._views[0], len(self._views) == 1
        self.members = [pid for pid, incarnation in enumerate(self.first.members) if incarnation >= 0]

    def at(self, round_: int) -> View:
        """Return the view of a round that is not yet applied."""
        return next(v for v in reversed(self._views) if v.since <= round_ or v is self.first)

    def end(self, round_: int) -> int:
        """Return the last round of the view that contains `round_`; FAR for the latest view."""
        return min((v.since - 1 for v in self._views if v.since > round_), default=FAR)

    def valid_part(self, entry: Entry) -> Entry | None:
        """Return the part of an entry in whose rounds its author was a member with that incarnation, or None."""
        author, incarnation = entry.author, entry.incarnation
        if self.at(entry.round).members[author] == incarnation:
            return entry
        for view in self._views:
            if view.since > entry.first and view.members[author] != incarnation:
                began = self.at(entry.first).members[author] == incarnation
                return shortened(entry, view.since - 1) if began and is_silent(entry) else None
        return None

    def skip_absences(self, logs: Sequence[Log]) -> None:
        """Skip in all logs the rounds before the latest view in which the log's author was no member."""
        for pid, log in enumerate(logs):
            for first, last in self._absences(pid):
                if first <= log.held + 1 <= last:
                    log.skip(last)

    def _absences(self, pid: int) -> Iterator[tuple[int, int]]:
        """Yield the first and last rounds before the latest view in which a robot was no member."""
        for i, (view, following) in enumerate(pairwise(self._views)):
            if view.members[pid] < 0:
                yield view.since if i else 0, following.since - 1
