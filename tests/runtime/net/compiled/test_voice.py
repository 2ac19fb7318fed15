"""Own words that the compiled gate puts together and seals: byte for byte what Python makes of them, with the same
sequence numbers and echoes; and what it leaves to Python."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import KEY, Fleet, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import gate, speech, wire
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.gate import Fields, Gate, Said
from koordgen.runtime.net.ledger import APPLIED as APPLIED_TO
from koordgen.runtime.net.ledger import DEPTH, OPEN, SETTLED, Ledger
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.seal import MEMORY, seal
from koordgen.runtime.net.sessions import Sessions
from koordgen.runtime.net.speech import ECHOES_A_LESSON, OTHERS, OTHERS_EVERY, others_every
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    MAX_ROBOTS,
    MOST_PAYLOAD,
    Closing,
    Echo,
    Head,
    Round,
    Write,
    encoder,
)
from koordgen.runtime.values.clock import SimulatedClock
from tests.runtime.net.compiled import sanitized
from tests.runtime.net.compiled.gates import APPLICATION, BOOT, EPOCH, OWN, N, head, needs_gate
from tests.runtime.net.compiled.sanitized import needs_compiler
from tests.runtime.net.compiled.test_gate_fleet import CALM, ROUGH, Story, restarts, runs_on

pytestmark = needs_gate
TOP = 2**53
EDGES = [0, 1, 127, 128, 255, 256, 2**16 - 1, 2**16, 2**32 - 1, 2**32, TOP - 1, TOP]
SHIFTS = [None, -1, -32, -33, -128, -129, -(2**15), -(2**15) - 1, -(2**31), -(2**31) - 1, -TOP, *EDGES]
INCARNATION = 4
WORD: Fields = (3, 31, 30, 29, False, ())


def closing_of(round_: int, length: int = 5, acted: bool = False, prompt: bool = False) -> Closing:
    """The own one of a round, whose one value has so many bytes."""
    writes = (Write(7, msgspec.Raw(b"\xc5" + length.to_bytes(2, "big") + bytes(length))),)
    return Closing(OWN, INCARNATION, round_, round_, False, acted, prompt, writes=writes)


def ledger_of(*closings: Closing, n: int = N) -> Ledger:
    """With these own closings, of one round after the other."""
    made, library = Ledger(OWN, n, closings[0].round - 1), gate.COMPILED.library()
    assert library is not None
    made.attach(library)
    made.number[OPEN] = 1
    for closing in closings:
        keep(made, closing)
    return made


def keep(ledger: Ledger, closing: Closing) -> None:
    pid = ledger.pid
    ledger.incarnation[pid] = closing.incarnation
    ledger.number[SETTLED] = ledger.number[APPLIED_TO] = closing.round - 1
    assert ledger.close(encoder.encode(closing))


class Mouth:
    """One link, all that it sends, and how its clock is shifted to the fleet's."""

    def __init__(self, native: bool = True, key: bytes | None = KEY, n: int = N) -> None:
        self.clock, self.sent, self.shift = SimulatedClock(), list[tuple[list[int], bytes]](), -1.5
        self.clock.time = 2.5
        fleet_clock, transport = FleetClock(OWN), self
        fleet_clock.offset = lambda now: self.shift  # type: ignore[method-assign]
        given = settings(OWN, n, application_id=APPLICATION)
        self.link = Link(
            PROGRAM, given, key, transport, self.clock, fleet_clock, BOOT, print, Metrics(OWN, n), native  # type: ignore[arg-type]
        )  # fmt: skip
        self.speech, self.sessions, self.others = (
            self.link.speech,
            self.link.sessions,
            [p for p in range(n) if p != OWN],
        )
        self.link.epoch = EPOCH
        self.speech._next_echo = float("inf")

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        self.sent.append((list(to), datagram))

    def meet(self, pids: Sequence[int]) -> None:
        """From now on there is something to be echoed to each."""
        for pid in pids:
            self.sessions.adopt(pid, b"boot of%d" % (pid % 10), 5, 1_000_000 + pid, 2_000_000 + pid)
        self.speech._next_echo = float("-inf")

    def said(self) -> list[Any]:
        """The messages, and that they went to all others."""
        messages = [wire.decode(datagram, KEY) for _, datagram in self.sent]
        assert all(to == self.others for to, _ in self.sent)
        self.sent.clear()
        return messages

    def state(self) -> Any:
        speech = self.speech
        return (
            speech._stamped.sequence,
            {p: at for p, at in speech._echoed.items() if at > -math.inf},
            speech._next_echo,
        )


