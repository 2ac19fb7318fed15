"""The ledger in C against a model of it in plain Python."""

from __future__ import annotations

import ctypes
import re
from array import array
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from random import Random

import msgspec
import pytest

from koordgen.runtime.net import gate, ledger
from koordgen.runtime.net.gate import SOURCE
from koordgen.runtime.net.ledger import (
    APPLIED,
    DEPTH,
    LACKING,
    LAST,
    LEAST,
    LONG_AGO,
    NEXT,
    OPEN,
    REACHED,
    ROW,
    SETTLED,
    TICK,
    TOLD,
    WATCHED,
    Collected,
    Ledger,
)
from koordgen.runtime.net.wire import Closing, Echo, Write, encoder
from tests.runtime.net.compiled.gates import needs_gate
from tests.runtime.net.compiled.ledgers import Said, Table, single, write

pytestmark = needs_gate
N = 4


def said(pid: int, round_: int, *indices: int) -> Said:
    """What `pid` says after a round in which it wrote these variables."""
    return Said.of(single(pid, round_, *(write(index, 100 * round_ + pid) for index in indices)))


def test_a_round_as_nearly_all_are() -> None:
    table = Table(N, 1)
    table.number({TICK: 7})
    last = DEPTH + 31
    for round_ in range(1, last + 1):
        table.number({APPLIED: round_ - 1, LACKING: N, SETTLED: round_ - 1, LAST: round_ + 8})
        assert table.close(round_, write(0, "ours"), prompt=True)
        assert table.hear(*[said(pid, round_, 0, pid + 3) for pid in (0, 2, 3)]) == [True] * 3
        assert table.ledger.number[LACKING] == 0
        found = table.collect(round_)
        assert found is not None and (found.acted, found.prompt) == ([0, 1, 2, 3], (1,))
        assert [(index, pids) for index, pids, _ in found.writes] == [(0, [0, 1, 2, 3]), (3, [0]), (5, [2]), (6, [3])]
        assert bytes(found.writes[0][2]) == encoder.encode([100 * round_, "ours", 100 * round_ + 2, 100 * round_ + 3])
        assert (table.ledger.number[NEXT], table.ledger.number[LEAST]) == (N, round_)
    assert list(table.ledger.held) == [last] * N and list(table.ledger.heard) == [7, LONG_AGO, 7, 7]
    assert table.collect(last - DEPTH + 1) is not None
    assert table.collect(last - DEPTH) is None, "others have taken their places"
    assert [len(table.rows(pid)) for pid in range(N)] == [DEPTH] * N
    assert list(table.ledger.floor) == [last] * N and table.rows(2) == [] and table.collect(last) is None


def test_a_word_that_the_clock_learns_from_is_noted_like_any_other() -> None:
    echoing = [said(pid, 1)._replace(echoes=(Echo(other, 5, 6),)) for pid, other in ((1, 0), (2, 3))]
    assert Table(N).hear(*echoing) == [True, True]


def test_what_is_settled_is_told_on() -> None:
    table = Table(N)
    assert table.hear(said(1, 1)._replace(settled=3), said(2, 1)._replace(settled=2)) == [True] * 2
    assert table.ledger.number[TOLD] == 3


def test_detached_it_notes_nothing_and_keeps_what_it_has() -> None:
    table = Table(N)
    assert table.hear(said(1, 1, 5)) == [True]
    table.gate.attach(None)
    judged = table.gate.take([table.datagram(said(1, 2))], 1.0, None)
    assert judged.usual is not None and len(judged.usual[0].closings) == 1
    assert len(table.rows(1)) == 1 and table.close(1)


def own(round_: int) -> bytes:
    """Robot 0's closing."""
    return encoder.encode(Closing(0, 0, round_, round_, False, True))


def test_only_whole_rows_of_ones_own_are_kept() -> None:
    table = Table(N)
    row = own(1)
    another = encoder.encode(Closing(1, 0, 1, 1, False, True))
    for wrong in (another, row + b"\xc0", row[:-1], b""):
        assert not table.ledger.close(wrong)
        assert table.ledger.peek(0, 0) == [] and table.ledger.peek(1, 0) == []
    assert table.ledger.close(row) and table.ledger.peek(0, 0) == [row]


