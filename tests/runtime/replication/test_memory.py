"""The replicated store alone: in what order closings take effect, whose count, what may be forgotten."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.wire import Closing, View, Write
from koordgen.runtime.replication.log import GAPS, Entry
from koordgen.runtime.replication.memory import AHEAD, WINDOW, Memory
from tests.runtime.replication.memories import everything, fleet, give, layout, log_of, one, said, silence, view, write


@pytest.mark.parametrize("seed", range(20))
def test_the_order_and_number_in_which_closings_come_makes_no_difference(seed: int) -> None:
    rng = Random(seed)
    memories = fleet(4)
    history: list[Closing] = []
    for round_ in range(1, 31):
        for pid, memory in enumerate(memories):
            if rng.random() < 0.3:
                continue  # sleeps
            writes = {"x": round_ * 10 + pid, "last": pid} if rng.random() < 0.5 else {}
            lock = 0 if writes and rng.random() < 0.5 else -1
            memory.close(round_, writes, stopped=False, acted=bool(writes), lock=lock)
    for memory in memories:
        memory.close(31, {}, stopped=False)
        history += memory.own(1)
    results = []
    for pid, memory in enumerate(memories):
        left = [c for c in history if c.author != pid] * 2
        rng.shuffle(left)
        while left:
            memory.take(left.pop(), 31)
            if rng.random() < 0.2:
                memory.advance(32)
        assert memory.advance(32)
        results.append(everything(memory))
    assert all(r == results[0] for r in results)


def random_closing(rng: Random, author: int, round_: int, locks: int) -> Closing:
    if rng.random() < 0.3:
        return silence(author, round_, round_, stopped=rng.random() < 0.1)
    writes = [write(index, round_ * 10 + author) for index in range(2) if rng.random() < 0.5]
    lock = rng.randrange(-1, locks)
    return one(author, round_, *writes, lock=lock, prompt=rng.random() < 0.3, stopped=rng.random() < 0.1)


@pytest.mark.parametrize("seed", range(20))
def test_rounds_of_any_closings_come_to_what_the_rule_says(seed: int) -> None:
    """Also for one who goes back to any round that is not stable."""
    rng, alice, n = Random(seed), fleet(4)[0], 4
    store: dict[str, Any] = {"x": (0,) * n, "last": -1}
    stopped, acted, won, past = dict[int, int](), [0] * n, 0, [(store, [0] * n)]
    for round_ in range(1, 40):
        closings = [random_closing(rng, author, round_, locks=rng.choice((0, 0, 2))) for author in range(n)]
        own = closings[0]
        shared = {("x", "last")[w.index]: round_ * 10 for w in own.writes}
        alice.close(round_, shared, stopped=own.stopped, acted=own.acted, prompt=own.prompt, lock=own.lock)
        assert give(alice, *closings[1:], present=round_) == [None] * (n - 1)
        assert alice.advance(round_ + 1)
        best = [
            min((c.author for c in closings if c.lock == lock), key=lambda p: (p - round_ - lock) % n, default=-1)
            for lock in range(2)
        ]
        commits = [c for c in closings if c.lock >= 0 and best[c.lock] == c.author]
        for closing in (*commits, *[c for c in closings if c.lock < 0]):
            author, value = closing.author, round_ * 10 + closing.author
            for index in [w.index for w in closing.writes]:
                slots = (*store["x"][:author], value, *store["x"][author + 1 :])
                store = {**store, "x": slots} if index == 0 else {**store, "last": value}
            if closing.stopped:
                stopped.setdefault(author, round_)
            if closing.acted:
                acted[author] = round_
                won = round_ if author == 0 and closing.lock >= 0 else won
        past.append((store, list(acted)))
        assert everything(alice) == (round_, store, stopped, acted) and alice.won == won
        assert alice.prompt == tuple(c.author for c in closings if c.prompt)
        for pid in rng.sample(range(1, n), rng.randrange(3)):
            said(alice, pid, round_ - rng.randrange(2))
    back = rng.randrange(max(r for r in range(40) if alice.stable(r) or not r), 40)
    before = alice.rewound(View(1, back + 1, (0,) * n))
    assert before is not None and (before.shared, before.acted) == past[back]


def test_a_long_silence_is_one_closing_and_is_applied_at_once() -> None:
    alice = fleet()[0]
    for round_ in range(1, 101):
        alice.close(round_, {}, stopped=False)
    assert alice.own(1) == [silence(0, 1, 100)]
    give(alice, silence(1, 1, 100), silence(2, 1, 60), present=100)
    assert not alice.advance(101) and alice.applied == 60
    give(alice, silence(2, 41, 100, stopped=True), present=100)
    assert alice.advance(101) and alice.stopped == {2: 61}


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (silence(3, 1, 1), "closing does not fit"),
        (silence(1, 0, 0), None),  # known: no news
        (silence(1, 0, 1), "closing does not fit"),
        (silence(1, 3, 2), "closing does not fit"),
        (silence(1, 1, 21 + AHEAD), "closing too far ahead"),
        (silence(1, 1, 1, incarnation=1), "closing of another view"),
        (silence(0, 1, 1), "closing of ours that we did not write"),
        (one(1, 1, write(2, 3)), "closing does not fit"),
        (one(1, 1, write(1, "text")), "closing does not fit"),
        (one(1, 1, write(1, 2**63)), "closing does not fit"),
        (one(1, 1, Write(1, msgspec.Raw(b"\xa2\xff\xfe"))), "closing does not fit"),
        (Closing(1, 0, 1, 2, writes=(write(1, 3),)), "closing does not fit"),
        (Closing(1, 0, 1, 2, acted=True), "closing does not fit"),
        (Closing(1, 0, 1, 2, lock=0), "closing does not fit"),
    ],
)
def test_closings_of_a_robot_gone_wrong_change_nothing(bad: Closing, why: str | None) -> None:
    alice = fleet()[0]
    assert give(alice, bad) == [why]
    assert alice.held == (0, 0, 0)
    alice.close(1, {}, stopped=False)
    assert give(alice, silence(1, 1, 1), silence(2, 1, 1)) == [None, None]
    assert alice.advance(2)


def test_a_patch_that_fits_no_value_is_dropped_by_everyone_alike() -> None:
    memories = fleet()
    bad = Closing(1, 0, 1, 1, acted=True, writes=(Write(1, msgspec.Raw(b"\x91\x93\x00\x00\x00"), True),))
    for memory in memories[::2]:
        memory.close(1, {}, stopped=False)
    for memory in memories[::2]:
        give(memory, bad, *[silence(pid, 1, 1) for pid in (0, 2)])
        assert memory.advance(2) and memory.unfit == 1 and memory.shared["last"] == -1


def test_closings_beyond_a_gap_are_kept_only_up_to_a_bound() -> None:
    alice = fleet()[0]
    refused = give(alice, *[one(1, r, write(0, r)) for r in range(2, 2 + 2 * GAPS)], present=1000)
    assert refused.count(None) == GAPS and refused.count("no room for a closing") == GAPS
    refused = give(alice, *[one(2, r, write(0, r)) for r in range(1, 3 * WINDOW)], present=1000)
    assert refused.count(None) == 2 * WINDOW
    give(alice, one(1, 1, write(0, 1)))
    assert alice.held[1] == GAPS + 1, "what closes the gap finds room"


@pytest.mark.parametrize("of_another", [0, 1, 2])
def test_which_rounds_are_stable(of_another: int) -> None:
    """However far the others are that did, and in whatever order they say so; some by another view than the present."""
    n = 6
    for seed in range(60):
        rng = Random(seed)
        alice = Memory(layout(n), 0, view(n), layout(n).initial(), 20)
        applied = {pid: rng.randrange(1, 21) for pid in rng.sample(range(1, n), n - 1)}
        for k, (pid, last) in enumerate(applied.items()):
            said(alice, pid, last, number=7 if k < of_another else 0)
        counting = sorted(list(applied.values())[of_another:], reverse=True)
        sure = counting[2] if len(counting) > 2 else 0  # with alice they are four of six
        for round_ in rng.sample(range(1, 22), 21):
            assert alice.stable(round_) == (round_ <= sure), (applied, round_)


def test_words_that_cannot_be_are_refused() -> None:
    alice = fleet()[0]
    for held, through, settled, applied in [
        ((0, 0), 0, 0, 0),
        ((0, 0, 999), 0, 0, 0),
        ((0, 0, 0), 999, 0, 0),
        ((0, 0, 0), 0, 999, 0),
        ((0, 0, 0), 0, 0, 999),
    ]:
        assert alice.heard(1, 0, applied, held, through, settled, 20, True) == "word does not fit"
    assert alice.settled() == 0 and alice.repeat(1) == []


def test_a_log_joins_silence_and_keeps_what_lies_beyond_a_gap() -> None:
    log = log_of(1)
    log.take(Entry(silence(1, 1, 3), ()))
    log.take(Entry(silence(1, 7, 9), ()))
    log.take(Entry(silence(1, 7, 8), ()))
    assert log.held == 3 and list(log.later) == [7]
    log.take(Entry(silence(1, 3, 6), ()))
    assert log.held == 9 and not log.later and [e.closing for e in log.entries] == [silence(1, 1, 9)]
    assert log.between(4, 5) == [silence(1, 4, 9)]
    log.cut(5)
    assert log.held == 5 and log.entries[-1].closing == silence(1, 1, 5)
    log.skip(20)
    assert log.held == 20
    log.forget(20)
    assert log.entries == []


@pytest.mark.parametrize("seed", range(5))
def test_closings_between_two_rounds_are_found_wherever_they_lie(seed: int) -> None:
    rng, log, held = Random(seed), log_of(1), 0
    while held < 60:
        first, held = held + 1, held + rng.randrange(1, 4)
        log.take(Entry(one(1, first) if first == held else silence(1, first, held), ()))
    for low in range(1, held + 2):
        for high in range(low - 1, held + 2):
            wanted = [e.closing for e in log.entries if e.closing.round >= low and e.closing.first <= high]
            assert log.between(low, high) == [msgspec.structs.replace(c, first=max(c.first, low)) for c in wanted]


def test_a_stopped_robot_tells_it_with_each_silence() -> None:
    log = log_of(1)
    log.take(Entry(silence(1, 1, 3), ()))
    log.take(Entry(silence(1, 4, 6, stopped=True), ()))
    assert [e.closing.round for e in log.entries] == [3, 6]
