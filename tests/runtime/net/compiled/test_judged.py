"""While the courier waits, the gate judges what comes: what the ledger can note wakes nobody, until all is there that a
round waits for; all else wakes Python, which finds it as if nobody had looked."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from random import Random
from typing import Any

import pytest

from koordgen.runtime.net.courier import MOST_AT_ONCE, CompiledInbox
from koordgen.runtime.net.gate import NOTED, OTHER, USUAL, Judged
from koordgen.runtime.net.ledger import APPLIED, LACKING, LAST, OPEN, REACHED, SETTLED, WATCHED
from koordgen.runtime.net.wire import Echo, encoder
from tests.runtime.net.compiled.gates import needs_gate
from tests.runtime.net.compiled.ledgers import Said, Table
from tests.runtime.net.compiled.test_courier import inbox
from tests.runtime.net.compiled.test_ledger import said
from tests.runtime.net.transports import PATIENCE, needs_courier

pytestmark = [needs_gate, needs_courier]
N = 5
SHORT = 0.05  # seconds: a wait that runs out
LESSON = (Echo(0, 5, 6),)  # of ours


class Waiting(Table):
    """A table whose gate judges what an inbox receives."""

    def __init__(self, made: CompiledInbox, source: Any) -> None:
        super().__init__(N)
        self.inbox, self._source = made, source
        self.gate.couple(made, True)

    def send(self, *words: Said, noted: bool = True) -> None:
        """Each arrives; the model notes it."""
        for word in words:
            assert self.model.note(word, self.view) == noted
            self._source.send(self.datagram(word))

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> bool:
        """Whether it ended before its time; all is noted as the model says."""
        end = time.monotonic() + seconds
        self.inbox.wait(seconds, expected, gather)
        early = time.monotonic() < end
        self.same()
        return early

    def take(self) -> Judged:
        return self.gate.take(self.inbox.receive(), 1.0, None)

    def later(self, *words: Said, after: float = SHORT) -> threading.Timer:
        for word in words:
            assert self.model.note(word, self.view)
        datagrams = [self.datagram(word) for word in words]
        timer = threading.Timer(after, lambda: [self._source.send(each) for each in datagrams])
        timer.start()
        return timer


@contextmanager
def waiting() -> Iterator[Waiting]:
    with inbox(True) as (made, _, sending, _):
        assert isinstance(made, CompiledInbox)
        yield Waiting(made, sending[0])


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("expected", [1, 2, N - 1])
def test_it_waits_until_all_others_have_closed_the_round(own: bool, expected: int) -> None:
    """Whether or not one's own closing is there already, and however many it was told to expect."""
    with waiting() as table:
        assert not own or table.close(1)
        table.send(said(1, 1), said(2, 1, 3))
        assert not table.wait(SHORT, expected, SHORT / 5), "two are missing"
        assert table.ledger.number[LACKING] == N - 2 - own and not table.inbox.receive()
        table.send(said(3, 1))
        timer = table.later(said(4, 1))
        assert table.wait(PATIENCE, expected, SHORT / 5), "all are there"
        timer.join()
        assert table.ledger.number[LACKING] == 1 - own
        assert table.take() == ([], ()) and not table.inbox.receive()
        table.send(said(1, 2))
        assert table.wait(PATIENCE), "there is nothing to wait for, so whatever comes ends it"


def test_what_is_unusual_wakes_and_is_found_with_what_came_along() -> None:
    """In its order; what was noted is not handed on, and nothing is noted or counted twice."""
    with waiting() as table:
        table.send(said(1, 1))
        assert not table.wait(SHORT)
        table.send(said(2, 1))
        table._source.send(b"not authentic")
        table.send(said(3, 2), noted=False)
        assert table.wait(PATIENCE)
        for _ in range(2):
            assert table.wait(PATIENCE), "and wakes until it is taken"
        table.send(said(4, 1)._replace(echoes=LESSON))
        table.inbox.wait(PATIENCE)
        assert table.inbox.shown.judged == 3, "the rest is judged when it is taken"
        usual, verdicts = table.take()
        assert usual is not None and list(verdicts) == [NOTED, 2, USUAL, NOTED]
        assert [(row.sender, len(row.closings)) for row in usual] == [(3, 1)]
        assert [(each.pid, each.sent, each.received) for each in table.gate.lessons()] == [(4, 5, 6)]
        table.same()
        assert table.take() == ([], ())
        columns: Any = table.gate._columns
        assert list(columns["received"]) == [0, 1, 1, 1, 1] and not table.wait(SHORT)


def test_what_the_clock_learns_from_waits_until_somebody_asks() -> None:
    """With the time at which it was here, and one of a robot until it is asked for and due again."""
    with waiting() as table:
        before = time.monotonic() * 1e6
        table.send(said(1, 1)._replace(echoes=LESSON), said(2, 1)._replace(echoes=LESSON))
        assert not table.wait(SHORT)
        after = time.monotonic() * 1e6 - SHORT * 1e6 / 2
        table.send(said(1, 2)._replace(echoes=LESSON))
        assert not table.wait(SHORT) and table.take() == ([], ())
        lessons = table.gate.lessons()
        assert [tuple(each)[:-1] for each in lessons] == [(1, 5, 5, 6, 0, 0), (2, 5, 5, 6, 0, 0)]
        assert all(before - 1 <= each.arrived <= after for each in lessons) and table.gate.lessons() == []
        table.due[1] = time.monotonic() + 60.0
        table.due[2] = time.monotonic()
        table.send(said(1, 3)._replace(echoes=LESSON), said(2, 2)._replace(echoes=LESSON))
        assert not table.wait(SHORT) and [each.pid for each in table.gate.lessons()] == [2]


