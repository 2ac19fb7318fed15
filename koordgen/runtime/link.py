"""Authenticated datagrams between one robot and its peers: who may speak, replays, clock stamps, what is counted.

Nothing received raises, blocks or changes any state before it was found genuine, of this format, application,
interface and program, fresh, and of this mission; what is not is dropped and counted by its reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from koordgen.runtime.clock import Clock, FleetClock
from koordgen.runtime.metrics import Metrics
from koordgen.runtime.program import Program
from koordgen.runtime.seal import MEMORY, unseal_all
from koordgen.runtime.settings import Settings
from koordgen.runtime.speech import OTHERS_EVERY, REFERENCE_EVERY, Speech, microseconds
from koordgen.runtime.transport import Transport
from koordgen.runtime.wire import Head, Hello, Message, Round, opened

REPLAY_WINDOW = 1024  # datagrams that may arrive out of order
_WINDOW_MASK = (1 << REPLAY_WINDOW) - 1


@dataclass(slots=True)
class Session:
    """One boot of a peer: the newest sequence number, a bit for each of the last ones that arrived, and when the newest
    datagram was `sent`, -1 for none, and `arrived` here (microseconds)."""

    boot: bytes
    newest: int = 0
    seen: int = 0
    sent: int = -1
    arrived: int = 0
    timed: float = float("-inf")  # when the clock last learned from it
    round: int = 0  # the latest in which it said to be

    def fresh(self, sequence: int) -> bool:
        """Take a sequence number; False when it was taken before or is older than the window."""
        ahead = sequence - self.newest
        if ahead > 0:
            self.seen = 1 if ahead >= REPLAY_WINDOW else (self.seen << ahead | 1) & _WINDOW_MASK
            self.newest = sequence
            return True
        if -ahead >= REPLAY_WINDOW or self.seen >> -ahead & 1:
            return False
        self.seen |= 1 << -ahead
        return True


class Link:
    """`report` gets what the people at the robots must know, once for each peer. `speech` is the way back to them."""

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
    ) -> None:
        self.metrics = metrics
        self.pid = settings.pid
        self.boot = boot
        self.rejected: dict[str, int] = {}
        self.sessions: dict[int, Session] = {}
        self.strangers: set[int] = set()  # robots of this mission of whom another boot speaks than the one adopted
        self._names = [p.name for p in settings.peers]
        self._application = settings.application_id
        self._interface = bytes.fromhex(program.interface_hash)
        self._program = bytes.fromhex(program.program_hash)
        self._key = key
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._reference = 0
        self._report = report
        self._reported: set[tuple[int, str]] = set()
        self.speech = Speech(program, settings, key, transport, clock, fleet_clock, boot, self.sessions)

    @property
    def epoch(self) -> bytes:
        """The mission that both ways belong to; empty: none yet."""
        return self.speech.epoch

    @epoch.setter
    def epoch(self, epoch: bytes) -> None:
        self.speech.epoch = epoch

    def receive(self) -> list[Message]:
        """What arrived and may be listened to. A Hello of a boot that was not adopted is among it: `joining` judges."""
        datagrams = self._transport.receive()
        if not datagrams:
            return []
        local = self._clock.now()  # all of them have arrived by now
        stamp, fleet = microseconds(local), self._fleet_clock.read(local) if self._fleet_clock.known else None
        accepted = []
        for datagram, payload in zip(datagrams, unseal_all(self._key, MEMORY, datagrams), strict=True):
            message = opened(len(datagram), payload)
            if isinstance(message, str):
                self.reject(message)
            elif self._admit(message, local, stamp, fleet):
                accepted.append(message)
        return accepted

    def adopt(self, hello: Hello) -> None:
        """From now on this boot of the peer is the one that counts."""
        head, now = hello.head, microseconds(self._clock.now())
        # What it sent before is old news, perhaps recorded.
        self.sessions[head.pid] = Session(head.boot, head.sequence, _WINDOW_MASK, head.sent, now)

    def is_adopted(self, hello: Hello) -> bool:
        session = self.sessions.get(hello.head.pid)
        return session is not None and session.boot == hello.head.boot

    def reject(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def _admit(self, message: Message, local: float, stamp: int, fleet: float | None) -> bool:
        """Whether it may be listened to; if so, its stamps have been learned from."""
        head = message.head
        session = self.sessions.get(head.pid)
        if session is not None and session.boot != head.boot:
            session = None
        reason = None if session is not None and self._is_usual(message) else self._strange(message, session)
        if reason is None and session is not None:
            if session.fresh(head.sequence):
                self._stamps(session, message, local, stamp, fleet)
            else:
                reason = "replayed"
        if reason is None:
            return True
        self.reject(reason)
        return False

    def _is_usual(self, message: Message) -> bool:
        """Whether it is, if its boot is adopted, what nearly all datagrams are; `_strange` finds nothing wrong with
        these."""
        head, epoch = message.head, self.epoch
        ours = head.program == self._program and head.interface == self._interface
        same = ours and head.application == self._application and head.epoch == epoch
        return same and epoch != b"" and not isinstance(message, Hello)

    def _strange(self, message: Message, session: Session | None) -> str | None:
        """Why it is not listened to; `session` is that of its boot, if that is adopted."""
        head = message.head
        reason = self._foreign(head)
        if reason is not None:
            return reason
        if isinstance(message, Hello):
            return None if message.to == self.pid else "for another robot"
        if not self.epoch or head.epoch != self.epoch:
            return "another mission"
        if session is None:
            self.strangers.add(head.pid)
            return "another boot"
        return None

    def _foreign(self, head: Head) -> str | None:
        if head.application != self._application:
            return "another application"
        if head.pid >= len(self._names) or head.pid == self.pid:
            return "not a peer"
        if head.interface != self._interface:
            return self._tell(head.pid, "another interface", head.interface, self._interface)
        if head.program != self._program:
            return self._tell(head.pid, "another program", head.program, self._program)
        return None

    def _tell(self, pid: int, what: str, theirs: bytes, ours: bytes) -> str:
        if (pid, what) not in self._reported:
            self._reported.add((pid, what))
            self._report(
                f"robot {self._names[pid]} runs {what} ({theirs.hex()}, here {ours.hex()}) and is not listened to: "
                "build all bundles from the same source and fleet file"
            )
        return what

    def _stamps(self, session: Session, message: Message, local: float, stamp: int, fleet: float | None) -> None:
        """Learn from a datagram that was here at `local`, which is `stamp` in microseconds and `fleet` by the fleet's
        clock."""
        head = message.head
        sent = head.sent
        if sent > session.sent:
            session.sent, session.arrived = sent, stamp
        if head.echoes:
            self._learn(session, head, local, stamp)
        if isinstance(message, Round) and message.round > session.round:
            ahead = message.round - session.round if session.round else 1
            session.round = message.round
            delay = None if fleet is None or head.fleet is None else fleet - (sent + head.fleet) / 1e6
            self.metrics.heard(head.pid, ahead, delay, local)

    def _learn(self, session: Session, head: Head, local: float, stamp: int) -> None:
        clock = self._fleet_clock
        if local - session.timed < (REFERENCE_EVERY if head.pid == clock.reference else OTHERS_EVERY):
            return
        now, fleet = stamp / 1e6, None if head.fleet is None else head.fleet / 1e6
        for echo in head.echoes:
            if echo.pid == self.pid:
                session.timed = local
                clock.take(head.pid, echo.sent / 1e6, echo.received / 1e6, head.sent / 1e6, now, fleet)
