"""The replicated state machine alone: order of entries, refusals, bounds, views, snapshots, and going back."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.layout import PATCH_FROM, Layout
from koordgen.runtime.net.wire import Entry, Snapshot, View, Write
from koordgen.runtime.program.program import Variable
from koordgen.runtime.replication.log import MOST_BEHIND_GAP
from koordgen.runtime.replication.state_machine import AHEAD, DROP_EVERY, MOST_PAST, WINDOW, StateMachine
from koordgen.runtime.values.bounds import Text
from tests.runtime.replication.states import acted, append, contents, fleet, layout, silent, view, write, writes_of


@pytest.mark.parametrize("seed", range(20))
def test_the_order_in_which_entries_arrive_makes_no_difference(seed: int) -> None:
    rng = Random(seed)
    states = fleet(4)
    history: list[Entry] = []
    for round_ in range(1, 31):
        for pid, state in enumerate(states):
            if rng.random() < 0.3:
                continue  # it sleeps
            writes = {"x": round_ * 10 + pid, "last": pid} if rng.random() < 0.5 else {}
            lock = 0 if writes and rng.random() < 0.5 else -1
            state.close(round_, writes, stopped=False, acted=bool(writes), lock=lock)
    for state in states:
        state.close(31, {}, stopped=False)
        history += state.own(1)
    results = []
    for pid, state in enumerate(states):
        left = [e for e in history if e.author != pid] * 2
        rng.shuffle(left)
        while left:
            state.append(left.pop(), 31)
            if rng.random() < 0.2:
                state.apply_rounds()
        state.apply_rounds()
        assert state.applied == 31 and state.held == (31,) * 4
        results.append(contents(state))
    assert all(r == results[0] for r in results)


def random_entry(rng: Random, author: int, round_: int, locks: int) -> Entry:
    if rng.random() < 0.3:
        return silent(author, round_, round_, stopped=rng.random() < 0.1)
    writes = [write(index, round_ * 10 + author) for index in range(2) if rng.random() < 0.5]
    lock = rng.randrange(-1, locks)
    return acted(author, round_, *writes, lock=lock, awaits_commit=rng.random() < 0.3, stopped=rng.random() < 0.1)


@pytest.mark.parametrize("seed", range(20))
def test_rounds_of_any_entries_have_the_result_that_the_rule_gives(seed: int) -> None:
    """That also holds for a robot that goes back to any round that is not committed."""
    rng, alice, n = Random(seed), fleet(4)[0], 4
    store: dict[str, Any] = {"x": (0,) * n, "last": -1}
    stopped, counted, won = dict[int, int](), [0] * n, 0
    past = [(store, list(counted), dict(stopped))]
    for round_ in range(1, 40):
        entries = [random_entry(rng, author, round_, locks=rng.choice((0, 0, 2))) for author in range(n)]
        own = entries[0]
        shared = {("x", "last")[w.index]: round_ * 10 for w in writes_of(own)}
        alice.close(
            round_, shared, stopped=own.stopped, acted=own.acted, awaits_commit=own.awaits_commit, lock=own.lock
        )
        assert append(alice, *entries[1:], round_=round_) == [None] * (n - 1)
        assert alice.apply_rounds()
        best = [
            min((e.author for e in entries if e.lock == lock), key=lambda p: (p - round_ - lock) % n, default=-1)
            for lock in range(2)
        ]
        commits = [e for e in entries if e.lock >= 0 and best[e.lock] == e.author]
        for entry in (*commits, *[e for e in entries if e.lock < 0]):
            author, value = entry.author, round_ * 10 + entry.author
            for index in [w.index for w in writes_of(entry)]:
                slots = (*store["x"][:author], value, *store["x"][author + 1 :])
                store = {**store, "x": slots} if index == 0 else {**store, "last": value}
            if entry.acted:
                counted[author] = round_
                won = round_ if author == 0 and entry.lock >= 0 else won
        for entry in entries:
            if entry.stopped:
                stopped.setdefault(entry.author, round_)
        past.append((store, list(counted), dict(stopped)))
        assert contents(alice) == (round_, store, stopped, counted) and alice.won.get(0, 0) == won
        assert alice.awaiting == tuple(e.author for e in entries if e.awaits_commit)
        alice.committed = max(alice.committed, round_ - rng.randrange(1, 20))
    back = rng.randrange(alice.committed, 40)
    assert alice.rewind(View(1, back + 1, (0,) * n))
    assert (alice.shared, alice.acted, alice.stopped) == past[back] and alice.applied == back


def test_a_long_silence_is_one_entry_and_is_applied_at_once() -> None:
    alice = fleet()[0]
    for round_ in range(1, 101):
        alice.close(round_, {}, stopped=False)
    assert alice.own(1) == [silent(0, 1, 100)]
    append(alice, silent(1, 1, 100), silent(2, 1, 60), round_=100)
    assert alice.apply_rounds() and alice.applied == 60 and alice.lacking == 1
    append(alice, silent(2, 41, 100, stopped=True), round_=100)
    assert alice.apply_rounds() and alice.applied == 100 and alice.stopped == {2: 61}


def test_own_rounds_before_an_event_are_closed_with_it() -> None:
    alice = fleet()[0]
    alice.close(3, {"x": 5}, stopped=False, acted=True)
    assert alice.own(1) == [silent(0, 1, 2), acted(0, 3, write(0, 5))] and alice.lacking == 2
    assert alice.own(2)[0] == silent(0, 2, 2)
    append(alice, silent(1, 1, 3), silent(2, 1, 3))
    assert alice.apply_rounds() and alice.applied == 3 and alice.shared["x"] == (5, 0, 0)


def test_entries_of_several_rounds_are_applied_as_far_as_all_of_them_reach() -> None:
    """As in a fleet that is late: a robot closes several rounds at once, and one carries the entries of another."""
    alice = fleet()[0]
    alice.close(3, {}, stopped=False)
    alice.close(4, {"x": 5}, stopped=False, acted=True)
    assert append(alice, silent(1, 1, 2), silent(1, 3, 4), acted(2, 1, write(0, 7)), silent(2, 1, 4)) == [None] * 4
    assert alice.lacking == 0 and alice.held == (4, 4, 4)
    assert alice.apply_rounds() and alice.shared == {"x": (5, 0, 7), "last": -1} and alice.acted == [4, 0, 1]


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (silent(3, 1, 1), "entry does not fit"),
        (silent(1, 0, 0), None),  # a known entry is no error
        (silent(1, 0, 1), "entry does not fit"),
        (silent(1, 3, 2), "entry does not fit"),
        (silent(1, 1, 21 + AHEAD), "entry too far ahead"),
        (silent(1, 1, 1, incarnation=1), "entry of another view"),
        (silent(0, 1, 2), "entry of this robot from another robot"),
        (acted(1, 1, write(2, 3)), "entry does not fit"),
        (acted(1, 1, write(1, "text")), "entry does not fit"),
        (acted(1, 1, write(1, 2**63)), "entry does not fit"),
        (acted(1, 1, write(0, 1), write(1, 2**63)), "entry does not fit"),
        (acted(1, 1, Write(1, msgspec.Raw(b"\xa2\xff\xfe"))), "entry does not fit"),
        (Entry(1, 0, 1, 2, writes=(write(1, 3),)), "entry does not fit"),
        (Entry(1, 0, 1, 2, acted=True), "entry does not fit"),
        (Entry(1, 0, 1, 2, lock=0), "entry does not fit"),
    ],
)
def test_entries_of_a_faulty_robot_change_nothing(bad: Entry, why: str | None) -> None:
    """The good entry of that round is accepted afterwards, so it can be asked for again."""
    alice = fleet()[0]
    alice.close(1, {}, stopped=False)
    assert append(alice, bad) == [why]
    assert alice.held == (1, 0, 0) and alice.lacking == 2 and alice.missing(1) == [1, 2]
    assert append(alice, acted(1, 1, write(0, 9)), silent(2, 1, 1)) == [None, None]
    assert alice.apply_rounds() and alice.shared["x"] == (0, 9, 0)


@pytest.mark.parametrize(("round_", "why"), [(10 + AHEAD, None), (11 + AHEAD, "entry too far ahead")])
def test_an_entry_may_be_so_many_rounds_ahead(round_: int, why: str | None) -> None:
    alice = fleet()[0]
    append(alice, silent(1, 1, round_ - 1), round_=100)
    assert append(alice, acted(1, round_), round_=10) == [why]
    assert alice.held[1] == round_ - bool(why)


def test_a_patch_that_fits_no_value_is_ignored_by_all_robots_alike() -> None:
    states = fleet()[::2]
    bad = Entry(1, 0, 1, 1, acted=True, writes=(Write(1, msgspec.Raw(b"\x91\x93\x00\x00\x00"), True),))
    for state in states:
        state.close(1, {}, stopped=False)
    for state in states:
        append(state, bad, *[silent(pid, 1, 1) for pid in (0, 2)])
        assert state.apply_rounds() and state.unfit == 1 and state.shared["last"] == -1


@pytest.mark.parametrize("length", [PATCH_FROM - 40, PATCH_FROM + 40])
def test_a_long_text_that_changes_little_is_sent_as_a_patch(length: int) -> None:
    texts = Layout([Variable("text", "allwrite", str, Text(600), str)], 1)
    state = StateMachine(texts, 0, view(1), texts.initial())
    for round_ in (1, 2):
        state.close(round_, {"text": "a" * length + str(round_)}, stopped=False, acted=True)
        assert state.apply_rounds() and state.shared == {"text": "a" * length + str(round_)}
    assert [w.patch for w in writes_of(state.own(2)[0])] == [length > PATCH_FROM]


def test_entries_behind_a_gap_are_kept_only_up_to_a_bound() -> None:
    alice = fleet()[0]
    refused = append(alice, *[acted(1, r, write(0, r)) for r in range(2, 2 + 2 * MOST_BEHIND_GAP)], round_=1000)
    assert refused.count(None) == MOST_BEHIND_GAP and refused.count("no room for an entry") == MOST_BEHIND_GAP
    append(alice, acted(1, 1, write(0, 1)))
    assert alice.held[1] == MOST_BEHIND_GAP + 1, "the entry that closes the gap is accepted"


def test_entries_that_nobody_can_apply_are_kept_only_up_to_a_bound() -> None:
    alice = fleet()[0]
    refused = append(alice, *[acted(2, r, write(0, r)) for r in range(1, 3 * WINDOW)], round_=1000)
    assert refused.count(None) == 2 * WINDOW and refused[2 * WINDOW] == "no room for an entry"


def test_a_robot_that_others_lag_far_behind_runs_no_more_events() -> None:
    alice = fleet()[0]
    for round_ in range(1, WINDOW + 1):
        assert not alice.is_full
        alice.close(round_, {}, stopped=False, acted=True)
    assert alice.is_full
    append(alice, silent(1, 1, WINDOW), silent(2, 1, WINDOW), round_=WINDOW)
    assert alice.apply_rounds() and alice.is_full, "applied here, but others may still lack the entries"
    alice.settle(WINDOW)
    assert not alice.is_full


def test_settled_entries_are_dropped() -> None:
    alice = fleet()[0]
    for round_ in range(1, 101):
        alice.close(round_, {}, stopped=False, acted=True)
        append(alice, acted(1, round_), acted(2, round_), round_=round_)
        alice.apply_rounds()
        alice.settle(round_ - 1)
        assert all(len(log.kept) <= DROP_EVERY + 1 for log in alice.logs)
    assert alice.held == (100,) * 3 and [e.round for e in alice.own(100)] == [100]
    assert append(alice, acted(1, 5)) == [None], "a known entry is no error, also when it was dropped"


# Views.


def advanced(n: int = 3, rounds: int = 5) -> StateMachine:
    """Return Alice's after some rounds in each of which every robot wrote."""
    alice = fleet(n)[0]
    for r in range(1, rounds + 1):
        alice.close(r, {"x": r}, stopped=False, acted=True)
        append(alice, *[acted(pid, r, write(0, 10 * pid + r)) for pid in range(1, n)], round_=r)
        assert alice.apply_rounds()
    return alice


