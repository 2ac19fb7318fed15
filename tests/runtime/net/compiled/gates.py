"""A robot's link with the compiled gate and one without, side by side on equal clocks."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import KEY, settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.net import gate, wire
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.gate import Gate
from koordgen.runtime.net.link import Link, Usuals
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.seal import MEMORY
from koordgen.runtime.net.sessions import Sessions
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import Closing, Head, Hello, Message, Round, View
from koordgen.runtime.values.clock import SimulatedClock

NO_GATE = gate.COMPILED.why()
needs_gate = pytest.mark.skipif(bool(NO_GATE), reason=NO_GATE)
N, OWN = 5, 1
APPLICATION = 300
EPOCH, BOOT = b"mission1", b"own boot"
BOOTS = {pid: b"boot of%d" % pid for pid in (0, 2, 3)}  # 4 was not heard yet
VIEW = View(3, 20, (0, 3, 200, -1, 2**53))
ADOPTED = 70  # sequence number of the Hello that each was adopted with


def opened(key: bytes | None = KEY, found: ctypes.CDLL | None = None, purpose: bytes = MEMORY) -> Gate:
    columns = {**Sessions(N).columns(), **Metrics(OWN, N).columns()}
    found = found or gate.COMPILED.library()
    assert found is not None
    return Gate(found, N, OWN, columns, key, purpose)


def head(pid: int = 2, sequence: int = ADOPTED + 1, **fields: Any) -> Head:
    made = Head(
        APPLICATION, bytes.fromhex(PROGRAM.interface_hash), bytes.fromhex(PROGRAM.program_hash), pid,
        BOOTS.get(pid, BOOT), EPOCH, sequence, 2_000_000 + sequence, 30_000, (),
    )  # fmt: skip
    return msgspec.structs.replace(made, **fields)


def word(head: Head, round_: int = 30, closings: Sequence[Closing] = (), **fields: Any) -> Round:
    made = Round(head, VIEW.number, round_, round_ - 1, round_ - 2, False, (), tuple(closings))
    return msgspec.structs.replace(made, **fields)


def is_usual(message: Message | str) -> bool:
    """Of a datagram that nothing is wrong with: by the words of gate.c."""
    return isinstance(message, Round) and message.view == VIEW.number and not message.emergency


def plain(message: Any) -> Any:
    """What a usual datagram says and what it says as a Round look the same."""
    if isinstance(message, Usuals):
        return [
            (r.sender, message.view, r.round, r.applied, r.settled, False, r.held, r.closings) for r in message.rows
        ]
    if isinstance(message, Round):
        return [(message.head.pid, *(getattr(message, name) for name in Round.__struct_fields__[1:]))]
    return [message]


class Exchange(FleetClock):
    """Writes down what it was taught."""

    def __init__(self, pid: int) -> None:
        super().__init__(pid)
        self.lessons: list[Any] = []

    def take(self, peer: int, *stamps: Any) -> bool:
        self.lessons.append((peer, *stamps))
        return super().take(peer, *stamps)


class Ear:
    """One link, and all that what arrives may change."""

    def __init__(self, native: bool, key: bytes | None = KEY, boots: Sequence[int] = (0, 2, 3)) -> None:
        self.clock = SimulatedClock()
        self.clock.time = 2.5
        self.waiting: Sequence[bytes] = []
        self.fleet_clock = Exchange(OWN)
        self.metrics = Metrics(OWN, N)
        self.told: list[str] = []
        transport: Transport = self  # type: ignore[assignment]
        given = settings(OWN, N, application_id=APPLICATION)
        self.link = Link(
            PROGRAM, given, key, transport, self.clock, self.fleet_clock, BOOT, self.told.append, self.metrics, native
        )
        self.link.epoch = EPOCH
        self.link.follow(VIEW)
        for pid in boots:
            self.link.adopt(Hello(head(pid, ADOPTED, sent=1_000_000), OWN, bytes(8), bytes(8), (), None, None))
        self.usual = 0  # so many were

    def receive(self) -> Sequence[bytes]:
        taken, self.waiting = self.waiting, []
        return taken

    def hear(self, datagrams: Sequence[bytes]) -> list[Any]:
        """What is let through of them."""
        self.waiting = datagrams
        found = self.link.receive()
        self.usual += sum(len(m.rows) for m in found if isinstance(m, Usuals))
        return [said for message in found for said in plain(message)]

    def counted(self) -> Any:
        """Of each robot alone, so that the order among several makes no difference."""
        lessons = sorted(self.fleet_clock.lessons, key=lambda lesson: lesson[0])
        return lessons, self.link.rejected, self.link.strangers, self.told

    def columns(self) -> dict[str, bytes]:
        found = {**self.link.sessions.columns(), **self.metrics.columns()}
        return {name: column.tobytes() for name, column in found.items()}


class Ears:
    """Both; what they do must be the same."""

    def __init__(self, key: bytes | None = KEY) -> None:
        self.native, self.plain = Ear(True, key), Ear(False, key)
        assert self.native.link._gate is not None and self.plain.link._gate is None

    def move(self, seconds: float) -> None:
        self.native.clock.time += seconds
        self.plain.clock.time += seconds

    def hear(self, *datagrams: bytes) -> list[Any]:
        found = self.native.hear(datagrams)
        assert found == self.plain.hear(datagrams)
        native, plain = self.native.counted(), self.plain.counted()
        malformed = "malformed" in self.native.link.rejected  # of a usual one the gate has learned before that is found
        assert native[malformed:] == plain[malformed:]
        return found

    def same(self) -> None:
        """All columns, byte by byte."""
        assert self.native.columns() == self.plain.columns()


def sealed(message: Message) -> bytes:
    return wire.encode(message, KEY)
