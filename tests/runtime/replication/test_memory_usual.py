"""Many usual datagrams at once do to the memory what each of them does alone."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.gate import Usual
from koordgen.runtime.net.wire import Closing, View, encoder
from koordgen.runtime.replication.log import Log
from koordgen.runtime.replication.memory import AHEAD, RECENT, WINDOW, Memory
from tests.runtime.replication.memories import fleet, one, silence, view, write

N, OWN = 4, 0


def row(sender: int, round_: int, applied: int, *closings: Closing, settled: int = 0,
        held: Sequence[int] = ()) -> Usual:  # fmt: skip
    return Usual(sender, round_, applied, settled, tuple(held), closings)


def one_by_one(memory: Memory, rows: Sequence[Usual], number: int, present: int) -> list[str]:
    """As Replica does with a Round."""
    refused: list[str | None] = []
    for each in rows:
        refused += [memory.take(closing, present) for closing in each.closings]
        through = each.round - 1 if each.round else 0
        said = each.applied, each.held, through, each.settled
        refused.append(memory.heard(each.sender, number, *said, present, asks=False))
    return [why for why in refused if why is not None]


def told(log: Log) -> Any:
    kept = [*log.entries, *[log.later[first] for first in sorted(log.later)]]
    return log.held, len(log.entries), [(encoder.encode(e.closing), str(e.values)) for e in kept]


def everything(memory: Memory) -> Any:
    words = str(vars(memory._words))
    state = memory.settled(), memory._forgotten, memory.applied, memory.shared, memory.stopped, memory.acted, memory.won
    asked = memory.lacking(), memory.unfit
    return [told(log) for log in memory._logs], words, state, asked, memory.view, memory.frozen


class Course:
    """Two equal memories; one hears many at once, the other each alone."""

    def __init__(self, seed: int) -> None:
        self.chance = Random(seed)
        self.many, self.each = fleet(N)[OWN], fleet(N)[OWN]
        self.present = 2
        self.quick = self.refused = 0

    def both(self) -> tuple[Memory, Memory]:
        return self.many, self.each

    def move(self) -> None:
        """Something other than hearing."""
        chance, number, members = self.chance, self.many.view.number, list(self.many.view.members)
        kind = chance.randrange(12)
        if kind == 0 and self.many.applied >= self.many.view.since:
            pid = chance.randrange(1, N)
            members[pid] = number + 1 if members[pid] < 0 or chance.random() < 0.3 else -1
            following = View(number + 1, self.many.applied + 1 + chance.randrange(3), tuple(members))
            for memory in self.both():
                memory.adopt(following)
        elif kind == 1:
            for memory in self.both():
                memory.frozen = not memory.frozen
        elif kind == 2:
            watched = max(0, self.many.applied - chance.randrange(2))
            assert self.many.stable(watched) == self.each.stable(watched)
        elif kind == 3:
            pid, helps = chance.randrange(1, N), chance.random() < 0.5
            assert self.many.repeat(pid, helps) == self.each.repeat(pid, helps)
        elif kind < 9:
            self.present += chance.random() < 0.7
            writes = {"last": self.present} if chance.random() < 0.5 else {}
            for memory in self.both():
                if memory._logs[OWN].held < self.present - 1 and not memory.crowded():
                    memory.close(self.present - 1, writes, stopped=False, acted=bool(writes))
                memory.advance(self.present)

    def near(self, low: int, high: int) -> int:
        return self.present + self.chance.randrange(low, high)

    def closings(self, sender: int, round_: int) -> list[Closing]:
        """Mostly the sender's of that round; some that it repeats of others, or of more rounds; or none."""
        chance = self.chance
        found = [self.closing(sender, round_)] if chance.random() < 0.8 else []
        while chance.random() < 0.25:
            author = chance.randrange(N + 1)
            next_ = self.many._logs[author].held + 1 if author < N else round_
            found.append(self.closing(author, max(0, chance.choice((next_, next_, next_ + 1, round_)))))
        return found

    def closing(self, author: int, round_: int) -> Closing:
        """What is in it may be anything."""
        chance, incarnation = self.chance, self.many.view.members[author] if author < N else 0
        incarnation = max(0, incarnation + chance.choice((-1, 0, 0, 0, 0, 0, 0, 1)))
        if chance.random() < 0.3:
            first = round_ if chance.random() < 0.7 else max(0, round_ - chance.randrange(3))
            return silence(author, first, round_, incarnation, stopped=chance.random() < 0.05)
        some = [write(index, round_ * 10 + author) for index in range(2) if chance.random() < 0.6]
        if chance.random() < 0.1:
            some = [chance.choice((write(2, 3), write(0, "text"), write(1, 2**63)))]
        return one(author, round_, *some, incarnation=incarnation, lock=chance.choice((-1, -1, 0)))

    def row(self) -> Usual:
        chance = self.chance
        sender = chance.randrange(1, N)
        next_ = self.many._logs[sender].held + 1
        round_ = max(0, chance.choice((next_, next_, next_, next_ + 1, next_ - 1, self.near(-3, 12))))
        applied = max(0, chance.choice((round_ - 1, round_ - 1, round_ - 2, round_, self.near(-9, 11))))
        known = self.many.settled()
        settled = chance.choice((0, 0, known, known + chance.randrange(-2, 3), self.present + AHEAD + 1))
        held: tuple[int, ...] = ()
        if chance.random() < 0.25:
            size = chance.choice((N, N, N, N - 1, 1, N + 3))
            held = tuple(max(0, self.present + chance.randrange(-5, 3)) for _ in range(size))
            held = (*held[:-1], self.present + AHEAD + 1) if chance.random() < 0.1 else held
        return row(sender, round_, applied, *self.closings(sender, round_), settled=max(0, settled), held=held)

    def hear(self) -> None:
        chance = self.chance
        number = self.many.view.number + (chance.choice((-1, 1)) if chance.random() < 0.15 else 0)
        rows = [self.row() for _ in range(chance.choice((1, 1, 3, 12)))]
        refused = self.many.usual(rows, max(0, number), self.present)
        assert refused == one_by_one(self.each, rows, max(0, number), self.present)
        self.refused += len(refused)
        assert everything(self.many) == everything(self.each)