def test_without_a_library_nothing_is_kept() -> None:
    plain = Ledger(0, N)
    plain.number[OPEN], plain.incarnation[0] = 1, 0
    assert (plain.native, plain.at, plain.own(0)) == (False, 0, False)
    assert not plain.close(own(1)) and plain.collect(1) is None and plain.rows(0) == []


def test_both_number_alike() -> None:
    text = Path(SOURCE).with_name("ledger.h").read_text()
    found = re.search(r"enum \{ (OPEN[A-Z, ]*) \}", text)
    assert found is not None
    names = found[1].split(", ")
    assert [getattr(ledger, name) for name in names] == list(range(ledger.NUMBERS))


def test_nothing_written_by_nobody() -> None:
    table = Table(1)
    assert table.close(1, acted=False) and table.collect(1) == Collected([], (), [])
    assert table.ledger.number[LEAST] == 1


def crafted(pid: bytes = b"\x01", incarnation: bytes = b"\x00", first: bytes = b"\x05", round_: bytes = b"\x05",
            flags: bytes = b"\xc2\xc3\xc2", lock: bytes = b"\xff", writes: bytes = b"\x90") -> Said:  # fmt: skip
    """Of robot 1, who holds up to 4, in its parts."""
    closing = b"\x91\x99" + pid + incarnation + first + round_ + flags + lock + writes
    return Said(1, 6, 5, 0, closing)


def raw(*writes: bytes) -> bytes:
    return bytes([0x90 + len(writes)]) + b"".join(writes)


def closings(*words: Said) -> Said:
    """All their closings in one."""
    return words[0]._replace(closings=bytes([0x90 + len(words)]) + b"".join(word.closings[1:] for word in words))


QUIET = b"\xc2\xc2\xc2"


def silence(first: int, last: int, flags: bytes = QUIET) -> Said:
    return crafted(first=encoder.encode(first), round_=encoder.encode(last), flags=flags)


