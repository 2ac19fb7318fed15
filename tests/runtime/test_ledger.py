"""The ledger in C against a model of it in plain Python."""

from __future__ import annotations

import re
from pathlib import Path

from koordgen.runtime import ledger
from koordgen.runtime.gate import SOURCE
from koordgen.runtime.ledger import APPLIED, DEPTH, LACKING, LEAST, LONG_AGO, NEXT, TICK, TOLD, Collected, Ledger
from koordgen.runtime.wire import Echo, encoder
from tests.runtime.gates import needs_gate
from tests.runtime.ledgers import Said, Table, single, write

pytestmark = needs_gate
N = 4


def said(pid: int, round_: int, *indices: int) -> Said:
    """What `pid` says after a round in which it wrote these variables."""
    return Said.of(single(pid, round_, *(write(index, 100 * round_ + pid) for index in indices)))


def test_a_round_as_nearly_all_are() -> None:
    table = Table(N, 1)
    table.number({TICK: 7})
    for round_ in range(1, 40):
        table.number({APPLIED: round_ - 1, LACKING: N, ledger.SETTLED: round_ - 1, ledger.LAST: round_ + 8})
        assert table.close(round_, write(0, "ours"), prompt=True)
        assert table.hear(*[said(pid, round_, 0, pid + 3) for pid in (0, 2, 3)]) == [True] * 3
        assert table.ledger.number[LACKING] == 0
        found = table.collect(round_)
        assert found is not None and (found.acted, found.prompt) == ([0, 1, 2, 3], [1])
        assert [(index, pids) for index, pids, _ in found.writes] == [(0, [0, 1, 2, 3]), (3, [0]), (5, [2]), (6, [3])]
        assert bytes(found.writes[0][2]) == encoder.encode([100 * round_, "ours", 100 * round_ + 2, 100 * round_ + 3])
        assert (table.ledger.number[NEXT], table.ledger.number[LEAST]) == (N, round_)
    assert list(table.ledger.held) == [39] * N and list(table.ledger.heard) == [7, LONG_AGO, 7, 7]
    assert [len(table.rows(pid)) for pid in range(N)] == [DEPTH] * N
    assert list(table.ledger.floor) == [39] * N and table.rows(2) == [] and table.collect(39) is None


def test_what_the_clock_learns_from_is_told_as_a_word_without_news() -> None:
    table = Table(N)
    assert (
        table.hear(said(1, 1)._replace(echoes=(Echo(0, 5, 6),)), said(2, 1)._replace(echoes=(Echo(3, 5, 6),)))
        == [True] * 2
    )


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


def test_without_a_library_nothing_is_kept() -> None:
    plain = Ledger(0, N)
    plain.number[ledger.OPEN], plain.incarnation[0] = 1, 0
    assert (plain.native, plain.at, plain.own(0)) == (False, 0, False)
    assert not plain.close(1, True, False, -1, b"\x90") and plain.collect(1) is None and plain.rows(0) == []


def test_both_number_alike() -> None:
    text = Path(SOURCE).with_name("ledger.h").read_text()
    found = re.search(r"enum \{ (OPEN[A-Z, ]*) \}", text)
    assert found is not None
    names = found[1].split(", ")
    assert [getattr(ledger, name) for name in names] == list(range(ledger.NUMBERS))


def test_nothing_written_by_nobody() -> None:
    table = Table(1)
    assert table.close(1, acted=False) and table.collect(1) == Collected([], [], [])
    assert table.ledger.number[LEAST] == 1
