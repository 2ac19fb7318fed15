"""Log of one robot's entries: contiguous up to `held`, with some more behind a gap.

An entry ends one or more rounds of its author: rounds in which an event ran have one entry each, adjacent silent rounds
share one. So the log of a robot that is silent for hours is one entry.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Any

import msgspec

from koordgen.runtime.net.wire import Entry, Write

MOST_BEHIND_GAP = 64  # largest number of one author's entries kept while an earlier entry is missing
# Largest number of entries per author that refer to the memory of their datagram. Copying it costs time, and most
# entries are dropped soon; later entries are copied, so that not every datagram stays in memory.
MOST_SHARING = 8

Values = Sequence[tuple[int, Any]]


class Logged:
    """An entry with its decoded values, as pairs (index of the variable, value)."""

    __slots__ = ("entry", "values")

    def __init__(self, entry: Entry, values: Values) -> None:
        self.entry = entry
        self.values = values

    @property
    def is_single(self) -> bool:
        """True if the author did something; such an entry covers exactly one round."""
        return not is_silent(self.entry)


def is_silent(entry: Entry) -> bool:
    """Return whether the author did nothing in the entry's rounds."""
    return not (entry.writes or entry.acted or entry.lock >= 0)


def shortened(entry: Entry, last: int) -> Entry:
    """Return the entry up to round `last`."""
    return msgspec.structs.replace(entry, round=last)


def _from(entry: Entry, first: int) -> Entry:
    """Return the entry without the rounds before `first`."""
    return entry if entry.first >= first else msgspec.structs.replace(entry, first=first)


def _detached(entry: Entry) -> Entry:
    """Return the entry with a copy of its writes, so that it does not keep a whole datagram alive."""
    if not entry.writes:
        return entry
    writes = tuple([Write(w.index, msgspec.Raw(bytes(w.value)), w.patch) for w in entry.writes])
    return msgspec.structs.replace(entry, writes=writes)


def _merged(before: Entry, entry: Entry) -> Entry | None:
    """Return two silent entries as one, or None if they are not silent and adjacent."""
    if before.round != entry.first - 1 or not is_silent(before) or not is_silent(entry):
        return None
    if before.stopped != entry.stopped or before.incarnation != entry.incarnation:
        return None
    return msgspec.structs.replace(before, round=entry.round, stopped=entry.stopped)


class Log:
    """Log of one robot's entries.

    held: all entries up to this round have arrived; some may have been dropped since.
    kept: entries up to `held` that some member may still need, in ascending order and without a gap; the last one ends
        at `held`.
    later: entries behind a gap, by their first round. Invariant: each begins after held + 1.
    """

    __slots__ = ("held", "kept", "later")

    def __init__(self, held: int) -> None:
        self.held = held
        self.kept: list[Logged] = []
        self.later: dict[int, Logged] = {}

    def has_room(self, first: int) -> bool:
        """Return whether an entry that begins at round `first` may be kept."""
        return first <= self.held + 1 or len(self.later) < MOST_BEHIND_GAP

    def append(self, entry: Entry, values: Values) -> None:
        """Keep an entry that ends after `held`."""
        if entry.first == self.held + 1 and entry.acted and not self.later and len(self.kept) < MOST_SHARING:
            self.kept.append(Logged(entry, values))  # by far the most frequent case, so it is tested first
            self.held = entry.round
            return
        if len(self.kept) >= MOST_SHARING or entry.first > self.held + 1:
            entry = _detached(entry)
        if entry.first <= self.held + 1:
            self._extend(Logged(entry, values))
            if self.later:
                self._close_gap()
            return
        known = self.later.get(entry.first)
        if known is None or known.entry.round < entry.round:
            self.later[entry.first] = Logged(entry, values)

    def _extend(self, logged: Logged) -> None:
        """Keep an entry that begins no later than held + 1."""
        entry = _from(logged.entry, self.held + 1)
        merged = _merged(self.kept[-1].entry, entry) if self.kept else None
        if merged is not None:
            self.kept[-1] = Logged(merged, ())
        else:
            self.kept.append(logged if entry is logged.entry else Logged(entry, logged.values))
        self.held = entry.round

    def _close_gap(self) -> None:
        """Move entries that are no longer behind a gap."""
        while self.later:
            first = min(self.later)
            if first > self.held + 1:
                return
            logged = self.later.pop(first)
            if logged.entry.round > self.held:
                self._extend(logged)

    def at(self, round_: int) -> Logged:
        """Return the entry of a round that is held and was not dropped."""
        kept = self.kept
        last = kept[-1]
        if last.entry.first <= round_ <= last.entry.round:
            return last
        return kept[bisect_left(kept, round_, key=lambda logged: logged.entry.round)]

    def between(self, low: int, high: int) -> list[Entry]:
        """Return the entries of rounds `low` to `high` that are held and were not dropped."""
        begin = bisect_left(self.kept, low, key=lambda logged: logged.entry.round)
        return [_from(logged.entry, low) for logged in self.kept[begin:] if logged.entry.first <= high]

    def drop(self, through: int) -> None:
        """Drop the entries that end by round `through`: every member holds them."""
        kept = self.kept
        if kept and kept[0].entry.round <= through:
            del kept[: bisect_right(kept, through, key=lambda logged: logged.entry.round)]

    def truncate(self, last: int) -> None:
        """Drop all entries after round `last`, because a view change has discarded these rounds."""
        kept = self.kept
        self.later.clear()
        while kept and kept[-1].entry.first > last:
            kept.pop()
        if kept and kept[-1].entry.round > last:
            final = kept.pop()
            kept.append(Logged(shortened(final.entry, last), final.values))
        self.held = min(self.held, last)

    def skip(self, last: int) -> None:
        """Count the rounds up to `last` as held. They have no entries, because the author was no member."""
        self.held = max(self.held, last)
        self._close_gap()