ONE = b"\x93\x05\x07\xc2"
CRAFTED = {
    "as it should be": (True, crafted(writes=raw(ONE))),
    "an index twice, which is no news to the ledger": (True, crafted(writes=raw(ONE, ONE))),
    "numbers that are longer than need be": (True, crafted(b"\xcc\x01", b"\xd3" + bytes(8), first=b"\xcd\x00\x05")),
    "another author": (True, crafted(b"\x02")),
    "an author whose next is another": (False, crafted(b"\x03", first=b"\x06", round_=b"\x06")),
    "our own": (False, crafted(b"\x00")),
    "our own that is known": (True, crafted(b"\x00", first=b"\x04", round_=b"\x04")),
    "an author that there is not": (False, crafted(b"\x04")),
    "an author that there is not, long ago": (False, crafted(b"\x04", first=b"\x04", round_=b"\x04")),
    "no robot": (False, crafted(b"\xcc\x80")),
    "an author that is negative": (False, crafted(b"\xff")),
    "another incarnation": (False, crafted(incarnation=b"\x01")),
    "an incarnation that is none": (False, crafted(incarnation=b"\xff")),
    "of more rounds": (False, crafted(first=b"\x04")),
    "of rounds that end before they begin": (False, crafted(first=b"\x06")),
    "first is nil": (False, crafted(first=b"\xc0")),
    "the round after the next": (False, crafted(first=b"\x06", round_=b"\x06")),
    "a known round": (True, crafted(first=b"\x04", round_=b"\x04")),
    "known rounds": (True, crafted(first=b"\x02", round_=b"\x04", flags=b"\xc3\xc3\xc2", incarnation=b"\x09")),
    "a known round of another": (True, crafted(b"\x02", first=b"\x04", round_=b"\x04")),
    "a negative round": (False, crafted(round_=b"\xff")),
    "stopped": (False, crafted(flags=b"\xc3\xc3\xc2")),
    "stopped is a number": (False, crafted(flags=b"\x00\xc3\xc2")),
    "acted is nil": (False, crafted(flags=b"\xc2\xc0\xc2")),
    "prompt is c1": (False, crafted(flags=b"\xc2\xc2\xc4\x00")),
    "it did not act, and waits": (True, crafted(flags=b"\xc2\xc2\xc3")),
    "a lock": (True, crafted(lock=b"\xcd\xff\xff")),
    "no lock that there can be": (False, crafted(lock=b"\xce\x00\x01\x00\x00")),
    "less than no lock": (False, crafted(lock=b"\xfe")),
    "many writes": (True, crafted(writes=b"\xdc\x00\xc8" + 200 * ONE)),
    "as many writes as there may be": (True, crafted(writes=b"\xdc\x01\x00" + 256 * ONE)),
    "too many writes": (False, crafted(writes=b"\xdc\x01\x01" + 257 * ONE)),
    "writes with a longer head": (False, crafted(writes=b"\xdd\x00\x00\x00\x01" + ONE)),
    "writes are none": (False, crafted(writes=b"\xc0")),
    "writes are a map": (False, crafted(writes=b"\x81\x00\x00")),
    "a write is a number": (False, crafted(writes=raw(b"\x05"))),
    "a write without a patch": (False, crafted(writes=raw(b"\x92\x05\x07"))),
    "a write with more": (False, crafted(writes=raw(b"\x94\x05\x07\xc2\xc0"))),
    "the last index": (True, crafted(writes=raw(b"\x93\xcd\xff\xff\x07\xc2"))),
    "an index beyond": (False, crafted(writes=raw(b"\x93\xce\x00\x01\x00\x00\x07\xc2"))),
    "a negative index": (False, crafted(writes=raw(b"\x93\xff\x07\xc2"))),
    "a patch": (True, crafted(writes=raw(b"\x93\x05\x07\xc3"))),
    "a patch that is a number": (False, crafted(writes=raw(b"\x93\x05\x07\x00"))),
    "the second write is malformed": (False, crafted(writes=raw(ONE, b"\x93\x05\x07\xc0"))),
    "held in a longer encoding": (True, crafted()._replace(held=b"\xdc\x00\x00")),
    "it holds up to somewhere": (False, crafted()._replace(held=b"\x91\x05")),
    "two closings, of which one is known then": (True, closings(crafted(), crafted())),
    "closings in a longer encoding": (True, crafted()._replace(closings=b"\xdc\x00\x01" + crafted().closings[1:])),
    "of two, the one after the next": (True, closings(crafted(), crafted(first=b"\x06", round_=b"\x06"))),
    "of three authors": (True, closings(crafted(b"\x03"), crafted(), crafted(b"\x02"))),
    "the second is too early": (False, closings(crafted(b"\x03"), crafted(first=b"\x06", round_=b"\x06"))),
    "the second is malformed": (False, closings(crafted(b"\x03"), crafted(round_=b"\xff"))),
    "the silence of three rounds": (True, silence(5, 7)),
    "silence that began before": (True, silence(2, 7)),
    "silence that began before the first round": (False, silence(0, 7)),
    "silence that begins too late": (False, silence(6, 7)),
    "silence in its end": (False, silence(5, 7, b"\xc3\xc2\xc2")),
    "silence that waits": (False, silence(5, 7, b"\xc2\xc2\xc3")),
    "several rounds in which it acted": (False, silence(5, 7, b"\xc2\xc3\xc2")),
    "several rounds with a lock": (False, crafted(round_=b"\x07", flags=QUIET, lock=b"\x00")),
    "several rounds in which it wrote": (False, crafted(round_=b"\x07", flags=QUIET, writes=raw(ONE))),
    "silence as long as there is room": (True, silence(5, 4 + DEPTH)._replace(round=2)),
    "silence for which there is no room": (False, silence(5, 5 + DEPTH)._replace(round=2)),
    "no closing": (True, crafted()._replace(closings=b"\x90")),
    "it lacks something": (True, crafted()._replace(round=7)),
    "it has applied more than it may have": (False, crafted()._replace(applied=21)),
    "it has applied as much as it may have": (True, crafted()._replace(applied=20)),
    "more is settled than may be": (False, crafted()._replace(settled=21)),
    "as much is settled as may be": (True, crafted()._replace(settled=20)),
    "it holds more than may be": (False, crafted()._replace(held=b"\x94\x01\x01\x01\x15")),
    "it holds as much as may be": (True, crafted()._replace(held=b"\x94\x01\x01\x01\x14")),
    "it holds less than nothing": (False, crafted()._replace(held=b"\x94\x01\x01\x01\xff")),
    "what it holds goes on": (False, crafted()._replace(held=b"\x95\x01\x01\x01\x01\x01")),
    "what it holds is no array": (False, crafted()._replace(held=b"\xc4\x00")),
    "it is in a round that it may not be in": (False, crafted()._replace(round=22)),
    "it is in a round that it may be in": (True, crafted()._replace(round=21)),
    "it has applied less than before": (True, crafted()._replace(round=2, applied=2)),
    "it has applied as much as before": (True, crafted()._replace(round=2, applied=3)),
    "in no round": (True, crafted()._replace(round=0, applied=3)),
}  # fmt: skip


