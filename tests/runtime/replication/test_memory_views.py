"""The replicated store from view to view, and what one who comes in is handed."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from koordgen.runtime.net.wire import Head, State, View, Want
from koordgen.runtime.replication.comeback import Store
from koordgen.runtime.replication.memory import Memory
from tests.runtime.replication.memories import fleet, give, layout, one, write

HEAD = Head(0, bytes(8), bytes(8), 1, bytes(8), bytes(8), 0, 0, None, ())


def advanced(n: int = 3) -> Memory:
    """Alice's after five rounds in which everyone wrote."""
    alice = fleet(n)[0]
    for r in range(1, 6):
        alice.close(r, {"x": r}, stopped=False, acted=True)
        give(alice, *[one(pid, r, write(0, 10 * pid + r)) for pid in range(1, n)])
    assert alice.advance(6)
    return alice


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
