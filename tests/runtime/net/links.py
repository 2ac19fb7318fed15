"""A link of one robot without a network: what it hears (Ear) and what it sends (Mouth)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import msgspec

from benchmarks.fixtures.fleet import KEY, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import codec
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.link import Link
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.sender import MessageSender
from koordgen.runtime.net.sessions import PeerSession
from koordgen.runtime.net.wire import Entry, Head, Hello, Message, RoundMessage, Write
from koordgen.runtime.values.clock import SimulatedClock

N, OWN = 5, 1
APPLICATION = 300
EPOCH, BOOT = b"mission1", b"own boot"
BOOTS = {pid: b"boot of%d" % pid for pid in (0, 2, 3)}  # robot 4 was not heard yet
ADOPTED = 70  # sequence number of the Hello that each was adopted with
WORD: tuple[int, int, int, int, bool, tuple[int, ...]] = (3, 31, 30, 29, False, ())


def head(pid: int = 2, sequence: int = ADOPTED + 1, **fields: Any) -> Head:
    made = Head(
        APPLICATION, bytes.fromhex(PROGRAM.interface_hash), bytes.fromhex(PROGRAM.program_hash), pid,
        BOOTS.get(pid, BOOT), EPOCH, sequence, 2_000_000 + sequence, 30_000, (),
    )  # fmt: skip
    return msgspec.structs.replace(made, **fields)


def word(head: Head, round_: int = 30, entries: Sequence[Entry] = (), **fields: Any) -> RoundMessage:
    made = RoundMessage(head, 3, round_, round_ - 1, round_ - 2, False, (), tuple(entries))
    return msgspec.structs.replace(made, **fields)


def hello(head: Head, to: int = OWN) -> Hello:
    return Hello(head, to, bytes(8), bytes(8), (), None, None)


def sealed(message: Message) -> bytes:
    return codec.encode(message, KEY)


def entry_of(round_: int, length: int = 5) -> Entry:
    """An entry of our own whose one value has so many bytes."""
    writes = (Write(7, msgspec.Raw(b"\xc5" + length.to_bytes(2, "big") + bytes(length))),)
    return Entry(OWN, 4, round_, round_, writes=writes)


class Learning(FleetClock):
    """Fleet clock that keeps what it was taught."""

    def __init__(self, pid: int) -> None:
        super().__init__(pid)
        self.lessons: list[Any] = []

    def add(self, peer: int, *stamps: Any) -> bool:
        self.lessons.append((peer, *stamps))
        return super().add(peer, *stamps)


class AllStamps(set[int]):
    """Time stamps of a link that has sent a datagram at each time."""

    def __contains__(self, stamp: object) -> bool:
        return True


class Ear:
    """A link that has adopted some peers, and all that a datagram may change."""

    def __init__(self, boots: Collection[int] = (0, 2, 3)) -> None:
        self.clock = SimulatedClock()
        self.clock.time = 2.5
        self.waiting: Sequence[bytes] = []
        self.fleet_clock = Learning(OWN)
        self.metrics = Metrics(OWN, N)
        self.told: list[str] = []
        given = settings(OWN, N, application_id=APPLICATION)
        self.link = Link(
            PROGRAM, given, KEY, self, self.clock, self.fleet_clock, BOOT, self.told.append, self.metrics  # type: ignore[arg-type]
        )  # fmt: skip
        self.link.epoch, self.link._stamps = EPOCH, AllStamps()
        for pid in boots:
            self.link.adopt(hello(head(pid, ADOPTED, sent=1_000_000)))

    def receive(self) -> Sequence[bytes]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def hear(self, *datagrams: bytes) -> list[Message]:
        """Return the messages that are admitted of these."""
        self.waiting = datagrams
        found = self.link.receive()
        return [*self.link.pop_hellos(), *found]

    def state(self) -> Any:
        """Return all that only an admitted datagram may change."""
        return str(self.link.sessions), str(self.metrics.snapshot(self.clock.time, {})), list(self.fleet_clock.lessons)


class Mouth:
    """A link, all that it sends, and how its clock is shifted to the fleet's."""

    def __init__(self, n: int = N) -> None:
        self.clock, self.sent, self.shift = SimulatedClock(), list[tuple[list[int], bytes]](), -1.5
        self.clock.time = 2.5
        self.fleet_clock = FleetClock(OWN)
        self.fleet_clock.offset = lambda now: self.shift  # type: ignore[method-assign]
        given = settings(OWN, n, application_id=APPLICATION)
        self.link = Link(
            PROGRAM, given, KEY, self, self.clock, self.fleet_clock, BOOT, print, Metrics(OWN, n)  # type: ignore[arg-type]
        )  # fmt: skip
        assert isinstance(self.link.sender, MessageSender)
        self.speech, self.sessions = self.link.sender, self.link.sessions
        self.others = [p for p in range(n) if p != OWN]
        self.link.epoch = EPOCH
        self.speech._next_echo = float("inf")

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        self.sent.append((list(to), datagram))

    def meet(self, pids: Sequence[int]) -> None:
        """Adopt these peers; from now on there is something to be echoed to each."""
        for pid in pids:
            self.sessions[pid] = PeerSession(b"boot of%d" % (pid % 10), 5, 1_000_000 + pid, 2_000_000 + pid)
        self.speech._next_echo = float("-inf")

    def said(self) -> list[Any]:
        """Return the messages sent since the last call; each went to all others."""
        messages = [codec.decode(datagram, KEY) for _, datagram in self.sent]
        assert all(to == self.others for to, _ in self.sent)
        self.sent.clear()
        return messages
