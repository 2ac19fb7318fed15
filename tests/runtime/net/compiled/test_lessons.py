"""What the clock learns from, which waits in the compiled gate until Python asks, against the link in plain Python."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from koordgen.runtime.net.wire import Echo, Head, Message, Need
from tests.runtime.net.compiled.gates import OWN, Ears, N, head, needs_gate, sealed, word

pytestmark = needs_gate


@pytest.mark.parametrize("first", [True, False])
def test_of_two_echoes_of_ours_the_first_is_learned_from(first: bool) -> None:
    ears = Ears()
    ours = [Echo(OWN, 1_500_000 + i, 1_600_000 + i) for i in range(3)]
    echoes = (*ours, Echo(0, 1, 2)) if first else (Echo(0, 1, 2), *ours)
    ears.hear(sealed(word(head(echoes=echoes))))
    assert [lesson[1] for lesson in ears.native.fleet_clock.lessons] == [1.5]
    assert ears.native.usual == 1
    ears.same()


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("differ", ["answered", "sent", "received"])
def test_of_what_comes_at_once_the_last_word_is_learned_from(differ: str, turned: bool) -> None:
    """Of each robot, whatever comes last, and whether the gate judges it or not."""
    ears = Ears()

    def need(made: Head) -> Message:
        return Need(made, 3, 29, 29, (29,) * N, ())

    pairs: list[tuple[Callable[[Head], Message], Callable[[Head], Message]]] = [
        (word, word),
        (word, need),
        (need, word),
    ]
    for kind, other in pairs:
        ears.move(10.0)
        stamps = [[3_000_000, 1_500_000, 1_600_000], [3_000_000, 1_500_000, 1_600_000]]
        stamps[1][["answered", "sent", "received"].index(differ)] += 5
        datagrams = []
        for number, (made, (answered, sent, received)) in enumerate(zip((kind, other), stamps, strict=True)):
            sequence = ears.native.link.sessions.newest[2] + 1 + number
            datagrams.append(sealed(made(head(2, sequence, sent=answered, echoes=(Echo(OWN, sent, received),)))))
        before = len(ears.native.fleet_clock.lessons)
        ears.hear(*datagrams[:: -1 if turned else 1], sealed(word(head(0, sequence, echoes=(Echo(OWN, 5, 6),)))))
        lessons = ears.native.fleet_clock.lessons[before:]
        (late,) = [lesson for lesson in lessons if lesson[0] == 2]
        assert late[1:4] == tuple(stamps[1][place] / 1e6 for place in (1, 2, 0)) and len(lessons) == 2
        ears.same()


def test_most_is_learned_from_who_keeps_the_time() -> None:
    """Also when it did not before: what it says next counts, however short ago it was learned from."""
    ears = Ears()
    for pid, sequence, after, learned in [(2, 71, 0.0, 1), (2, 72, 0.3, 1), (0, 71, 0.0, 2), (0, 72, 0.3, 3)]:
        ears.move(after)
        ears.hear(sealed(word(head(pid, sequence, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
        assert len(ears.native.fleet_clock.lessons) == learned
    for ear in (ears.native, ears.plain):
        ear.link.keep_time(2, ear.clock.now())
    ears.hear(sealed(word(head(2, 73, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
    assert len(ears.native.fleet_clock.lessons) == 4
    for ear in (ears.native, ears.plain):
        ear.link.keep_time(2, ear.clock.now())  # which is nothing new
    ears.hear(sealed(word(head(2, 74, echoes=(Echo(OWN, 1_500_000, 1_600_000),)))))
    assert len(ears.native.fleet_clock.lessons) == 4
    ears.same()