def shortly(mouth: Mouth) -> bool:
    return mouth.speech.own(mouth.others, WORD, 0, None)


def introduced(key: bytes | None) -> tuple[Gate, Head]:
    """A gate, and how a word of it begins."""
    library = gate.COMPILED.library()
    assert library is not None
    made = Gate(library, N, OWN, {**Sessions(N).columns(), **Metrics(OWN, N).columns()}, key, MEMORY)
    begins = head(OWN)
    packed = wire.pack(Round(begins, 0, 0, 0, 0, False, (), ()))
    made.introduce(packed[: packed.index(encoder.encode(EPOCH)) + 10])
    return made, begins


def test_what_is_said_is_what_python_would_say() -> None:
    """In every size of every number."""
    chance = Random(1)
    closings = [closing_of(r, r, r % 2 == 0, r % 3 == 0) for r in range(126, 126 + DEPTH)]
    ledger, pick = ledger_of(*closings), chance.choice
    for key in (KEY, None):
        made, begins = introduced(key)
        for turn in range(4000):
            pids = [chance.randrange(MAX_ROBOTS) for _ in range(turn % (MAX_ECHOES + 1))]
            echoes = tuple([Echo(pid, pick(EDGES), pick(EDGES)) for pid in pids])
            sequence, sent, fleet = pick(EDGES), pick(EDGES), pick(SHIFTS)
            held = tuple(chance.choices(EDGES[:9], k=pick((0, 0, 1, 15, 16, MAX_ROBOTS))))
            word: Fields = (pick(EDGES), pick(EDGES), pick(EDGES), pick(EDGES), pick((True, False)), held)
            with_ = [pick(closings)] if turn % 2 else []
            begun = msgspec.structs.replace(begins, sequence=sequence, sent=sent, fleet=fleet, echoes=echoes)
            wanted = wire.encode(Round(begun, *word, tuple(with_)), key)
            found = made.say((sequence, sent, fleet, echoes, *word), ledger.at, with_[0].round if with_ else 0)
            assert found == (wanted if len(wanted) <= LIMIT else b""), (begun, word)


@pytest.mark.parametrize("length", [*range(40), 230, 255, 256, 257, 700])
def test_own_closings_of_every_length_to_the_limit(length: int) -> None:
    """And none beyond, with as much in front of them as there may be."""
    made, begins = introduced(KEY)
    for held in ((), (2**32 - 1,) * (length % 90)):
        word: Fields = (3, 31, 30, 29, True, held)
        for size in (length, "whole", "beyond"):
            begun = msgspec.structs.replace(begins, sequence=99)
            room = MOST_PAYLOAD - len(wire.pack(Round(begun, *word, (closing_of(30, 0),))))
            closing = closing_of(30, {"whole": room, "beyond": room + 1}.get(str(size), length))
            wanted, ledger = wire.encode(Round(begun, *word, (closing,)), KEY), ledger_of(closing)
            assert len(wanted) == {"whole": LIMIT, "beyond": LIMIT + 1}.get(str(size), len(wanted))
            found = made.say((99, begins.sent, begins.fleet, (), *word), ledger.at, 30)
            assert found == (wanted if len(wanted) <= LIMIT else b"")


def test_the_own_closings_that_are_there_are_those_of_the_last_rounds() -> None:
    mouth, closings = Mouth(), [closing_of(r, r) for r in range(20, 20 + DEPTH + 3)]
    ledger = ledger_of(*closings)
    own, last = mouth.speech.own, closings[-1].round

    def there(rounds: Iterator[int] | range) -> list[int]:
        found = [r for r in rounds if r and own(mouth.others, WORD, r, ledger)]
        assert [message.closings for message in mouth.said()] == [(closing_of(r, r),) for r in found]
        return found

    around = range(-3, last + 20)
    assert there(around) == list(range(last - DEPTH + 1, last + 1)) == [r for r in around if ledger.own(r)]
    ledger.floor[OWN] = last - 3
    assert there(around) == list(range(last - 2, last + 1)) == [r for r in around if ledger.own(r)]
    ledger.floor[OWN] = last
    assert there(around) == []
    assert mouth.state()[0] == DEPTH + 3, "what was not said has no number"
    assert not own(mouth.others, WORD, last, Ledger(OWN, N, last - 1)), "one that C does not know"
    other = ledger_of(closing_of(last))
    other.held[0] = other.held[2] = 0
    assert own(mouth.others, WORD, last, other), "the others' are not asked for"


