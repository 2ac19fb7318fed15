"""What goes into how many datagrams, at the edges; and that every Hello echoes."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.net import wire
from koordgen.runtime.net.speech import ECHOES_A_LESSON, MOST_DATAGRAMS, MOST_PIECES_AT_ONCE, OTHERS_EVERY
from koordgen.runtime.net.wire import LIMIT, Closing, Piece, Round, encoder
from tests.runtime.net.compiled.gates import needs_gate
from tests.runtime.net.compiled.test_voice import WORD, Mouth, closing_of

pytestmark = needs_gate


def said(*closings: Closing) -> list[Any]:
    """The messages with these closings."""
    mouth = Mouth()
    mouth.speech.round(mouth.others, WORD, closings)
    assert all(len(datagram) <= LIMIT for _, datagram in mouth.sent)
    return mouth.said()


def closing_with(size: int, round_: int = 30) -> Closing:
    """One that is so many bytes long."""
    return closing_of(round_, 700 + size - len(encoder.encode(closing_of(round_, 700))))


def test_what_just_fits_into_a_datagram_is_one() -> None:
    mouth, again = Mouth(), Mouth()
    mouth.speech.round(mouth.others, WORD, [closing_of(30, 700)])
    whole = closing_of(30, 700 + LIMIT - len(mouth.sent[0][1]))
    again.speech.round(again.others, WORD, [whole])
    assert [len(datagram) for _, datagram in again.sent] == [LIMIT] and again.said()[0].closings == (whole,)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_closing_that_has_no_room_in_any_datagram_goes_in_pieces(beyond: int) -> None:
    large, small = closing_with(Mouth().speech.room + beyond), closing_of(31, 700)
    messages = said(large, small)
    assert [m.closings for m in messages if isinstance(m, Round)] == ([(small,)] if beyond else [(large,), (small,)])
    assert [m.index for m in messages if isinstance(m, Piece)] == ([0, 1] if beyond else [])


@pytest.mark.parametrize("beyond", [0, 1])
def test_as_many_closings_go_together_as_have_room(beyond: int) -> None:
    room = Mouth().speech.room
    half, rest = closing_with(room // 2, 30), closing_with(room - room // 2 + beyond, 31)
    *before, _ = said(half, rest, closing_with(room, 32))
    assert [m.closings for m in before] == ([(half,), (rest,)] if beyond else [(half, rest)])


def test_of_more_than_a_few_datagrams_the_first_go() -> None:
    closings = [closing_with(Mouth().speech.room, round_) for round_ in range(30, 32 + MOST_DATAGRAMS)]
    assert [m.closings for m in said(*closings)] == [(each,) for each in closings[:MOST_DATAGRAMS]]


def test_of_many_pieces_the_first_go() -> None:
    large = closing_of(30, (MOST_PIECES_AT_ONCE + 4) * LIMIT)
    assert [m.index for m in said(large) if isinstance(m, Piece)] == list(range(MOST_PIECES_AT_ONCE))


def test_every_hello_echoes() -> None:
    """Also while it is nobody's turn."""
    mouth = Mouth()
    mouth.meet(mouth.others)
    for _ in range(3):
        mouth.speech.round(mouth.others, WORD, ())
    assert mouth.said()[-1].head.echoes == ()
    for _ in range(3):
        mouth.speech.hello(0, bytes(8), bytes(8), (), None, None)
    messages: list[Any] = [wire.decode(datagram, KEY) for _, datagram in mouth.sent]
    assert [[echo.pid for echo in message.head.echoes] for message in messages] == [[0]] * 3


@pytest.mark.parametrize("apart", [0.05, 0.2, 0.45])
def test_who_is_due_a_little_later_waits_for_no_other_turn(apart: float) -> None:
    """Once one was sent an echo alone: for a turn together nobody waits much longer than for its own."""
    mouth, last, gaps, every = Mouth(), dict[int, float](), list[float](), OTHERS_EVERY / ECHOES_A_LESSON
    mouth.meet(mouth.others)
    begun = mouth.clock.time
    while mouth.clock.time < begun + 10 * every:
        mouth.speech.round(mouth.others, WORD, ())
        echoed = [echo.pid for echo in mouth.said()[-1].head.echoes]
        gaps += [mouth.clock.time - last[pid] for pid in echoed if pid in last]
        last |= dict.fromkeys(echoed, mouth.clock.time)
        mouth.clock.time += 0.05
        if abs(mouth.clock.time - begun - apart) < 1e-9:
            mouth.speech.hello(0, bytes(8), bytes(8), (), None, None)
            mouth.sent.clear()
            last[0] = mouth.clock.time
    assert sorted(last) == mouth.others
    assert min(gaps) > every - 1e-6 and max(gaps) < 1.6 * every


@pytest.mark.parametrize(("shift", "fleet"), [(None, None), (0.0, 0), (-1.5, -1_500_000), (12.25, 12_250_000)])
def test_times_are_told_in_microseconds(shift: float | None, fleet: int | None) -> None:
    mouth = Mouth()
    mouth.shift = shift  # type: ignore[assignment]
    mouth.speech.round(mouth.others, WORD, ())
    (message,) = mouth.said()
    assert (message.head.sent, message.head.fleet) == (2_500_000, fleet)
