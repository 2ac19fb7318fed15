"""Own words that the compiled gate hands to the courier itself, past Python: they arrive where and as they would."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import KEY, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import udp
from koordgen.runtime.net.courier import GROUP
from koordgen.runtime.net.gate import NOT_POSSIBLE, NOT_STAMPED, Gate
from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.speech import RESTAMP, microseconds
from koordgen.runtime.net.transport import Coupled
from koordgen.runtime.net.wire import Decided, Round, View, decode
from koordgen.runtime.values.clock import Clock, SimulatedClock, SystemClock
from tests.runtime.net.compiled.gates import APPLICATION, BOOT, EPOCH, OWN, Exchange, N, needs_gate
from tests.runtime.net.compiled.test_voice import WORD, closing_of, ledger_of
from tests.runtime.net.transports import Opened, needs_courier
from tests.runtime.net.transports import udp as fleet_of

pytestmark = [needs_gate, needs_courier]
OTHERS = [p for p in range(N) if p != OWN]
CALLED = (OTHERS, OTHERS[:2], OTHERS[:1], OTHERS)  # each gets as many words
WORDS = 3


class Watched:
    """Another's transport, of which it cannot be told what to call."""

    def __init__(self, found: Any) -> None:
        self._found = found
        self.receive, self.wait, self.close = found.receive, found.wait, found.close

    @property
    def troubles(self) -> dict[str, int]:
        troubles: dict[str, int] = self._found.troubles
        return troubles

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        self._found.send(to, datagram)


def link(transport: Any, ledger: Ledger | None, clock: Clock | None = None) -> Link:
    if clock is None:
        clock = SimulatedClock()
        clock.time = 2.5
    given = settings(OWN, N, application_id=APPLICATION)
    made = Link(PROGRAM, given, KEY, transport, clock, Exchange(OWN), BOOT, print, Metrics(OWN, N))
    made.epoch = EPOCH
    made.speech._next_echo = float("inf")
    made.attach(ledger)
    return made


def heard_by(pid: int, kind: str) -> int:
    """How many words arrive at a robot: what is for several goes to the group where there is one."""
    return WORDS * sum(pid in to or (kind != "unicast" and len(to) > 1) for to in CALLED)


def sent_by(opened: Opened, kind: str, transport: Any, ledger: Ledger, attached: bool) -> list[list[bytes]]:
    """Words to all, to some and to one, with closings and without; what each of the others got."""
    speech = link(transport, ledger if attached else None).speech
    for to in CALLED:
        for round_ in (30, 31, 0, 77):
            said = speech.own(to, WORD, round_, ledger if round_ else None)
            assert said == (round_ != 77), "there is no such closing"
    assert speech._stamped.sequence == WORDS * len(CALLED)
    assert not list(transport.receive()), "what went to the group is known as one's own"
    found = [opened.collect(pid, heard_by(pid, kind)) for pid in OTHERS]
    assert [len(got) for got in found] == [heard_by(pid, kind) for pid in OTHERS]
    assert all(opened.is_quiet(pid) for pid in OTHERS)
    return found