@pytest.mark.parametrize("name", CRAFTED)
def test_what_is_noted_and_what_is_not(name: str) -> None:
    expected, word = CRAFTED[name]
    table = held_by_all(4)
    table.put("applied", 1, 3)
    if "room" in name:
        table.number({LAST: 99})
    assert table.hear(word) == [expected]


def held_by_all(round_: int, n_sys: int = N, pid: int = 0) -> Table:
    table = Table(n_sys, pid)
    for column in ("held", "floor"):
        table.set(column, *[round_] * n_sys)
    table.number({APPLIED: round_, SETTLED: round_, LAST: round_ + 16})
    return table


COLUMNS = {
    "it may note": (True, "gap", 2, 1),
    "a gap": (False, "gap", 1, 1),
    "it wants something": (True, "wanting", 1, 1),
    "it does not count": (False, "incarnation", 1, -1),
    "it counts anew": (False, "incarnation", 1, 3),
    "it goes by another view": (True, "view", 1, 3),
    "not heard in this view": (True, "view", 1, -1),
    "all is as late as it may be": (True, "number", LAST, 5),
    "too early": (False, "number", LAST, 4),
    "closed": (False, "number", OPEN, 0),
}


@pytest.mark.parametrize("name", COLUMNS)
def test_where_it_is_noted_and_where_it_is_not(name: str) -> None:
    expected, column, index, value = COLUMNS[name]
    table = held_by_all(4)
    if column == "wanting":
        table.want(index, bool(value))
    else:
        table.put(column, index, value)
    assert table.hear(crafted()) == [expected]


@pytest.mark.parametrize("settled", [0, 1, 4])
@pytest.mark.parametrize("applied", [0, 1, 4])
@pytest.mark.parametrize("floor", [0, 2])
def test_no_row_is_lost_before_it_is_applied_and_everyones(settled: int, applied: int, floor: int) -> None:
    """Of others and of ours."""
    table = Table(N)
    table.number({SETTLED: settled, APPLIED: applied, LAST: DEPTH + 20})
    table.set("floor", *[floor] * N)
    table.set("held", *[floor] * N)
    kept = []
    for round_ in range(floor + 1, DEPTH + 12):
        kept += table.hear(said(1, round_, 1)._replace(applied=round_))
        assert table.close(round_) == kept[-1]
    assert sum(kept) == DEPTH + max(floor, min(settled, applied)) - floor


def test_a_watched_round_is_reached_once_by_each() -> None:
    table = Table(N)
    table.number({WATCHED: 5})
    for applied, reached in ((4, 0), (5, 1), (5, 1), (6, 1)):
        table.hear(Said(1, applied, applied))
        assert table.ledger.number[REACHED] == reached
    table.hear(Said(2, 9, 9), Said(3, 3, 3))
    assert table.ledger.number[REACHED] == 2


def test_what_is_missing_is_lost_if_more_came_of_it_or_another_has_applied_it() -> None:
    noted = Ledger(0, 4, applied=5)
    noted.applied[1:] = array("q", [5, 5, 5])
    assert not noted.lost([1, 2, 3]) and not noted.lost([])
    noted.gap[2] = True
    assert noted.lost([1, 2]) and not noted.lost([1, 3])
    noted.gap[2], noted.applied[3], noted.held[1] = False, 6, 6
    assert noted.lost([2]) and not noted.lost([1])


EDGES = [0, 1, 127, 128, 255, 256, 2**16 - 1, 2**16, 2**32 - 1, 2**32, 2**53 - 1, 2**53]


@pytest.mark.parametrize("pid", [0, 1, 127])
def test_own_rows_with_numbers_of_any_length(pid: int) -> None:
    chance = Random(pid)
    table = Table(128, pid)
    for round_, incarnation, lock in product(EDGES[1:], EDGES, [-1, 0, 127, 128, 255, 256, 65535]):
        for each in table.both():
            each.held[pid] = each.floor[pid] = round_ - 1
            each.incarnation[pid] = incarnation
        writes = tuple([write(index, "x" * index) for index in range(chance.choice((0, 1, 15, 16)))])
        acted, prompt = chance.random() < 0.5, chance.random() < 0.5
        closing = encoder.encode(Closing(pid, incarnation, round_, round_, False, acted, prompt, lock, writes))
        assert table.ledger.close(closing) and table.ledger.rows(pid) == [closing]


