"""Application of one round's entries to the shared store: lock arbitration, then merge of the writes.

The result depends only on the entries and the store, so all robots compute the same store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from koordgen.runtime.net.layout import Layout, Unpatched
from koordgen.runtime.replication.log import Logged

Store = Mapping[str, Any]


def winner(contenders: Sequence[int], lock: int, round_: int, n_sys: int) -> int:
    """Return the winner of a lock: the one robot, of those that contend for it, whose transaction counts.

    Priority rotates every round, so no robot starves.
    """
    return min(contenders, key=lambda pid: (pid - round_ - lock) % n_sys)


def arbitrate(entries: Sequence[Logged], round_: int, n_sys: int) -> tuple[list[Logged], list[Logged]]:
    """Return the winning transactions of a round, one for each lock, and the entries without a lock."""
    contenders: dict[int, list[int]] = {}
    for logged in entries:
        if logged.entry.lock >= 0:
            contenders.setdefault(logged.entry.lock, []).append(logged.entry.author)
    winners = {winner(pids, lock, round_, n_sys) for lock, pids in contenders.items()}
    commits = [e for e in entries if e.entry.lock >= 0 and e.entry.author in winners]
    return commits, [e for e in entries if e.entry.lock < 0]


def merge(layout: Layout, entries: Sequence[Logged], shared: Store, acted: list[int]) -> tuple[Store, list[int], int]:
    """Apply the writes of `entries` in order. Return the store, `acted` and the number of bad patches.

    acted: for each robot, the last round in which its event counted. The result is a new list if a round changes.
    A bad patch does not fit the value that it changes. Every robot ignores the same bad patches.
    """
    before, after, unfit = acted, acted, 0
    is_slots = layout.is_slots
    changed: dict[int, Any] = {}
    for logged in entries:
        entry = logged.entry
        author = entry.author
        if entry.acted:
            if after is before:
                after = after.copy()
            after[author] = entry.round
        for index, item in logged.values:
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
