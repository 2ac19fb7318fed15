"""Link of one robot to its peers: admission of datagrams, replay protection, time stamps, statistics.

No datagram can raise an exception or block. A datagram is admitted only if it is authentic, well formed, new, and of
this application, interface, program and mission. Every other datagram is dropped and counted by its reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from typing import NamedTuple

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.codec import decoder
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.metrics import Arrival, Metrics
from koordgen.runtime.net.sender import REFERENCE_EVERY, MessageSender, Sending, microseconds, others_every
from koordgen.runtime.net.sessions import PeerSession
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import Head, Hello, Message, ReplicaMessage, RoundMessage
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.clock import Clock


class _Exchange(NamedTuple):
    """Time stamps of a datagram from this robot to a peer and of the peer's answer, in microseconds.

    answered: time at which the peer sent the answer, on the peer's clock.
    sent: time at which this robot sent its datagram, on this robot's clock.
    received: time at which the peer received that datagram, on the peer's clock.
    fleet: fleet time minus the peer's clock; None if the peer does not know the fleet time."""

    answered: int
    sent: int
    received: int
    fleet: int | None


class Link:
    """Receive path (`receive`) and send path (`sender`) of one robot.

    report: function that reports a text to the operator; called once for each peer and kind of mismatch.
    outlet: function that returns a sender in front of the robot's own; None: messages leave at once.
    sessions: pid -> session of a peer whose boot was adopted.
    strangers: robots of this mission that sent messages from a boot that was not adopted."""

    def __init__(
        self,
        program: Program,
        settings: Settings,
        key: bytes | None,
        transport: Transport,
        clock: Clock,
        fleet_clock: FleetClock,
        boot: bytes,
        report: Callable[[str], None],
        metrics: Metrics,
        outlet: Callable[[Sending], Sending] | None = None,
    ) -> None:
        self.metrics = metrics
        self.pid = settings.pid
        self.boot = boot
        self.rejected: dict[str, int] = {}
        self.sessions: dict[int, PeerSession] = {}
        self.strangers: set[int] = set()
        self._hellos: list[Hello] = []
        self._names = [p.name for p in settings.peers]
        self._application = settings.application_id
        self._interface = bytes.fromhex(program.interface_hash)
        self._program = bytes.fromhex(program.program_hash)
        self._release = bytes.fromhex(settings.release)
        self._mission: tuple[int, bytes, bytes, bytes] | None = None  # in the head of every message but Hello
        self._decode = decoder(key)
        self._others_every = others_every(len(settings.peers))
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._report = report
        self._reported: set[tuple[int, str]] = set()
        own = MessageSender(program, settings, key, transport, clock, fleet_clock, boot, self.sessions)
        self._stamps: Container[int] = own.stamps
        self.sender: Sending = own if outlet is None else outlet(own)

    @property
    def epoch(self) -> bytes:
        """Id of the mission: part of all sent and accepted messages; empty before the mission is known."""
        return self.sender.epoch

    @epoch.setter
    def epoch(self, epoch: bytes) -> None:
        self.sender.epoch = epoch
        self._mission = (self._application, self._interface, self._program, epoch) if epoch else None

    def keep_time(self, reference: int, now: float) -> None:
        """Follow the fleet time of robot `reference`. Its next message with an echo updates the clock at once."""
        if reference != self._fleet_clock.reference:
            self._fleet_clock.follow(reference, now)
            if reference in self.sessions:
                self.sessions[reference].due = -math.inf

    def receive(self) -> list[ReplicaMessage]:
        """Return the admitted messages for the replica, in the order of arrival.

        Hello messages are kept for `pop_hellos`."""
        datagrams = self._transport.receive()
        return self._admitted(datagrams) if datagrams else []

    def _admitted(self, datagrams: Sequence[bytes]) -> list[ReplicaMessage]:
        """Return the messages of admitted datagrams. Update replay windows, time stamps and statistics."""
        local = self._clock.now()  # upper bound of the datagrams' arrival times
        fleet = self._fleet_clock.read(local) if self._fleet_clock.known else None
        arrived, decode, sessions, mission = microseconds(local), self._decode, self.sessions, self._mission
        admitted: list[ReplicaMessage] = []
        arrivals: list[Arrival] = []
        exchanges: dict[int, _Exchange] = {}
        for datagram in datagrams:
            message = decode(datagram)
            if isinstance(message, str):
                self.reject(message)
                continue
            head = message.head
            session = sessions.get(head.pid)
            if session is not None and session.boot != head.boot:
                session = None
            ours = (head.application, head.interface, head.program, head.epoch) == mission
            if session is None or not ours or isinstance(message, Hello):
                reason = self._refusal(message, session is not None)
                if reason is not None:
                    self.reject(reason)
                    continue
            if session is not None and not session.accept(head.sequence):
                self.reject("replayed")
                continue
            if isinstance(message, Hello):
                self._hellos.append(message)
            else:
                admitted.append(message)
            if session is None:
                continue
            if head.sent > session.sent:
                session.sent, session.arrived = head.sent, arrived
            if head.echoes and local >= session.due and (exchange := self._exchange(head)) is not None:
                exchanges[head.pid] = max(exchange, exchanges.get(head.pid, exchange), key=_order)
            if isinstance(message, RoundMessage) and message.round > session.round:
                ahead = message.round - session.round if session.round else 1
                session.round = message.round
                delay = None if fleet is None or head.fleet is None else fleet - (head.sent + head.fleet) / 1e6
                arrivals.append((head.pid, ahead, delay))
        self.metrics.heard(arrivals, local)
        if exchanges:
            self._learn(exchanges, local)
        return admitted

    def pop_hellos(self) -> list[Hello]:
        """Return the Hello messages received since the last call, also of processes that are not adopted."""
        hellos, self._hellos = self._hellos, []
        return hellos

    def adopt(self, hello: Hello) -> None:
        """Begin a session with the boot that sent a Hello. Messages of the peer's earlier boot are refused."""
        head = hello.head
        self.sessions[head.pid] = PeerSession(head.boot, head.sequence, head.sent, microseconds(self._clock.now()))

    def is_adopted(self, hello: Hello) -> bool:
        session = self.sessions.get(hello.head.pid)
        return session is not None and session.boot == hello.head.boot

    def reject(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def _refusal(self, message: Message, adopted: bool) -> str | None:
        """Return the reason why a message is refused, or None. The sequence number is not checked.

        `adopted`: the boot that sent the message is adopted."""
        head = message.head
        reason = self._foreign(head)
        if reason is not None:
            return reason
        if isinstance(message, Hello):
            if message.release != self._release:
                return self._report_mismatch(head.pid, "another release", message.release, self._release)
            return None if message.to == self.pid else "for another robot"
        if not self.epoch or head.epoch != self.epoch:
            return "another mission"
        if not adopted:
            self.strangers.add(head.pid)
            return "another boot"
        return None

    def _foreign(self, head: Head) -> str | None:
        """Return why a head is not from a peer with this application, interface and program, or None."""
        if head.application != self._application:
            return "another application"
        if head.pid >= len(self._names) or head.pid == self.pid:
            return "not a peer"
        if head.interface != self._interface:
            return self._report_mismatch(head.pid, "another interface", head.interface, self._interface)
        if head.program != self._program:
            return self._report_mismatch(head.pid, "another program", head.program, self._program)
        return None

    def _report_mismatch(self, pid: int, what: str, theirs: bytes, ours: bytes) -> str:
        if (pid, what) not in self._reported:
            self._reported.add((pid, what))
            self._report(
                f"robot {self._names[pid]} runs {what} ({theirs.hex() or 'none'}, here {ours.hex() or 'none'}) "
                "and is ignored: build all bundles from the same source and fleet file"
            )
        return what

    def _exchange(self, head: Head) -> _Exchange | None:
        """Return the exchange that a head completes with an echo of this process's datagram, or None.

        A peer that has not adopted this boot yet still echoes an earlier process, which may have had another clock."""
        for echo in head.echoes:
            if echo.pid == self.pid and echo.sent in self._stamps:
                return _Exchange(head.sent, echo.sent, echo.received, head.fleet)
        return None

    def _learn(self, exchanges: dict[int, _Exchange], local: float) -> None:
        """Pass an exchange with each peer to the fleet clock. `local`: local time (s) of their completion."""
        clock = self._fleet_clock
        for pid, (answered, sent, received, fleet) in exchanges.items():
            self.sessions[pid].due = local + (REFERENCE_EVERY if pid == clock.reference else self._others_every)
            clock.add(pid, sent / 1e6, received / 1e6, answered / 1e6, local, None if fleet is None else fleet / 1e6)


def _order(exchange: _Exchange) -> tuple[int, int, int]:
    """Return a sort key by which the exchange that the peer answered last is the greatest."""
    return exchange.answered, exchange.sent, exchange.received
