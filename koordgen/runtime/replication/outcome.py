"""What the closings of one round make of the shared store, as all robots find it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from koordgen.runtime.net.layout import Layout, Unpatched
from koordgen.runtime.replication.log import Entry

# Which of a round's transactions count.


def winner(contenders: Sequence[int], lock: int, round_: int, n_sys: int) -> int:
    """Whose commit counts, of those that would change what one lock protects in one round: the first place goes round,
    so everyone comes to it."""
    return min(contenders, key=lambda pid: (pid - round_ - lock) % n_sys)


def counting(entries: Sequence[Entry], round_: int, n_sys: int) -> tuple[list[Entry], list[Entry]]:
    """The entries of a round whose events count: the commits, and the others."""
    contenders: dict[int, list[int]] = {}
    for entry in entries:
        if entry.closing.lock >= 0:
            contenders.setdefault(entry.closing.lock, []).append(entry.closing.author)
    winners = {winner(pids, lock, round_, n_sys) for lock, pids in contenders.items()}
    commits = [e for e in entries if e.closing.lock >= 0 and e.closing.author in winners]
    return commits, [e for e in entries if e.closing.lock < 0]


FORGET_EVERY = 16  # stores: to look which are of no use any more costs more than to keep some a little longer

Store = Mapping[str, Any]


class Past:
    """Stores, and the last rounds in which events counted, after a round and the silent ones behind it; the first is of
    a stable round."""

    def __init__(self, applied: int, shared: Store, acted: list[int]) -> None:
        self._known = [(applied, shared, acted)]

    def at(self, last: int) -> tuple[Store, list[int]] | None:
        """Those after a round; None when they are not known any more."""
        return next(((shared, acted) for round_, shared, acted in reversed(self._known) if round_ <= last), None)

    def add(self, round_: int, shared: Store, acted: list[int], stable: Callable[[int], bool]) -> None:
        """The next ones; those before the last stable round go. Without any no event runs for long: not much stays."""
        known = self._known
        if len(known) >= FORGET_EVERY:
            for index in range(len(known) - 1, 0, -1):
                if stable(known[index][0]):
                    del known[:index]
                    break
        known.append((round_, shared, acted))


def all_of(layout: Layout, entries: Sequence[Entry], shared: Store, acted: list[int]) -> tuple[Store, list[int], int]:
    """The store with what these closings wrote, in their order; the last rounds in which events counted; and how many
    patches fit no value."""
    before, after, unfit = acted, acted, 0
    is_slots = layout.is_slots
    changed: dict[int, Any] = {}
    for entry in entries:
        closing = entry.closing
        author = closing.author
        if closing.acted:
            if after is before:
                after = after.copy()
            after[author] = closing.round
        for index, item in entry.values:
            if type(item) is Unpatched:
                item = layout.resolve(index, item, layout.base(index, shared, author))
                if item is None:
                    unfit += 1
                    continue
            if is_slots[index]:
                slots = changed.get(index)
                if slots is None:
                    slots = changed[index] = list(shared[layout.names[index]])
                slots[author] = item
            else:
                changed[index] = item
    if not changed:
        return shared, after, unfit
    written = {layout.names[i]: tuple(v) if is_slots[i] else v for i, v in changed.items()}
    return {**shared, **written}, after, unfit