def test_a_majority_that_has_applied_a_watched_round_wakes() -> None:
    with waiting() as table:
        assert table.close(1)
        table.number({WATCHED: 1, APPLIED: 1, SETTLED: 1, LACKING: N, REACHED: 0})
        for pid in (1, 2, 3):
            table.set("held", *[1] * N)
            table.send(said(pid, 2)._replace(applied=1))
            assert table.wait(PATIENCE if pid == 2 else SHORT) == (pid == 2), "once"


def test_what_came_before_another_view_is_taken_one_by_one() -> None:
    """As each says by which view it is."""
    for late in (True, False):
        with waiting() as table:
            table.number({OPEN: 0})
            table.send(said(1, 1), said(2, 1), noted=False)
            assert table.wait(PATIENCE)
            assert not late or table.wait(PATIENCE)
            table.follow(3)
            usual, verdicts = table.take()
            assert usual is None and list(verdicts) == [USUAL, USUAL]
            table.send(said(1, 2), noted=False)
            assert table.wait(PATIENCE)
            usual, verdicts = table.take()
            assert usual is not None and len(usual) == 1 and not verdicts


def test_what_comes_after_another_view_and_before_it_is_taken() -> None:
    """The rest is judged when it is taken, and each is looked at."""
    with waiting() as table:
        table.number({OPEN: 0})
        table.send(said(1, 1), noted=False)
        assert table.wait(PATIENCE)
        table.follow(3)
        table.send(said(2, 1), noted=False)
        assert table.wait(PATIENCE)
        usual, verdicts = table.take()
        assert usual is None and list(verdicts) == [USUAL, USUAL]


def test_without_a_ledger_nothing_is_judged_before_it_is_taken() -> None:
    with waiting() as table:
        datagram = table.datagram(said(1, 1))
        table.gate.attach(None)
        table._source.send(datagram)
        assert table.wait(PATIENCE) and table.inbox.shown.judged == 0
        usual, verdicts = table.take()
        assert usual is not None and len(usual) == 1 and not verdicts


def test_what_was_drained_unseen_is_forgotten() -> None:
    """As by an agent that is broken."""
    with waiting() as table:
        table._source.send(b"x")
        assert table.wait(PATIENCE)
        assert len(table.inbox.receive()) == 1
        table.send(said(1, 1))
        assert not table.wait(SHORT) and table.take() == ([], ())
        table._source.send(b"x")
        assert table.wait(PATIENCE) and list(table.take().verdicts) == [2]


def test_another_gate_judges_anew() -> None:
    with waiting() as table:
        table.send(said(1, 3), noted=False)
        assert table.wait(PATIENCE)
        found = table.inbox.receive()
        other = Table(N)
        usual, verdicts = other.gate.take(found, 1.0, None)
        assert usual is not None and len(usual) == 1 and not verdicts and usual[0].round == 4


def test_more_than_there_is_room_for() -> None:
    """What is noted makes room for more; what is not is taken in turns."""
    with waiting() as table:
        table.number({LAST: 2000})
        end = [table.datagram(said(1, 1)) for _ in range(MOST_AT_ONCE + 200)]
        assert table.model.note(said(1, 1), 0)
        for datagram in end:
            table._source.send(datagram)
        early = table.wait(SHORT)
        received, expected = table.gate._columns["received"], sum(1 for _ in end)
        while early:
            table.take()
            early = table.wait(SHORT)
        assert table.ledger.held[1] == 1 and received[1] == 1 and expected > MOST_AT_ONCE
        junk = [b"%d" % each for each in range(MOST_AT_ONCE + 50)]
        for each in junk:
            table._source.send(each)
        taken = 0
        while table.wait(SHORT):
            taken += len(table.take().verdicts)
        assert taken == len(junk)


def test_any_course_comes_to_the_same() -> None:
    """Words that are noted, that are not, and junk, taken now and then: as the model of the ledger says, and each
    exactly once."""
    for seed in range(20):
        chance, sent, seen = Random(seed), 0, 0
        with waiting() as table:
            for _ in range(60):
                word = said(chance.randrange(1, N), chance.randrange(1, 6))
                if chance.random() < 0.2:
                    table._source.send(b"junk")
                    sent += 1
                else:
                    noted = table.model.note(word, 0)
                    sent += not noted
                    table._source.send(table.datagram(word))
                if chance.random() < 0.3:
                    table.inbox.wait(0.0, chance.randrange(1, N), 0.001)
                if chance.random() < 0.3:
                    seen += _told(table.take())
            while table.inbox.receive():
                seen += _told(table.gate.take(table.inbox.slots, 1.0, None))
            table.same()
        assert seen == sent and sent > 10


def _told(judged: Judged) -> int:
    """How many were handed on, or told of."""
    assert judged.usual is not None
    return len(judged.usual) + sum(verdict not in (USUAL, NOTED) for verdict in judged.verdicts)


def test_of_one_of_a_kind() -> None:
    """A word that nobody can read wakes as all that is not usual."""
    with waiting() as table:
        word = said(1, 1)._replace(closings=encoder.encode(5) * 2)
        table._source.send(table.datagram(word))
        assert table.wait(PATIENCE) and list(table.take().verdicts) == [OTHER]
