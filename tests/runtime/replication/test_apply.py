"""Application of one round: lock arbitration, and the merge of writes into the store."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import Contribution, Entry, Write
from koordgen.runtime.replication.apply import arbitrate, merge, winner
from tests.runtime.replication.states import acted, layout, silent, write

LAYOUT = layout()


def events(*entries: Entry, of: Layout = LAYOUT) -> list[Contribution]:
    return [event for e in entries for event in of.read(e) or ()]


def authors(found: list[Contribution]) -> list[int]:
    return [e.instance for e in found]


def store(*x: int, last: int = -1) -> dict[str, Any]:
    return {"x": x, "last": last}


def test_of_each_lock_one_commit_counts_and_plain_entries_all_do() -> None:
    entries = acted(0, 4, lock=0), acted(1, 4, lock=1), acted(2, 4, lock=0), silent(3, 4, 4), acted(4, 4)
    commits, plain = arbitrate(events(*entries, of=layout(5)), 4, 5)
    assert authors(commits) == sorted([1, winner((0, 2), 0, 4, 5)]) and authors(plain) == [4]


@pytest.mark.parametrize("lock", [0, 1, 5])
def test_priority_rotates_so_that_each_robot_wins_equally_often(lock: int) -> None:
    n = 5
    for contenders in ([0, 1, 2, 3, 4], [3]):
        won = [winner(contenders, lock, round_, n) for round_ in range(1, 1 + 10 * n)]
        assert all(won.count(pid) == 10 * n // len(contenders) for pid in contenders)


def test_writes_are_merged_in_the_order_of_the_entries() -> None:
    before, counted = store(1, 2, 3), [4, 4, 4]
    entries = events(acted(0, 5, write(0, 7), write(1, 70)), silent(1, 5, 5), acted(2, 5, write(1, 90)))
    after = merge(LAYOUT, entries, 5, before, counted)
    assert after == (store(7, 2, 3, last=90), [5, 4, 5], 0)
    assert before == store(1, 2, 3) and counted == [4, 4, 4], "the store before is left as it was"


def test_a_round_without_writes_leaves_the_store_the_same_object() -> None:
    before, counted = store(1, 2, 3), [4, 4, 4]
    shared, after, unfit = merge(LAYOUT, events(acted(0, 5), silent(1, 5, 5), acted(2, 5)), 5, before, counted)
    assert shared is before and after == [5, 4, 5] and counted == [4, 4, 4] and unfit == 0
    shared, after, _ = merge(LAYOUT, events(*[silent(p, 6, 6) for p in range(3)]), 6, shared, after)
    assert shared is before and after == [5, 4, 5]


def test_a_patch_that_fits_no_value_is_counted_and_ignored() -> None:
    bad = Write(1, msgspec.Raw(b"\x91\x93\x00\x00\x00"), True)
    entries = events(acted(0, 5, bad), acted(1, 5, write(0, 8)))
    assert merge(LAYOUT, entries, 5, store(1, 2, 3), [0] * 3) == (store(1, 8, 3), [5, 5, 0], 1)


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_commits_of_different_locks_makes_no_difference(seed: int) -> None:
    """Locks are there so that no two commits of a round write the same variable."""
    rng = Random(seed)
    entries = events(acted(0, 5, write(0, 1), lock=0), acted(1, 5, write(1, 2), lock=1))
    expected = merge(LAYOUT, entries, 5, store(1, 2, 3), [0] * 3)
    rng.shuffle(entries)
    assert merge(LAYOUT, entries, 5, store(1, 2, 3), [0] * 3) == expected