def blob(size: int) -> Write:
    """Whose value's encoding has so many bytes."""
    return Write(1, msgspec.Raw(b"\xc5" + (size - 3).to_bytes(2, "big") + bytes(size - 3)))


def test_the_longest_row() -> None:
    for size, fits in ((ROW - 13, True), (ROW - 12, False), (ROW - 1, False), (ROW, False), (65000, False)):
        table = Table(N)
        assert table.close(1, blob(size)) == fits
        assert [*map(len, table.rows(0))] == [ROW] * fits


@pytest.mark.parametrize("what", ["gap", "incarnation", "open", "late", "early"])
def test_what_is_not_closed_here(what: str) -> None:
    table = held_by_all(4)
    if what == "open":
        table.number({OPEN: 0})
    elif what in ("gap", "incarnation"):
        table.put(what, 0, 1 if what == "gap" else -1)
    assert not table.close({"late": 4, "early": 6}.get(what, 5)) and table.rows(0) == []


def fill(table: Table, round_: int, rows: Sequence[bytes]) -> None:
    """What was never heard, straight into the rows."""
    for pid, row in enumerate(rows):
        assert len(row) <= ROW
        slot = round_ % DEPTH * table.n + pid
        table.ledger._rows[slot * ROW : slot * ROW + len(row)] = row
        table.ledger._length[slot] = len(row)
        table.model.kept[pid, round_ % DEPTH] = round_, row
    table.set("held", *[round_] * table.n)


def crowded(pid: int, begin: int, step: int, last: bytes = b"") -> bytes:
    """A row with as many writes of one byte as there is room for."""
    head = encoder.encode(Closing(pid, 0, 3, 3, False, True, True))[:-1]
    writes = list[bytes]()
    while sum([len(each) for each in writes]) + 11 < ROW - len(head) - 3 - len(last) and len(writes) < 250:
        writes.append(encoder.encode(write(begin + step * len(writes), 7)))
    writes += [last] if last else []
    return head + b"\xdc" + len(writes).to_bytes(2, "big") + b"".join(writes)


PATCH = encoder.encode(write(65535, 1, True))


@pytest.mark.parametrize("n_sys", [1, 2, 15, 16, 17, 128])
@pytest.mark.parametrize("together", [1, 2, 15, 16, 17, 128])
@pytest.mark.parametrize("last", [b"", PATCH])
def test_nothing_is_written_beyond_its_room(n_sys: int, together: int, last: bytes) -> None:
    """Also where the last write of each row is a patch, for which all was for nothing. So many write the same."""
    table = held_by_all(2, n_sys)
    found = gate.COMPILED.library()
    assert found is not None
    fill(table, 3, [crowded(pid, pid // together, -(-n_sys // together), last) for pid in range(n_sys)])
    room = found.ledger_room(n_sys)
    out = ctypes.create_string_buffer(b"\xc1" * (2 * room), 2 * room)
    size = found.ledger_collect(table.ledger.at, 3, out)
    written = out.raw.rstrip(b"\xc1")
    assert (size == 0) == (last != b"") and len(written) <= room
    assert last or len(written) == size
    assert (table.collect(3) is None) == (last != b"")


def test_what_nests_too_deeply_for_msgspec_is_left_to_others() -> None:
    nested = b"\x91" * 1040 + b"\x00"  # about as deep as a datagram can nest
    try:
        msgspec.msgpack.decode(nested)
        pytest.skip("this Python lets msgspec nest deeper than a datagram can")
    except RecursionError:
        pass
    table = held_by_all(2, 2)
    deep = crafted(first=b"\x03", round_=b"\x03", writes=raw(b"\x93\x00" + nested + b"\xc2"))
    assert table.ledger.collect(3) is None
    judged = table.gate.take([table.datagram(deep)], 1.0, None)
    assert list(judged.usual or ()) == [] and table.ledger.held[1] == 3
    assert table.ledger.close(own(3))
    assert table.ledger.collect(3) is None and table.ledger.rows(1) == [deep.closings[1:]]
