"""One robot's closings as another holds them: without a gap up to a round, and some beyond a gap."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from koordgen.runtime.wire import Closing, Write

GAPS = 64  # closings kept while one before them is missing


class Entry(msgspec.Struct, frozen=True, gc=False):
    """A closing and the values in it by index."""

    closing: Closing
    values: Sequence[tuple[int, Any]]

    @property
    def single(self) -> bool:
        """Whether it is of one round in which something was done, not of several in which nothing was."""
        return bool(self.closing.writes) or self.closing.acted or self.closing.lock >= 0


def detached(closing: Closing) -> Closing:
    """The closing with writes of its own: it must not keep the whole datagram that it came in."""
    if not closing.writes:
        return closing
    kept = tuple([Write(w.index, msgspec.Raw(bytes(w.value)), w.patch) for w in closing.writes])
    return msgspec.structs.replace(closing, writes=kept)


def shortened(closing: Closing, last: int) -> Closing:
    """The closing up to a round."""
    return msgspec.structs.replace(closing, round=last)


@dataclass(slots=True)
class Log:
    """`entries` are without a gap up to `held` (from some round on that everyone holds), `later`, by their first round,
    beyond a gap."""

    held: int = 0
    entries: list[Entry] = field(default_factory=list)
    later: dict[int, Entry] = field(default_factory=dict)

    def take(self, entry: Entry) -> None:
        """Keep a closing that reaches beyond `held`."""
        closing = entry.closing
        if closing.first == self.held + 1 and closing.acted and not self.later:  # nearly always, so first
            self.entries.append(entry)
            self.held = closing.round
            return
        if closing.first <= self.held + 1:
            self.append(entry)
            if self.later:
                self._absorb()
            return
        known = self.later.get(closing.first)
        if known is None or known.closing.round < closing.round:
            self.later[closing.first] = entry

    def append(self, entry: Entry) -> None:
        """Keep a closing that begins where `held` ends; silence is joined to silence."""
        closing = entry.closing
        if closing.first <= self.held:
            closing = msgspec.structs.replace(closing, first=self.held + 1)
        if self.entries and not entry.single:
            last = self.entries[-1]
            same = last.closing.stopped == closing.stopped and last.closing.incarnation == closing.incarnation
            if same and not last.single and last.closing.round == closing.first - 1:
                closing = msgspec.structs.replace(closing, first=last.closing.first)
                self.entries.pop()
        self.entries.append(entry if closing is entry.closing else Entry(closing, entry.values))
        self.held = closing.round

    def at(self, round_: int) -> Entry:
        """The entry that covers a round which is held and not forgotten."""
        last = self.entries[-1]
        if last.closing.first <= round_ <= last.closing.round:
            return last
        return self.entries[bisect_left(self.entries, round_, key=lambda e: e.closing.round)]

    def between(self, low: int, high: int) -> list[Closing]:
        """The closings of these rounds, as far as they are held and not forgotten."""
        found = []
        for entry in self.entries[bisect_left(self.entries, low, key=lambda e: e.closing.round) :]:
            closing = entry.closing
            if closing.first > high:
                break
            found.append(closing if closing.first >= low else msgspec.structs.replace(closing, first=low))
        return found

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
        self.later.clear()
        while self.entries and self.entries[-1].closing.first > last:
            self.entries.pop()
        if self.entries and self.entries[-1].closing.round > last:
            final = self.entries.pop()
            self.entries.append(Entry(shortened(final.closing, last), final.values))
        self.held = min(self.held, last)

    def skip(self, last: int) -> None:
        """Take the rounds up to `last` for held: their author did not count."""
        self.held = max(self.held, last)
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
