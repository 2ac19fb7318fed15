"""One robot's closings as another holds them: without a gap up to a round, and some beyond a gap."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Any

import msgspec

from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.wire import Closing, Write

GAPS = 64  # closings kept while one before them is missing

Values = Sequence[tuple[int, Any]]


class Entry(msgspec.Struct, frozen=True, gc=False):
    """A closing and the values in it by index."""

    closing: Closing
    values: Values

    @property
    def single(self) -> bool:
        """Whether it is of one round in which something was done, not of several in which nothing was."""
        return not _is_silent(self.closing)


def detached(closing: Closing) -> Closing:
    """The closing with writes of its own: it must not keep the whole datagram that it came in."""
    if not closing.writes:
        return closing
    kept = tuple([Write(w.index, msgspec.Raw(bytes(w.value)), w.patch) for w in closing.writes])
    return msgspec.structs.replace(closing, writes=kept)


def shortened(closing: Closing, last: int) -> Closing:
    """The closing up to a round."""
    return msgspec.structs.replace(closing, round=last)


def _since(closing: Closing, first: int) -> Closing:
    """The closing from a round on."""
    return closing if closing.first >= first else msgspec.structs.replace(closing, first=first)


def _is_silent(closing: Closing) -> bool:
    return not (closing.writes or closing.acted or closing.lock >= 0)


def _joined(before: Closing, closing: Closing) -> Closing | None:
    """Both as one, where both are silence, and one goes on where the other ends."""
    if not _is_silent(before) or not _is_silent(closing) or before.round != closing.first - 1:
        return None
    if before.stopped != closing.stopped or before.incarnation != closing.incarnation:
        return None
    return msgspec.structs.replace(closing, first=before.first)


class Log:
    """`entries` are without a gap up to `held` (from some round on that everyone holds), `later`, by their first round,
    beyond a gap."""

    __slots__ = ("_ledger", "_pid", "entries", "later")

    def __init__(self, ledger: Ledger, pid: int) -> None:
        self._ledger, self._pid = ledger, pid
        self.entries: list[Entry] = []
        self.later: dict[int, Entry] = {}

    @property
    def held(self) -> int:
        return self._ledger.held[self._pid]

    def __len__(self) -> int:
        return len(self.entries)

    def _reach(self, held: int) -> None:
        ledger, pid = self._ledger, self._pid
        ledger.held[pid] = held
        ledger.gap[pid] = bool(self.later)

    def take(self, entry: Entry) -> None:
        """Keep a closing that reaches beyond `held`."""
        closing = entry.closing
        if closing.first == self.held + 1 and closing.acted and not self.later:  # nearly always, so first
            self.entries.append(entry)
            self._reach(closing.round)
            return
        if closing.first <= self.held + 1:
            self.append(entry)
            if self.later:
                self._absorb()
            return
        known = self.later.get(closing.first)
        if known is None or known.closing.round < closing.round:
            self.later[closing.first] = entry
            self._ledger.gap[self._pid] = True

    def append(self, entry: Entry) -> None:
        """Keep a closing that begins where `held` ends."""
        closing = _since(entry.closing, self.held + 1)
        self._join(entry if closing is entry.closing else Entry(closing, entry.values))
        self._reach(closing.round)

    def _join(self, entry: Entry) -> None:
        """Keep what comes next; silence is joined to silence."""
        entries = self.entries
        both = _joined(entries[-1].closing, entry.closing) if entries else None
        if both is None:
            entries.append(entry)
        else:
            entries[-1] = Entry(both, ())

    def at(self, round_: int) -> Entry:
        """The entry that covers a round which is held and not forgotten."""
        entries = self.entries
        last = entries[-1]
        if last.closing.first <= round_ <= last.closing.round:
            return last
        return entries[bisect_left(entries, round_, key=lambda e: e.closing.round)]

    def between(self, low: int, high: int) -> list[Closing]:
        """The closings of these rounds, as far as they are held and not forgotten."""
        entries = self.entries
        found = [e.closing for e in entries[bisect_left(entries, low, key=lambda e: e.closing.round) :]]
        return [_since(closing, low) for closing in found if closing.first <= high]

    def forget(self, through: int) -> None:
        """Drop what ends by a round."""
        entries = self.entries
        if entries:
            count = through + 1 - entries[0].closing.first  # where each is of one round
            if not 0 < count <= len(entries) or entries[count - 1].closing.round != through:
                count = bisect_right(entries, through, key=lambda e: e.closing.round)
            del entries[:count]

    def cut(self, last: int) -> None:
        """Drop everything beyond a round: it does not count."""
        entries = self.entries
        self.later.clear()
        while entries and entries[-1].closing.first > last:
            entries.pop()
        if entries and entries[-1].closing.round > last:
            final = entries.pop()
            entries.append(Entry(shortened(final.closing, last), final.values))
        self._reach(min(self.held, last))

    def skip(self, last: int) -> None:
        """Take the rounds up to `last` for held: their author did not count."""
        if last > self.held:
            self._reach(last)
        self._absorb()

    def _absorb(self) -> None:
        """Append what is no longer beyond a gap."""
        while self.later:
            first = min(self.later)
            if first > self.held + 1:
                return
            entry = self.later.pop(first)
            if entry.closing.round > self.held:
                self.append(entry)
        self._ledger.gap[self._pid] = False
