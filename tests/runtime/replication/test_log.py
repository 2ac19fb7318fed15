"""Log of one robot: silent rounds joined, entries behind a gap, and the datagrams that entries keep alive."""

from __future__ import annotations

import sys
from random import Random

import msgspec
import pytest

from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.wire import Entry
from koordgen.runtime.replication.log import MOST_SHARING, EntryLog, Logged
from tests.runtime.replication.states import acted, fleet, silent, write


def append(log: EntryLog, entry: Entry) -> None:
    log.append(entry, ())


def entries(log: EntryLog) -> list[Entry]:
    return [logged.entry for logged in log.kept]


def test_adjacent_silent_rounds_share_an_entry_and_entries_behind_a_gap_are_kept() -> None:
    log = EntryLog(0)
    append(log, silent(1, 1, 3))
    append(log, silent(1, 7, 9))
    append(log, silent(1, 7, 8))
    assert log.held == 3 and list(log.later) == [7]
    append(log, silent(1, 3, 6))
    assert log.held == 9 and not log.later and entries(log) == [silent(1, 1, 9)]
    assert log.between(4, 5) == [silent(1, 4, 9)]
    log.truncate(5)
    assert log.held == 5 and entries(log) == [silent(1, 1, 5)]
    log.skip(20)
    assert log.held == 20
    log.drop(20)
    assert entries(log) == []


def test_rounds_with_an_event_have_an_entry_each() -> None:
    log = EntryLog(0)
    for entry in (silent(1, 1, 2), acted(1, 3, write(0, 1)), silent(1, 4, 4), silent(1, 4, 6), acted(1, 7)):
        append(log, entry)
    assert entries(log) == [silent(1, 1, 2), acted(1, 3, write(0, 1)), silent(1, 4, 6), acted(1, 7)]
    assert [log.at(r).entry.first for r in range(1, 8)] == [1, 1, 3, 4, 4, 4, 7]


def test_an_entry_behind_several_gaps_is_reached_once_all_are_closed() -> None:
    log = EntryLog(0)
    for round_ in (6, 4, 2):
        append(log, acted(1, round_))
    for round_, held in ((1, 2), (5, 2), (3, 6)):
        append(log, acted(1, round_))
        assert log.held == held
    assert [e.round for e in entries(log)] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("seed", range(5))
def test_entries_between_two_rounds_are_found_wherever_they_are(seed: int) -> None:
    rng, log, held = Random(seed), EntryLog(0), 0
    while held < 60:
        first, held = held + 1, held + rng.randrange(1, 4)
        append(log, acted(1, first) if first == held else silent(1, first, held))
    for low in range(1, held + 2):
        for high in range(low - 1, held + 2):
            wanted = [e for e in entries(log) if e.round >= low and e.first <= high]
            assert log.between(low, high) == [msgspec.structs.replace(e, first=max(e.first, low)) for e in wanted]


def test_an_entry_in_which_the_author_has_stopped_is_not_joined_with_one_before() -> None:
    log = EntryLog(0)
    append(log, silent(1, 1, 3))
    append(log, silent(1, 4, 6, stopped=True))
    assert [e.round for e in entries(log)] == [3, 6]


def test_entries_of_two_incarnations_are_not_joined() -> None:
    log = EntryLog(0)
    append(log, silent(1, 1, 3))
    append(log, silent(1, 4, 6, incarnation=2))
    assert [e.incarnation for e in entries(log)] == [0, 2]


@pytest.mark.parametrize("count", [1, MOST_SHARING, 10 * MOST_SHARING])
@pytest.mark.parametrize("first", [1, 2], ids=("in order", "behind a gap"))
def test_only_few_entries_keep_the_datagram_in_which_they_arrived(count: int, first: int) -> None:
    """Most entries are dropped soon, so a copy of each would be a waste; entries behind a gap may stay for long."""
    alice = fleet()[0]
    datagrams = [encoder.encode(acted(1, r, write(0, r))) for r in range(first, first + count)]
    for index in range(count):
        alice.append(msgspec.msgpack.decode(datagrams[index], type=Entry), 1000)
    shared = sum(sys.getrefcount(datagrams[index]) > 2 for index in range(count))  # the list, and the argument
    assert shared == (min(count, MOST_SHARING) if first == 1 else 0)


def test_logged_entries_tell_whether_something_happened() -> None:
    assert Logged(acted(1, 1), ()).is_single and Logged(acted(1, 1, lock=0), ()).is_single
    assert not Logged(silent(1, 1, 5, stopped=True), ()).is_single
