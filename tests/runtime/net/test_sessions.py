"""Which sequence numbers of a peer's boot are taken: each once, however they come."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.net.sessions import REPLAY_WINDOW, Sessions

NUMBERS = st.lists(st.integers(0, 3000) | st.integers(10_000, 10_100) | st.integers(2**52, 2**53), max_size=300)


@given(NUMBERS, st.integers(0, 2000) | st.none())
def test_a_sequence_number_is_taken_once(sequences: list[int], adopted: int | None) -> None:
    sessions = Sessions(3)
    if adopted is not None:
        sessions.adopt(1, b"boot", adopted)
    before = -1 if adopted is None else adopted
    taken: set[int] = set()
    for sequence in sequences:
        newest = max({0, before} | taken)
        wanted = sequence not in taken and sequence > before and sequence > newest - REPLAY_WINDOW
        assert sessions.fresh(1, sequence) == wanted
        if wanted:
            taken.add(sequence)
        assert sessions.newest.tolist() == [0, max({0, before} | taken), 0]
        assert not any(sessions.seen[: len(sessions.seen) // 3])


def test_a_boot_that_is_adopted_anew_begins_anew() -> None:
    sessions = Sessions(2)
    sessions.adopt(1, b"old", 70, sent=5, arrived=6)
    sessions.round[1], sessions.due[1] = 9, 1.0
    assert sessions.fresh(1, 71)
    sessions.adopt(1, b"new", 3)
    assert sessions.boots == {1: b"new"}
    assert (sessions.round[1], sessions.sent[1], sessions.due[1]) == (0, -1, float("-inf"))
    assert [n for n in range(200) if sessions.fresh(1, n)] == list(range(4, 200))