def test_words_without_closings_take_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    mouths, said, say = [Mouth(), Mouth(False)], list[bytes](), Gate.say

    def noted(*given: Any) -> bytes:
        said.append(say(*given))
        return said[-1]

    monkeypatch.setattr(Gate, "say", noted)
    for mouth in mouths:
        mouth.meet([0, 2, 3])
        for held in ((), (3,) * N, [4] * N):
            mouth.speech.round(mouth.others, (3, 31, 30, 29, held == (), tuple(held)), [])
            mouth.speech.round([0], (3, 31, 30, 29, False, tuple(held)), (), {})
            mouth.clock.time += 0.3
        mouth.speech.round([], WORD, ())
        mouth.speech.round(mouth.others, WORD, [closing_of(3)])
    assert mouths[0].sent == mouths[1].sent and mouths[0].state() == mouths[1].state()
    assert said == [datagram for _, datagram in mouths[0].sent[:-1]] and len(said) == 6


@pytest.mark.parametrize("shift", [None, 0.0, -1e-6, 12.25, -4e9])
@pytest.mark.parametrize("now", [-3.0, 0.0, 4e-7, 6e-7, 1.0000005, 1.0000015, 3e7])
def test_times_are_told_as_ever(shift: float | None, now: float) -> None:
    heads = []
    for native in (True, False):
        mouth = Mouth(native)
        mouth.shift, mouth.clock.time = shift, now  # type: ignore[assignment]
        mouth.speech.round(mouth.others, WORD, ())
        heads.append(mouth.said()[0].head)
    assert heads[0] == heads[1]


@pytest.mark.parametrize("n", [3, N, 16])
def test_echoes_come_as_often_and_to_the_same(n: int) -> None:
    """Whether words go the one way or the other, and between other messages."""
    ledger, mouths = ledger_of(closing_of(30), n=n), [Mouth(True, n=n), Mouth(False, n=n)]
    for mouth in mouths:
        mouth.meet(mouth.others[:-1])
        for turn in range(80):
            to, reference = mouth.others if turn % 3 else mouth.others[: 1 + turn % 5], OWN if turn > 40 else 0
            mouth.link._fleet_clock.reference = reference
            mouth.clock.time += (0.001, 0.01, 0.2)[turn % 3]
            if turn == 20:
                mouth.meet(mouth.others)
            if turn % 7 == 0:
                mouth.speech.say(to, wire.Decided, wire.View(0, 1, (0,) * n))
            if not mouth.speech.own(to, WORD, 30, ledger):
                mouth.speech.round(to, WORD, [closing_of(30)])
    assert mouths[0].sent == mouths[1].sent and mouths[0].state() == mouths[1].state()
    echoes = [len(wire.decode(datagram, KEY).head.echoes) for _, datagram in mouths[0].sent]  # type: ignore[union-attr]
    assert max(echoes) == min(MAX_ECHOES, n - 1) and 0 in echoes
    for mouth in mouths:
        for _ in range(3):
            mouth.speech.round(mouth.others, WORD, ())
        assert mouth.speech._next_echo > mouth.clock.time, "nobody looks for whose turn it is while it is nobody's"


def test_what_is_too_long_goes_the_long_way_as_if_nobody_had_tried() -> None:
    """Its echoes and numbers are in what goes then."""
    mouths, big, bigger = [Mouth(), Mouth(False)], closing_of(30, 1180 - 60), closing_of(31, 900)
    ledger = ledger_of(big, bigger)
    for mouth in mouths:
        mouth.meet(mouth.others)
        for closing in (big, bigger, big):
            before = mouth.state()
            said = mouth.speech.own(mouth.others, WORD, closing.round, ledger)
            assert said == (closing is bigger and mouth is mouths[0])
            if not said:
                assert mouth.state() == before
                mouth.speech.round(mouth.others, WORD, [closing])
            mouth.clock.time += 5.0
    assert mouths[0].sent == mouths[1].sent and mouths[0].state() == mouths[1].state()
    messages = mouths[0].said()
    assert sorted(m.head.sequence for m in messages) == list(range(1, 8)), "three for each of the two"
    assert [m.closings for m in messages if isinstance(m, Round)] == [(), (bigger,), ()]
    assert sum(len(m.head.echoes) for m in messages) == 3 * (N - 1)


