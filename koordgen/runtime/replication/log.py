"""Log of one robot's entries: complete up to round `held`, with some later entries behind a gap.

An entry ends one or more rounds of its author. Each round with an event has an entry of its own. Adjacent rounds
without an event share one silent entry, so the log of a robot that is silent for hours is one entry.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import msgspec

from koordgen.runtime.net.wire import Contribution, Entry, Write

MOST_BEHIND_GAP = 64  # largest number of one author's entries kept while an earlier entry is missing

# Largest number of kept entries per author whose writes are not copied out of their datagram. A copy costs time, and
# most entries are dropped soon. Further entries are copied, so that they do not keep their datagrams in memory.
MOST_SHARING = 8


class Logged:
    """An entry with its decoded events, by instance."""

    __slots__ = ("entry", "events")

    def __init__(self, entry: Entry, events: Sequence[Contribution]) -> None:
        self.entry = entry
        self.events = events

    @property
    def is_single(self) -> bool:
        """True if the entry is not silent. An entry that is not silent covers exactly one round."""
        return not is_silent(self.entry)


def is_silent(entry: Entry) -> bool:
    """Return whether an entry is silent: its author ran no event, wrote nothing and contended for no lock."""
    return not (entry.writes or entry.acted or entry.lock >= 0)


def shortened(entry: Entry, last: int) -> Entry:
    """Return a copy of the entry that ends with round `last`."""
    return msgspec.structs.replace(entry, round=last)


def _from(entry: Entry, first: int) -> Entry:
    """Return the entry without its rounds before `first`."""
    return entry if entry.first >= first else msgspec.structs.replace(entry, first=first)


def _detached(entry: Entry) -> Entry:
    """Return the entry with a copy of its writes, so that the entry does not keep its datagram in memory."""
    writes = entry.writes
    if not writes:
        return entry
    if not isinstance(writes, dict):
        return msgspec.structs.replace(entry, writes=_copied(writes))
    parts = {key: msgspec.structs.replace(part, writes=_copied(part.writes)) for key, part in writes.items()}
    return msgspec.structs.replace(entry, writes=parts)


def _copied(writes: Sequence[Write]) -> tuple[Write, ...]:
    return tuple([Write(w.index, msgspec.Raw(bytes(w.value)), w.patch) for w in writes])


def _merged(before: Entry, entry: Entry) -> Entry | None:
    """Merge two adjacent silent entries into one. Return None if they cannot be merged."""
    if before.round != entry.first - 1 or not is_silent(before) or not is_silent(entry):
        return None
    if before.stopped != entry.stopped or before.incarnation != entry.incarnation:
        return None
    return msgspec.structs.replace(before, round=entry.round, stopped=entry.stopped)


class EntryLog:
    """Log of one robot's entries.

    held: last round up to which all entries have arrived. Some of them may have been dropped since.
    kept: entries that some member may still need, ascending and without a gap. The last entry ends at `held`.
    later: first round -> entry behind a gap. Invariant: first round > held + 1.
    """

    __slots__ = ("held", "kept", "later")

    def __init__(self, held: int) -> None:
        self.held = held
        self.kept: list[Logged] = []
        self.later: dict[int, Logged] = {}

    def has_room(self, first: int) -> bool:
        """Return whether the log has room for an entry that begins at round `first`."""
        return first <= self.held + 1 or len(self.later) < MOST_BEHIND_GAP

    def append(self, entry: Entry, events: Sequence[Contribution]) -> None:
        """Add an entry to the log. Precondition: the entry ends after round `held`."""
        if entry.first == self.held + 1 and entry.acted and not self.later and len(self.kept) < MOST_SHARING:
            self.kept.append(Logged(entry, events))  # most entries arrive in order: this case is tested first
            self.held = entry.round
            return
        if len(self.kept) >= MOST_SHARING or entry.first > self.held + 1:
            entry = _detached(entry)
        if entry.first <= self.held + 1:
            self._extend(Logged(entry, events))
            if self.later:
                self._close_gap()
            return
        known = self.later.get(entry.first)
        if known is None or known.entry.round < entry.round:
            self.later[entry.first] = Logged(entry, events)

    def _extend(self, logged: Logged) -> None:
        """Add an entry to `kept`. Precondition: the entry begins at or before round held + 1."""
        entry = _from(logged.entry, self.held + 1)
        merged = _merged(self.kept[-1].entry, entry) if self.kept else None
        if merged is not None:
            self.kept[-1] = Logged(merged, ())
        else:
            self.kept.append(logged if entry is logged.entry else Logged(entry, logged.events))
        self.held = entry.round

    def _close_gap(self) -> None:
        """Move entries from `later` to `kept` if no gap is left before them."""
        while self.later:
            first = min(self.later)
            if first > self.held + 1:
                return
            logged = self.later.pop(first)
            if logged.entry.round > self.held:
                self._extend(logged)

    def at(self, round_: int) -> Logged:
        """Return the entry that covers round `round_`. Precondition: the entry is in `kept`."""
        kept = self.kept
        last = kept[-1]
        if last.entry.first <= round_ <= last.entry.round:
            return last
        return kept[bisect_left(kept, round_, key=lambda logged: logged.entry.round)]

    def between(self, low: int, high: int) -> list[Entry]:
        """Return the kept entries that cover rounds from `low` to `high`, without rounds before `low`."""
        begin = bisect_left(self.kept, low, key=lambda logged: logged.entry.round)
        return [_from(logged.entry, low) for logged in self.kept[begin:] if logged.entry.first <= high]

    def drop(self, through: int) -> None:
        """Drop the entries that end at or before round `through`, because every member holds them."""
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
            kept.append(Logged(shortened(final.entry, last), final.events))
        self.held = min(self.held, last)

    def skip(self, last: int) -> None:
        """Count the rounds up to `last` as held, although they have no entries: the author was no member."""
        self.held = max(self.held, last)
        self._close_gap()
