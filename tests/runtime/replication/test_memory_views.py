"""The replicated store from view to view, and what one who comes in is handed."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.wire import Head, State, View, Want, encoder, state_of
from koordgen.runtime.replication.comeback import Store
from koordgen.runtime.replication.memory import Memory
from tests.runtime.replication.memories import everything, fleet, give, layout, one, silence, write

HEAD = Head(0, bytes(8), bytes(8), 1, bytes(8), bytes(8), 0, 0, None, ())


def advanced(n: int = 3) -> Memory:
    """Alice's after five rounds in which everyone wrote."""
    alice = fleet(n)[0]
    for r in range(1, 6):
        alice.close(r, {"x": r}, stopped=False, acted=True)
        give(alice, *[one(pid, r, write(0, 10 * pid + r)) for pid in range(1, n)])
    assert alice.advance(6)
    return alice


def test_in_the_next_view_closings_of_a_robot_that_is_out_do_not_count() -> None:
    alice = advanced()
    give(alice, one(2, 6, write(0, 99)))
    alice.adopt(View(1, 6, (0, 0, -1)))
    assert alice.missing(6) == [0, 1] and alice.held[2] == 5
    assert give(alice, one(2, 7, write(0, 99))) == ["closing of another view"]
    alice.close(6, {"x": 6}, stopped=False, acted=True)
    give(alice, one(1, 6, write(0, 16)))
    assert alice.advance(7) and alice.shared["x"] == (6, 16, 25)


def test_a_robot_that_is_in_again_counts_by_its_new_closings_only() -> None:
    alice = advanced()
    alice.adopt(View(1, 6, (0, 0, -1)))
    for r in range(6, 11):
        alice.close(r, {}, stopped=False)
    give(alice, silence(1, 6, 10))
    assert alice.advance(11)
    alice.adopt(View(2, 11, (0, 0, 2)))
    assert alice.missing(11) == [0, 1, 2]
    old = [one(2, 6, write(0, 96)), silence(2, 6, 11), one(2, 11, write(0, 97))]
    assert give(alice, *old)[2] == "closing of another view" and alice.held[2] == 10
    give(alice, one(2, 11, write(0, 98), incarnation=2), silence(1, 11, 11))
    alice.close(11, {}, stopped=False)
    assert alice.advance(12) and alice.shared["x"] == (5, 15, 98)


def test_who_stays_goes_to_the_end_of_the_view_before_and_only_then_on() -> None:
    """Bert is behind: it adopts the view that begins at round 9, and still needs cleo's closings until 8."""
    bert = fleet()[1]
    give(bert, silence(0, 1, 12), *[one(2, r, write(0, r)) for r in range(1, 5)])
    bert.close(12, {}, stopped=False)
    bert.advance(13)
    assert bert.applied == 4
    bert.adopt(View(1, 9, (0, 0, -1)))
    assert not bert.advance(13) and bert.applied == 4
    give(bert, *[one(2, r, write(0, r)) for r in range(5, 11)])
    assert bert.advance(13) and bert.shared["x"] == (0, 0, 8)


def test_a_frozen_robot_applies_nothing_more() -> None:
    alice = advanced()
    alice.close(6, {}, stopped=False)
    give(alice, silence(1, 6, 6), silence(2, 6, 6))
    alice.frozen = True
    assert not alice.advance(7) and alice.applied == 5
    alice.frozen = False
    assert alice.advance(7)


def test_who_comes_in_has_the_same_store_and_goes_on_alike() -> None:
    alice = advanced()
    alice.adopt(View(1, 6, (0, 0, 1)))
    state = alice.snapshot()
    applied = state.applied
    assert applied == 5
    handed = state_of(encoder.encode(state))
    assert handed is not None
    cleo = Memory.resume(layout(), 2, handed)
    assert cleo is not None and everything(cleo) == everything(alice)
    for memory, pid in ((alice, 0), (cleo, 2)):
        memory.close(6, {"x": 60 + pid, "last": pid}, stopped=False, acted=True)
    others = {0: alice.own(6)[0], 1: one(1, 6, write(0, 61)), 2: cleo.own(6)[0]}
    assert others[2].incarnation == 1 and others[0].incarnation == 0
    for memory, pid in ((alice, 0), (cleo, 2)):
        give(memory, *[c for p, c in others.items() if p != pid])
        assert memory.advance(7)
    assert everything(cleo) == everything(alice) and cleo.shared == {"x": (60, 61, 62), "last": 2}


def test_a_snapshot_is_made_once_for_a_round() -> None:
    """To pack all of a large store again for each of its many pieces would take longer than to send them."""
    alice, store, want, made = advanced(), Store(), Want(HEAD, 0, 1, 0, b"", b""), list[State]()

    def make() -> State:
        made.append(alice.snapshot())
        return made[-1]

    first = store.answer(1, want, alice.applied, make, 100)
    assert store.answer(2, want, alice.applied, make, 100)[0][2] == first[0][2] and len(made) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"values": ()},
        {"values": (msgspec.Raw(b"\x92\x01\x02"), msgspec.Raw(b"\x01"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02\xa1a"), msgspec.Raw(b"\x01"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02\x03"), msgspec.Raw(b"\xa2\xff\xfe"))},
        {"values": (msgspec.Raw(b"\x93\x01\x02"), msgspec.Raw(b"\x01"))},
        {"values": (msgspec.Raw(b"\x01"), msgspec.Raw(b"\x01"))},
        {"stopped": (-1, -1)},
        {"acted": (0, 0, 0, 0)},
        {"view": View(0, 1, (0, 0))},
    ],
)
def test_a_state_that_does_not_fit_is_none(change: dict[str, Any]) -> None:
    state: State = advanced().snapshot()
    assert Memory.resume(layout(), 2, state) is not None
    assert Memory.resume(layout(), 2, msgspec.structs.replace(state, **change)) is None