def test_no_epoch_no_short_way_and_another_epoch_another_beginning() -> None:
    mouth, plain = Mouth(), Mouth(False)
    for epoch in (EPOCH, b"", b"mission2", b""):
        for each in (mouth, plain):
            each.link.epoch = epoch
            assert shortly(each) == (each is mouth and epoch != b"")
            each.speech.round(each.others, WORD, ())
    messages = mouth.said()
    assert [m.head.epoch for m in messages] == [EPOCH, EPOCH, b"", b"mission2", b"mission2", b""]
    assert [m.head.sequence for m in messages] == [1, 2, 3, 4, 5, 6]
    mouth.link.adopt(wire.Hello(head(2), OWN, bytes(8), bytes(8), (), None, None))
    assert not shortly(mouth), "whoever is adopted"


def test_without_a_gate_or_anyone_to_hear_nothing_is_said() -> None:
    mouth, plain, ledger = Mouth(), Mouth(False), ledger_of(closing_of(30))
    for each in (mouth, plain):
        before = each.state()
        assert each.speech.own([], WORD, 30, ledger) and each.sent == [], "nor is there a long way to go"
        assert each.state() == before
    assert not plain.speech.own(plain.others, WORD, 30, ledger) and plain.sent == []


def test_what_is_no_word_is_not_said() -> None:
    """From a caller that has no right to be wrong; nothing is read or written beyond its end."""
    made, begins = introduced(KEY)
    right: Any = (1, 2, None, (), *WORD)
    say, said = made._say, made._said
    assert made.say(right, 0, 0)
    before = said[:LIMIT]
    for wrong in (right[:-1], (*right, 3), (), right * 2):
        assert made.say(wrong, 0, 0) == b""
    for bytes_ in (0, -1, -60, -(2**31)):
        assert say(made._at, b"\x9a" + bytes(30), bytes_, 0, 0) == 0
    for huge in (LIMIT, 10**6):
        assert made.say((1, 2, None, (), *WORD[:5], (1,) * huge), 0, 0) == b""
    assert made.say(right, 0, 30) == b"", "there is no ledger"
    assert said[:LIMIT] == before
    for length, room in ((64, True), (65, False), (0, False)):
        made.introduce(bytes(length))
        found = made.say(right, 0, 0)
        assert found == (seal(KEY, MEMORY, bytes(64) + encoder.encode(right)[1:] + b"\x90") if room else b"")
    assert begins.boot == BOOT


@pytest.mark.parametrize("story", [runs_on, restarts])
@pytest.mark.parametrize("conditions", [CALM, ROUGH], ids=["calm", "rough"])
def test_fleets_send_the_same_bytes(monkeypatch: pytest.MonkeyPatch, story: Story, conditions: Conditions) -> None:
    """Whether the gate says what it can, or nothing."""
    sent, say, counts = list[list[Any]](), Gate.say, [0, 0]

    def counted(self: Gate, fields: Said, ledger: int, own: int) -> bytes:
        datagram = say(self, fields, ledger, own)
        counts[own > 0] += datagram != b""
        return datagram

    for said in (counted, lambda *given: b""):
        monkeypatch.setattr(Gate, "say", said)
        fleet, datagrams = Fleet(n=N, seed=5, conditions=conditions), list[Any]()
        send = fleet.network.send

        def tap(sender: int, receiver: int, datagram: bytes, send: Any = send, to: list[Any] = datagrams) -> None:
            to.append((sender, receiver, datagram))
            send(sender, receiver, datagram)

        fleet.network.send = tap  # type: ignore[method-assign]
        story(fleet.boot_all())
        sent.append(datagrams)
    assert sent[0] == sent[1] and len(sent[0]) > 1000
    assert min(counts) > 100, counts


@pytest.mark.slow
@needs_compiler
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    sanitized.run("voice_driver.c", gate.SOURCE, gate.FLAGS, tmp_path, 200_000)


def test_in_a_large_fleet_all_have_their_turn_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [others_every(n) for n in (2, OTHERS, 2 * OTHERS)] == [OTHERS_EVERY, OTHERS_EVERY, 2 * OTHERS_EVERY]
    monkeypatch.setattr(speech, "OTHERS", 4)
    mouth, last, gaps = Mouth(n=16), dict[int, float](), list[float]()
    mouth.meet(mouth.others)
    while mouth.clock.time < 30.0:
        mouth.clock.time += 0.1
        mouth.speech.round(mouth.others, WORD, ())
        for echo in mouth.said()[-1].head.echoes:
            if echo.pid in last:
                gaps.append(mouth.clock.time - last[echo.pid])
            last[echo.pid] = mouth.clock.time
    assert set(last) == set(mouth.others)
    assert min(gaps) + 1e-9 >= 4.0 / ECHOES_A_LESSON and max(gaps) < 1.6 * 4.0 / ECHOES_A_LESSON
