"""View schedule: the view of each round that is not yet applied.

A schedule usually contains one view. It contains several views while rounds of an old view are not yet applied."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from koordgen.runtime.net.wire import Entry, View
from koordgen.runtime.replication.log import EntryLog, is_silent, shortened

FAR = 2**53  # a round number that no mission reaches


class Schedule:
    """List of the views that count in rounds not yet applied.

    first: view of the next round to be applied.
    members: pids of the members of `first`.
    is_single: the schedule contains only `first`.
    Invariant: the views have consecutive numbers, and no view begins before an earlier view in the list."""

    def __init__(self, view: View) -> None:
        self._views = [view]
        self.drop(view.since - 1)

    def append(self, view: View) -> None:
        """Append the view that follows the latest view of the schedule."""
        self._views.append(view)
        self.is_single = False

    def drop(self, applied: int) -> None:
        """Drop the views whose rounds are all applied; `applied` is the last applied round."""
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
        """Return the part of an entry that counts, or None if no part counts.

        A round of an entry counts if the author is a member in that round, with the incarnation of the entry. Only a
        silent entry can be shortened."""
        author, incarnation = entry.author, entry.incarnation
        if self.at(entry.round).members[author] == incarnation:
            return entry
        for view in self._views:
            if view.since > entry.first and view.members[author] != incarnation:
                began = self.at(entry.first).members[author] == incarnation
                return shortened(entry, view.since - 1) if began and is_silent(entry) else None
        return None

    def skip_absences(self, logs: Sequence[EntryLog]) -> None:
        """Skip, in each log, the rounds in which the log's author was no member, up to the latest view."""
        for pid, log in enumerate(logs):
            for first, last in self._absences(pid):
                if first <= log.held + 1 <= last:
                    log.skip(last)

    def _absences(self, pid: int) -> Iterator[tuple[int, int]]:
        """Yield ranges of rounds (first, last) before the latest view in which robot `pid` was no member."""
        for i, (view, following) in enumerate(pairwise(self._views)):
            if view.members[pid] < 0:
                yield view.since if i else 0, following.since - 1