@pytest.mark.parametrize("kind", ["unicast", "multicast", "broadcast"])
def test_words_arrive_as_if_python_had_sent_them(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    ledger, coupled = ledger_of(closing_of(30), closing_of(31, 700)), list[int]()
    send = Gate.send

    def counted(self: Gate, place: int, *given: Any) -> int:
        error = send(self, place, *given)
        if error != NOT_STAMPED:
            coupled.append(place)
        return error

    monkeypatch.setattr(Gate, "send", counted)
    with ExitStack() as stack:
        opened = fleet_of(stack, N, kind, True)
        own = opened.transports[OWN]
        assert isinstance(own, Coupled) and not isinstance(Watched(own), Coupled)
        found = sent_by(opened, kind, own, ledger, True)
        places = {OTHERS[0]} if kind == "unicast" else {OTHERS[0], GROUP}
        assert set(coupled) == places and len(coupled) == (4 if kind == "unicast" else 16)
        coupled.clear()
        assert sent_by(opened, kind, Watched(own), ledger, True) == found and not coupled
        assert sent_by(opened, kind, own, ledger, False) == found, "of a ledger that is not the gate's Python tells"
        assert own.troubles == {}


@pytest.mark.parametrize("offset", [None, 0.0, -7.25, 3e6])
def test_words_between_two_echoes_are_stamped_where_they_are_sent(
    monkeypatch: pytest.MonkeyPatch, offset: float | None
) -> None:
    """With the system's time, and the offset that was told last: as if Python had done it."""
    ledger, errors, send, clock = ledger_of(closing_of(30)), list[int](), Gate.send, SystemClock()

    def noted(self: Gate, *given: Any) -> int:
        errors.append(send(self, *given))
        return errors[-1]

    monkeypatch.setattr(Gate, "send", noted)
    with ExitStack() as stack:
        opened, to = fleet_of(stack, N, "unicast", True), OTHERS[:1]
        made = link(opened.transports[OWN], ledger, clock)
        speech, told = made.speech, [offset, offset]
        monkeypatch.setattr(made._fleet_clock, "offset", lambda now: told[-1])

        def say(round_: int) -> tuple[Round, list[int]]:
            errors.clear()
            before = microseconds(clock.now())
            assert speech.own(to, WORD, round_, ledger)
            after = microseconds(clock.now())
            (datagram,) = opened.collect(to[0], 1)
            word = decode(datagram, KEY)
            assert isinstance(word, Round) and before <= word.head.sent <= after
            assert word.closings == ((closing_of(30),) if round_ else ()) and word.head.echoes == ()
            assert msgspec.structs.astuple(word)[1:7] == WORD
            return word, list(errors)

        def shift() -> int | None:
            return None if told[-1] is None else round(told[-1] * 1e6)

        first, by = say(30)
        assert (first.head.sequence, first.head.fleet) == (1, shift()) and by == [NOT_STAMPED, 0]
        assert 0.0 < speech._stamped.until - clock.now() <= RESTAMP
        speech._stamped.until += 60.0  # this machine may be slow
        for turn in range(2, 9):
            word, by = say(30 * (turn % 2))
            assert (word.head.sequence, word.head.fleet) == (turn, shift()) and by == [0]
        assert not speech.own(to, WORD, 77, ledger) and errors[-1] == NOT_POSSIBLE
        told.append(1.5 if offset != 1.5 else None)
        speech._stamped.until = clock.now()
        last, by = say(0)
        assert (last.head.sequence, last.head.fleet) == (9, shift()) and by == [NOT_STAMPED, 0]
        speech.say(to, Decided, View(0, 1, (0,) * N))
        (between,) = [decode(each, KEY) for each in opened.collect(to[0], 1)]
        speech._stamped.until += 60.0
        assert not isinstance(between, str) and between.head.sequence == 10 and say(0)[0].head.sequence == 11
        speech._next_echo = clock.now() + 0.001
        speech._stamped.until = 0.0
        say(0)
        assert speech._stamped.until <= speech._next_echo, "what is due then is echoed by Python"


def test_what_cannot_be_sent_is_said_all_the_same() -> None:
    """It takes its number, and why it did not leave is counted."""
    ledger = ledger_of(closing_of(30))
    with ExitStack() as stack:
        opened = fleet_of(stack, N, "multicast", True)
        for own in (opened.transports[OWN], Watched(opened.transports[OWN + 1])):
            speech = link(own, ledger).speech
            own.close()
            for to in (OTHERS, OTHERS[:1]):
                assert speech.own(to, WORD, 30, ledger)
            assert speech._stamped.sequence == 2 and own.troubles == {"send: EBADF": 2}


def test_plain_transports_have_nothing_to_call() -> None:
    with ExitStack() as stack:
        opened = fleet_of(stack, N, "unicast", False)
        own = opened.transports[OWN]
        assert isinstance(own, udp.UnicastTransport) and own.courier is None
        speech = link(own, None).speech
        assert speech.own(OTHERS[:1], WORD, 0, None) and len(opened.collect(OTHERS[0], 1)) == 1


def test_what_is_no_word_is_not_sent() -> None:
    """From a caller that has no right to be wrong."""
    with ExitStack() as stack:
        opened = fleet_of(stack, N, "unicast", True)
        made = link(opened.transports[OWN], None)
        gate: Any = made._gate
        right: Any = (1, 2, None, (), *WORD)
        for wrong in (right[:-1], (), (1, 2, None, (), *WORD[:5], (1,) * 10**5)):
            assert gate.send(OTHERS[0], wrong, 0) == NOT_POSSIBLE
        assert gate.send(-1, right, 0) == gate.send(OTHERS[0], right, -1) == NOT_POSSIBLE
        for told in (b"", b"\x93", b"\x93\x01", b"\x93\x01\x00", b"\x92\x01\x00"):
            for length in (len(told), 0, -1, -(2**31)):
                assert gate._send(gate._at, told, length) == NOT_POSSIBLE
        assert gate.send(OTHERS[0], right, 30) == NOT_POSSIBLE, "there is no ledger"
        assert gate.send(OTHERS[0], right, 0) == 0 and len(opened.collect(OTHERS[0], 1)) == 1
        assert opened.is_quiet(OTHERS[0])