@pytest.mark.parametrize("seed", range(40))
def test_many_at_once_are_the_same_as_one_by_one(seed: int) -> None:
    """Through views, gaps, being frozen, watched rounds, and rounds that nobody applies for long."""
    course = Course(seed)
    for _ in range(250):
        course.move()
        course.hear()
    assert course.refused > 10 and course.many.applied > 0


def regular(author: int, round_: int) -> Usual:
    return row(author, round_, round_ - 1, one(author, round_, write(1, round_)))


def test_rounds_as_they_mostly_are_go_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else all this would prove nothing."""
    memory = fleet(N)[OWN]
    monkeypatch.setattr(Memory, "take", None)
    for round_ in range(1, 30):
        memory.close(round_, {}, stopped=False)
        assert memory.usual([regular(pid, round_) for pid in range(1, N)], 0, round_) == []
        assert memory.advance(round_ + 1) and memory.shared["last"] == round_


@pytest.mark.parametrize("count", [RECENT - 1, RECENT, 2 * WINDOW, 2 * WINDOW + 5])
def test_what_is_not_applied_for_long(count: int) -> None:
    """A few may keep the list that they came in, more must not; beyond the window there is no room."""
    memory = fleet(N)[OWN]
    batch = encoder.encode([regular(1, round_) for round_ in range(1, count + 1)])
    rows = msgspec.msgpack.decode(batch, type=list[Usual])
    refused = memory.usual(rows, 0, count)
    assert refused == ["no room for a closing"] * (count - 2 * WINDOW)
    del rows
    kept = sys.getrefcount(batch) - 2
    assert (kept > 0) and kept <= RECENT, "as many as may"


@pytest.mark.parametrize(("round_", "why"), [(10 + AHEAD, []), (11 + AHEAD, ["closing too far ahead"])])
def test_how_far_ahead_a_closing_may_be(round_: int, why: list[str]) -> None:
    memory = fleet(N)[OWN]
    assert memory.take(silence(1, 1, round_ - 1), 100) is None
    assert memory.usual([row(1, round_, 0, one(1, round_))], 0, 10) == why
    assert memory._logs[1].held == round_ - bool(why)


@pytest.mark.parametrize(("settled", "applied", "why"), [(18, 18, 0), (19, 18, 1), (18, 19, 1), (0, 18, 0), (0, 19, 1)])
def test_words_that_cannot_be(settled: int, applied: int, why: int) -> None:
    memory = fleet(N)[OWN]
    assert memory.usual([row(1, 10, applied, settled=settled)], 0, 10) == ["word does not fit"] * why
    assert memory._words._applied[1] == (0 if why else applied)


def test_a_watched_round_is_reached_once_by_each() -> None:
    many, each = fleet(N)[OWN], fleet(N)[OWN]
    for memory in (many, each):
        memory.close(1, {}, stopped=False)
        assert one_by_one(memory, [row(pid, 1, 0, silence(pid, 1, 1)) for pid in range(1, N)], 0, 1) == []
        assert memory.advance(2) and not memory.stable(1)
    rows = [row(2, 2, 1), row(2, 2, 1), row(2, 3, 1)]
    assert many.usual(rows, 0, 2) == one_by_one(each, rows, 0, 2) == []
    assert not many.stable(1) and everything(many) == everything(each)
    rows = [row(3, 2, 1), row(3, 2, 1)]
    assert many.usual(rows, 0, 2) == one_by_one(each, rows, 0, 2) == []
    assert many.stable(1) and everything(many) == everything(each)
    assert many.view == view(N)
