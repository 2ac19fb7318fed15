"""What goes into how many datagrams, at the edges; and that every Hello echoes."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.net import codec, sender, wire
from koordgen.runtime.net.codec import encoder
from koordgen.runtime.net.sender import (
    ECHOES_A_LESSON,
    MOST_DATAGRAMS,
    MOST_FRAGMENTS_AT_ONCE,
    OTHERS,
    OTHERS_EVERY,
    others_every,
)
from koordgen.runtime.net.wire import LIMIT, MAX_ECHOES, Entry, Fragment, RoundMessage
from tests.runtime.net.links import OWN, WORD, Mouth, N, entry_of


def said(*entries: Entry) -> list[Any]:
    """Return the messages in which these entries are sent."""
    mouth = Mouth()
    mouth.speech.round(mouth.others, (*WORD, tuple(entries)))
    assert all(len(datagram) <= LIMIT for _, datagram in mouth.sent)
    return mouth.said()


def entry_with(size: int, round_: int = 30) -> Entry:
    """One that is so many bytes long."""
    return entry_of(round_, 700 + size - len(encoder.encode(entry_of(round_, 700))))


def test_what_just_fits_into_a_datagram_is_one() -> None:
    mouth, again = Mouth(), Mouth()
    mouth.speech.round(mouth.others, (*WORD, (entry_of(30, 700),)))
    whole = entry_of(30, 700 + LIMIT - len(mouth.sent[0][1]))
    again.speech.round(again.others, (*WORD, (whole,)))
    assert [len(datagram) for _, datagram in again.sent] == [LIMIT] and again.said()[0].entries == (whole,)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_entry_that_has_no_room_in_any_datagram_goes_in_fragments(beyond: int) -> None:
    large, small = entry_with(Mouth().speech.room + beyond), entry_of(31, 700)
    messages = said(large, small)
    assert [m.entries for m in messages if isinstance(m, RoundMessage)] == (
        [(small,)] if beyond else [(large,), (small,)]
    )
    assert [m.index for m in messages if isinstance(m, Fragment)] == ([0, 1] if beyond else [])


@pytest.mark.parametrize("beyond", [0, 1])
def test_as_many_entries_go_together_as_have_room(beyond: int) -> None:
    room = Mouth().speech.room
    half, rest = entry_with(room // 2, 30), entry_with(room - room // 2 + beyond, 31)
    *before, _ = said(half, rest, entry_with(room, 32))
    assert [m.entries for m in before] == ([(half,), (rest,)] if beyond else [(half, rest)])


def test_of_more_than_a_few_datagrams_the_first_go() -> None:
    entries = [entry_with(Mouth().speech.room, round_) for round_ in range(30, 32 + MOST_DATAGRAMS)]
    assert [m.entries for m in said(*entries)] == [(each,) for each in entries[:MOST_DATAGRAMS]]


def test_of_many_fragments_the_first_go() -> None:
    large = entry_of(30, (MOST_FRAGMENTS_AT_ONCE + 4) * LIMIT)
    assert [m.index for m in said(large) if isinstance(m, Fragment)] == list(range(MOST_FRAGMENTS_AT_ONCE))


def test_every_hello_echoes() -> None:
    """Also while it is nobody's turn."""
    mouth = Mouth()
    mouth.meet(mouth.others)
    for _ in range(3):
        mouth.speech.round(mouth.others, (*WORD, ()))
    assert mouth.said()[-1].head.echoes == ()
    for _ in range(3):
        mouth.speech.hello(0, bytes(8), bytes(8), (), None, None)
    messages: list[Any] = [codec.decode(datagram, KEY) for _, datagram in mouth.sent]
    assert [[echo.pid for echo in message.head.echoes] for message in messages] == [[0]] * 3


@pytest.mark.parametrize("apart", [0.05, 0.2, 0.45])
def test_who_is_due_a_little_later_waits_for_no_other_turn(apart: float) -> None:
    """Once one was sent an echo alone: for a turn together nobody waits much longer than for its own."""
    mouth, last, gaps, every = Mouth(), dict[int, float](), list[float](), OTHERS_EVERY / ECHOES_A_LESSON
    mouth.meet(mouth.others)
    begun = mouth.clock.time
    while mouth.clock.time < begun + 10 * every:
        mouth.speech.round(mouth.others, (*WORD, ()))
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
    mouth.speech.round(mouth.others, (*WORD, ()))
    (message,) = mouth.said()
    assert (message.head.sent, message.head.fleet) == (2_500_000, fleet)