def test_a_frozen_robot_applies_no_round_of_the_latest_view() -> None:
    alice = advanced()
    alice.close(6, {}, stopped=False)
    append(alice, silent(1, 6, 6), silent(2, 6, 6))
    alice.is_frozen = True
    assert not alice.apply_rounds() and alice.applied == 5
    alice.adopt(View(1, 6, (0, 0, 0)))
    assert alice.apply_rounds() and alice.applied == 6


def test_from_the_beginning_of_a_view_on_entries_of_robots_that_left_do_not_count() -> None:
    alice = advanced()
    alice.close(6, {"x": 60}, stopped=False, acted=True)
    append(alice, acted(1, 6, write(0, 61)), acted(2, 6, write(0, 62)), acted(2, 7, write(0, 63)))
    alice.adopt(View(1, 6, (0, 0, -1)))
    assert alice.held[:2] == (6, 6) and alice.missing(6) == []
    assert append(alice, acted(2, 6, write(0, 62))) == ["entry of another view"]
    assert alice.apply_rounds() and alice.shared["x"] == (60, 61, 25)
    assert alice.acted == [6, 6, 5] and alice.all_stopped is None


def test_rounds_before_a_view_are_applied_with_the_members_of_the_view_before() -> None:
    alice = advanced()
    alice.close(7, {}, stopped=False)
    append(alice, silent(1, 6, 7), silent(2, 6, 6))
    alice.adopt(View(1, 7, (0, 0, -1)))
    alice.adopt(View(2, 8, (0, 0, 2)))
    assert alice.apply_rounds() and alice.applied == 7, "in round 7 the absent robot is not waited for"
    assert alice.missing(8) == [0, 1, 2]
    alice.close(8, {}, stopped=False)
    assert append(alice, silent(1, 8, 8), silent(2, 8, 8)) == [None, "entry of another view"]
    assert append(alice, acted(2, 8, write(0, 7), incarnation=2)) == [None]
    assert alice.apply_rounds() and alice.shared["x"] == (5, 15, 7)


