"""Reassembly of entries that are longer than a datagram: at most one entry per author at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.net.codec import entry_of
from koordgen.runtime.net.fragments import Reassembly
from koordgen.runtime.net.wire import Entry, Fragment, HeldFragments

MOST_HELD = 8  # largest number of entries whose received fragments one Nack reports


@dataclass(frozen=True, slots=True)
class _Begun:
    incarnation: int
    round: int
    fragments: Reassembly


class Assembly:
    """Entries of which some fragments have arrived: at most one entry per author."""

    def __init__(self) -> None:
        self._begun: dict[int, _Begun] = {}

    def clear(self) -> None:
        self._begun.clear()

    def received(self) -> tuple[HeldFragments, ...]:
        """Return the received fragments of each entry. A Nack reports them, so that they are not sent again."""
        begun = [
            HeldFragments(author, b.round, b.fragments.name, b.fragments.mask) for author, b in self._begun.items()
        ]
        return tuple(begun[:MOST_HELD])

    def add(self, fragment: Fragment, wanted: Callable[[int, int], bool]) -> Entry | str | None:
        """Add a fragment. Return the entry once it is complete, the reason for a refusal, or else None.

        wanted: function that returns whether the entry of a given author and round is needed."""
        author = fragment.author
        if not wanted(author, fragment.round):
            return None
        known = self._begun.get(author)
        if known is None or (known.round != fragment.round and not wanted(author, known.round)):
            known = _Begun(fragment.incarnation, fragment.round, Reassembly(fragment.digest, fragment.count))
            self._begun[author] = known
        if (known.incarnation, known.round) != (fragment.incarnation, fragment.round):
            return None  # only one entry at a time; another entry is requested again later
        refused = known.fragments.add((fragment.digest, fragment.index, fragment.count, fragment.data))
        if refused is not None:
            return refused
        blob = known.fragments.blob()
        if blob is None:
            return None
        del self._begun[author]
        entry = entry_of(blob)
        return entry if entry is not None and entry.author == author else "entry does not fit"