@pytest.mark.parametrize(("now", "sent"), [(-3.0, 0), (4e-7, 0), (6e-7, 1), (1.0000015, 1_000_002), (3e7, 3 * 10**13)])
def test_no_time_is_below_zero(now: float, sent: int) -> None:
    mouth = Mouth()
    mouth.clock.time = now
    mouth.speech.round(mouth.others, (*WORD, ()))
    assert mouth.said()[0].head.sent == sent


def test_each_datagram_has_the_next_number_and_the_epoch_of_its_time() -> None:
    mouth = Mouth()
    for epoch in (b"", b"mission1", b"mission2", b""):
        mouth.link.epoch = epoch
        mouth.speech.round(mouth.others, (*WORD, ()))
        mouth.speech.round([], (*WORD, ()))
        mouth.speech.send([], wire.Decided, wire.View(0, 1, (0,)))
        mouth.speech.send(mouth.others, wire.Decided, wire.View(0, 1, (0,)))
    heads = [message.head for message in mouth.said()]
    assert [head.sequence for head in heads] == list(range(1, 9))
    assert [head.epoch for head in heads] == [e for e in (b"", b"mission1", b"mission2", b"") for _ in range(2)]


@pytest.mark.parametrize("n", [3, N, 16])
def test_echoes_go_to_those_who_are_due_as_long_as_there_is_room(n: int) -> None:
    """To all or to some, by any kind of message, and as the reference more often."""
    mouth = Mouth(n)
    mouth.meet(mouth.others[:-1])
    last, counts = dict[int, float](), list[int]()
    for turn in range(80):
        to = mouth.others if turn % 3 else mouth.others[: 1 + turn % 5]
        mouth.fleet_clock.reference = OWN if turn > 40 else 0
        every = (sender.REFERENCE_EVERY if turn > 40 else OTHERS_EVERY) / ECHOES_A_LESSON
        mouth.clock.time += (0.001, 0.01, 0.2)[turn % 3]
        if turn == 20:
            mouth.meet(mouth.others)
        mouth.speech.round(to, (*WORD, (entry_of(30),)))
        message = codec.decode(mouth.sent.pop()[1], KEY)
        assert isinstance(message, RoundMessage)
        echoed = [echo.pid for echo in message.head.echoes]
        assert set(echoed) <= set(to) and all(mouth.clock.time - last.get(pid, -9.0) >= every for pid in echoed)
        last |= dict.fromkeys(echoed, mouth.clock.time)
        counts.append(len(echoed))
    assert sorted(last) == mouth.others and max(counts) == min(MAX_ECHOES, n - 1) and 0 in counts
    for _ in range(3):
        mouth.speech.round(mouth.others, (*WORD, ()))
    assert mouth.speech._next_echo > mouth.clock.time, "nobody looks for whose turn it is while it is nobody's"


def test_in_a_large_fleet_all_have_their_turn_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [others_every(n) for n in (2, OTHERS, 2 * OTHERS)] == [OTHERS_EVERY, OTHERS_EVERY, 2 * OTHERS_EVERY]
    monkeypatch.setattr(sender, "OTHERS", 4)
    mouth, last, gaps = Mouth(n=16), dict[int, float](), list[float]()
    mouth.meet(mouth.others)
    while mouth.clock.time < 30.0:
        mouth.clock.time += 0.1
        mouth.speech.round(mouth.others, (*WORD, ()))
        for echo in mouth.said()[-1].head.echoes:
            if echo.pid in last:
                gaps.append(mouth.clock.time - last[echo.pid])
            last[echo.pid] = mouth.clock.time
    assert set(last) == set(mouth.others)
    assert min(gaps) + 1e-9 >= 4.0 / ECHOES_A_LESSON and max(gaps) < 1.6 * 4.0 / ECHOES_A_LESSON