def test_a_robot_that_has_applied_too_much_goes_on_from_the_round_before_the_view() -> None:
    """The entries of members that stay are not needed again."""
    alice = advanced()
    assert alice.rewind(View(1, 4, (1, 0, -1)))
    assert (alice.applied, alice.shared["x"], alice.acted) == (3, (3, 13, 23), [3, 3, 3])
    assert alice.held[:2] == (3, 5) and alice.missing(4) == [0]
    alice.close(5, {}, stopped=False)
    assert alice.own(4) == [silent(0, 4, 5, incarnation=1)]
    assert alice.apply_rounds() and alice.applied == 5 and alice.shared["x"] == (3, 15, 23)


def test_a_robot_does_not_go_back_to_a_round_that_it_has_not_applied() -> None:
    alice = advanced()
    before = contents(alice)
    assert not alice.rewind(View(1, 7, (1, 0, 0)))
    assert contents(alice) == before and alice.view == view()


@pytest.mark.parametrize("committed", [0, 3, MOST_PAST, 4 * MOST_PAST])
def test_each_store_is_kept_from_the_last_committed_round_on(committed: int) -> None:
    last = 5 * MOST_PAST
    for round_ in {committed, committed + 1, (committed + last) // 2, last}:
        alice = fleet()[0]
        for r in range(1, last + 1):
            alice.close(r, {"x": r}, stopped=False, acted=True)
            append(alice, silent(1, r, r), silent(2, r, r), round_=r)
            assert alice.apply_rounds()
            alice.committed = min(r, committed)
        assert alice.rewind(View(1, round_ + 1, (1, 0, 0))) and alice.shared["x"] == (round_, 0, 0)


def test_stores_before_the_last_committed_round_are_dropped() -> None:
    """So the number of stores stays bounded, however long a mission lasts."""
    for back in range(2 * MOST_PAST, 5 * MOST_PAST, MOST_PAST):
        alice = fleet()[0]
        for r in range(1, 5 * MOST_PAST):
            alice.close(r, {"x": r}, stopped=False, acted=True)
            append(alice, silent(1, r, r), silent(2, r, r), round_=r)
            assert alice.apply_rounds()
            alice.committed = r
        assert not alice.rewind(View(1, 5 * MOST_PAST - back, (1, 0, 0)))


# Snapshots.


def test_a_robot_goes_on_from_a_snapshot_as_from_its_own_store() -> None:
    alice = advanced()
    snapshot = alice.snapshot()
    cleo = StateMachine.from_snapshot(layout(), 2, snapshot)
    assert cleo is not None and contents(cleo) == contents(alice) and cleo.held == (5, 5, 5)
    for state in (alice, cleo):
        for pid, entry in enumerate((silent(0, 6, 6), acted(1, 6, write(1, 7)), silent(2, 6, 6))):
            if state is (alice, None, cleo)[pid]:
                state.close(6, {}, stopped=False)
            else:
                assert append(state, entry) == [None]
        assert state.apply_rounds()
    assert contents(cleo) == contents(alice) and cleo.shared["last"] == 7


@pytest.mark.parametrize(
    "change",
    [
        {"values": ()},
        {"values": (msgspec.Raw(b"\x92\x01\x02"), msgspec.Raw(b"\x01"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02\xa1a"), msgspec.Raw(b"\x01"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02\x03"), msgspec.Raw(b"\xa2\xff\xfe"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02"), msgspec.Raw(b"\x01"))},
        {"stopped": (-1, -1)},
        {"acted": (0, 0, 0, 0)},
        {"view": View(0, 1, (0, 0))},
    ],
)
def test_a_snapshot_that_does_not_fit_is_refused(change: dict[str, Any]) -> None:
    snapshot: Snapshot = advanced().snapshot()
    assert StateMachine.from_snapshot(layout(), 2, snapshot) is not None
    assert StateMachine.from_snapshot(layout(), 2, msgspec.structs.replace(snapshot, **change)) is None
