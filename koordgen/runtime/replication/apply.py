"""Application of one round's entries to the shared store: lock arbitration, then merge of the writes.

The result depends only on the entries and the store, so all robots compute the same store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from koordgen.runtime.net.layout import Layout, Unpatched
from koordgen.runtime.net.wire import Contribution

Store = Mapping[str, Any]


def winner(contenders: Sequence[int], lock: int, round_: int, instances: int) -> int:
    """Return the winner of a lock: the one instance, of those that contend for it, whose transaction counts.

    instances: number of all instances.
    Priority rotates every round, so no instance starves.
    """
    return min(contenders, key=lambda instance: (instance - round_ - lock) % instances)


def arbitrate(
    events: Sequence[Contribution], round_: int, instances: int
) -> tuple[list[Contribution], list[Contribution]]:
    """Return the winning transactions of a round, one for each lock, and the events without a lock."""
    contenders: dict[int, list[int]] = {}
    for event in events:
        if event.lock >= 0:
            contenders.setdefault(event.lock, []).append(event.instance)
    winners = {winner(numbers, lock, round_, instances) for lock, numbers in contenders.items()}
    commits = [e for e in events if e.lock >= 0 and e.instance in winners]
    return commits, [e for e in events if e.lock < 0]


def merge(
    layout: Layout, events: Sequence[Contribution], round_: int, shared: Store, acted: list[int]
) -> tuple[Store, list[int], int]:
    """Apply the writes of a round's events in order. Return the store, `acted` and the number of bad patches.

    acted: for each instance, the last round in which its event counted. The result is a new list if a round changes.
    A bad patch does not fit the value that it changes. Every robot ignores the same bad patches.
    """
    before, after, unfit = acted, acted, 0
    is_slots = layout.is_slots
    changed: dict[int, Any] = {}
    for event in events:
        if event.acted:
            if after is before:
                after = after.copy()
            after[event.instance] = round_
        for index, item in event.values:
            if type(item) is Unpatched:
                item = layout.resolve(index, item, layout.base(index, shared, event.slot))
                if item is None:
                    unfit += 1
                    continue
            if is_slots[index]:
                slots = changed.get(index)
                if slots is None:
                    slots = changed[index] = list(shared[layout.names[index]])
                slots[event.slot] = item
            else:
                changed[index] = item
    if not changed:
        return shared, after, unfit
    written = {layout.names[i]: tuple(v) if is_slots[i] else v for i, v in changed.items()}
    return {**shared, **written}, after, unfit
