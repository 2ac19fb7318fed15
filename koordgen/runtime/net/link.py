"""Authenticated datagrams between one robot and its peers: who may speak, replays, clock stamps, what is counted.

Nothing received raises, blocks or changes any state before it was found genuine, of this format, application,
interface and program, fresh, and of this mission; what is not is dropped and counted by its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net import gate
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.gate import Gate, Lesson, Usual
from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.seal import MAC_SIZE, MEMORY, unseal_all
from koordgen.runtime.net.sessions import Sessions
from koordgen.runtime.net.speech import REFERENCE_EVERY, Speech, microseconds, others_every
from koordgen.runtime.net.transport import Coupled, Transport
from koordgen.runtime.net.wire import Head, Hello, Message, Round, View, encoder, opened, pack
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.clock import Clock, SystemClock

_REASONS = {gate.FALSE: "not authentic", gate.TOO_LONG: "oversize", gate.REPLAYED: "replayed"}


class Usuals(NamedTuple):
    """Usual datagrams as they came one after the other, when the view of this number was the present one."""

    view: int
    rows: list[Usual]


Heard = Message | Usuals


def as_usual(word: Round) -> Usuals:
    """The same in the form in which the gate hands on many; its emergency is not in it."""
    row = Usual(word.head.pid, word.round, word.applied, word.settled, word.held, word.closings)
    return Usuals(word.view, [row])


class Link:
    """`report` gets what the people at the robots must know, once for each peer. `speech` is the way back to them.
    `native`: with the gate, where it can be compiled."""

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
        native: bool = True,
    ) -> None:
        self.metrics = metrics
        self.pid = settings.pid
        self.boot = boot
        self.rejected: dict[str, int] = {}
        self.sessions = Sessions(len(settings.peers))
        self.strangers: set[int] = set()  # robots of this mission of whom another boot speaks than the one adopted
        self._names = [p.name for p in settings.peers]
        self._application = settings.application_id
        self._interface = bytes.fromhex(program.interface_hash)
        self._program = bytes.fromhex(program.program_hash)
        self._release = bytes.fromhex(settings.release)
        self._key = key
        found = gate.COMPILED.library() if native else None
        columns = {**self.sessions.columns(), **metrics.columns()}
        self._gate = None if found is None else Gate(found, len(settings.peers), self.pid, columns, key, MEMORY)
        self._view = -1  # the present one's number
        self._lessons: list[Lesson] = []  # of datagrams that Python looks at
        self._waiting = self.sessions.lessons  # of those that the gate looks at
        self._others_every = others_every(len(settings.peers))
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._report = report
        self._reported: set[tuple[int, str]] = set()
        self.speech = Speech(
            program, settings, key, transport, clock, fleet_clock, boot, self.sessions, self._gate, self._couple()
        )

    def _couple(self) -> Coupled | None:
        """Let the gate and what the transport waits and sends with work together, where both are compiled."""
        gate, transport = self._gate, self._transport
        if gate is None or not isinstance(transport, Coupled) or (courier := transport.courier) is None:
            return None
        gate.couple(courier, isinstance(self._clock, SystemClock))
        return transport

    @property
    def epoch(self) -> bytes:
        """The mission that both ways belong to; empty: none yet."""
        return self.speech.epoch

    @epoch.setter
    def epoch(self, epoch: bytes) -> None:
        self.speech.epoch = epoch
        self._introduce(self.sessions.boots)

    def follow(self, view: View) -> None:
        """From now on this view is the present one."""
        self._view = view.number
        if self._gate is not None:
            self._gate.follow(view.number)

    def keep_time(self, reference: int, now: float) -> None:
        """From now on the fleet's time is this robot's, and most is learned from it."""
        if reference != self._fleet_clock.reference:
            self._fleet_clock.follow(reference, now)
            self.sessions.due[reference] = -math.inf

    def attach(self, ledger: Ledger | None) -> None:
        """From now on words of the present view that need no thought are noted there, and `receive` does not tell."""
        if self._gate is not None:
            self._gate.attach(ledger)

    def receive(self) -> list[Heard]:
        """What arrived and may be listened to. A Hello of a boot that was not adopted is among it: `joining` judges."""
        datagrams, waiting = self._transport.receive(), self._waiting
        found = self._judged(datagrams) if datagrams else []
        if self._lessons or waiting[0]:
            self._learn()
        return found

    def _judged(self, datagrams: Sequence[bytes]) -> list[Heard]:
        local = self._clock.now()  # all of them have arrived by now
        fleet = self._fleet_clock.read(local) if self._fleet_clock.known else None
        if self._gate is None:
            return self._heard(zip(datagrams, unseal_all(self._key, MEMORY, datagrams), strict=True), local, fleet)
        usual, verdicts = self._gate.take(datagrams, local, fleet)
        if not verdicts:
            return [Usuals(self._view, usual)] if usual else []
        return self._sorted(datagrams, usual, verdicts, local, fleet)

    def _heard(self, datagrams: Iterable[tuple[bytes, bytes | None]], local: float, fleet: float | None) -> list[Heard]:
        """Of datagrams with their payloads those that may be listened to."""
        accepted: list[Heard] = []
        for datagram, payload in datagrams:
            message = opened(len(datagram), payload)
            if isinstance(message, str):
                self.reject(message)
            elif self._admit(message, local, fleet):
                accepted.append(message)
        return accepted

    def _sorted(self, datagrams: Sequence[bytes], usual: list[Usual] | None, verdicts: Sequence[int], local: float,
                fleet: float | None) -> list[Heard]:  # fmt: skip
        """The same of what the gate has judged, as it arrived."""
        found: list[Heard] = []
        run: list[Usual] = []
        rows = iter(usual or ())
        for datagram, verdict in zip(datagrams, [v for v in verdicts if v != gate.NOTHING], strict=True):
            if verdict == gate.USUAL and usual is not None:
                if not run:
                    found.append(Usuals(self._view, run))
                run.append(next(rows))
                continue
            if verdict == gate.NOTED:
                continue
            if verdict in _REASONS:
                self.reject(_REASONS[verdict])
                continue
            message = opened(len(datagram), datagram[:-MAC_SIZE])
            if isinstance(message, str):
                self.reject(message)
            elif verdict == gate.USUAL:  # the gate has counted it
                found.append(message)
            elif self._admit(message, local, fleet):
                found.append(message)
                run = []
        return found

    def adopt(self, hello: Hello) -> None:
        """From now on this boot of the peer is the one that counts."""
        head, now = hello.head, microseconds(self._clock.now())
        self.sessions.adopt(head.pid, head.boot, head.sequence, head.sent, now)
        self._introduce([head.pid])

    def is_adopted(self, hello: Hello) -> bool:
        return self.sessions.boots.get(hello.head.pid) == hello.head.boot

    def _introduce(self, pids: Iterable[int]) -> None:
        """Let the gate know these peers in this mission."""
        if self._gate is None:
            return
        head = Head(self._application, self._interface, self._program, self.pid, self.boot, self.epoch, 0, 0, None, ())
        common, epoch = pack(Round(head, 0, 0, 0, 0, False, (), ())), encoder.encode(self.epoch)
        tail = encoder.encode(self.boot) + epoch
        until = common.index(tail) - 1  # the pid is one byte
        self._gate.begin(common[:until] if self.epoch else b"")
        self._gate.introduce(common[: until + 1 + len(tail)] if self.epoch else b"")
        for pid in pids:
            self._gate.adopt(pid, encoder.encode(self.sessions.boots[pid]) + epoch)

    def reject(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def _admit(self, message: Message, local: float, fleet: float | None) -> bool:
        """Whether it may be listened to; if so, its stamps have been learned from."""
        head = message.head
        adopted = self.sessions.boots.get(head.pid) == head.boot
        reason = None if adopted and self._is_usual(message) else self._strange(message, adopted)
        if reason is None and adopted:
            if self.sessions.fresh(head.pid, head.sequence):
                self._stamps(message, local, fleet)
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

    def _strange(self, message: Message, adopted: bool) -> str | None:
        """Why it is not listened to; `adopted`: its boot is."""
        head = message.head
        reason = self._foreign(head)
        if reason is not None:
            return reason
        if isinstance(message, Hello):
            if message.release != self._release:
                return self._tell(head.pid, "another release", message.release, self._release)
            return None if message.to == self.pid else "for another robot"
        if not self.epoch or head.epoch != self.epoch:
            return "another mission"
        if not adopted:
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
                f"robot {self._names[pid]} runs {what} ({theirs.hex() or 'none'}, here {ours.hex() or 'none'}) "
                "and is not listened to: build all bundles from the same source and fleet file"
            )
        return what

    def _stamps(self, message: Message, local: float, fleet: float | None) -> None:
        """Learn from a datagram that was here at `local`, which is `fleet` by the fleet's clock."""
        head, sessions = message.head, self.sessions
        pid, sent = head.pid, head.sent
        if sent > sessions.sent[pid]:
            sessions.sent[pid], sessions.arrived[pid] = sent, microseconds(local)
        self._exchanges(message, local)
        if isinstance(message, Round) and message.round > sessions.round[pid]:
            before, sessions.round[pid] = sessions.round[pid], message.round
            delay = None if fleet is None or head.fleet is None else fleet - (sent + head.fleet) / 1e6
            self.metrics.heard(pid, message.round - before if before else 1, delay, local)

    def _exchanges(self, message: Message, local: float) -> None:
        """Learn from what a datagram echoes of ours."""
        head = message.head
        echo = next((each for each in head.echoes if each.pid == self.pid), None)
        if echo is not None and local >= self.sessions.due[head.pid]:
            fleet, known = (0, 0) if head.fleet is None else (head.fleet, 1)
            stamps = head.sent, echo.sent, echo.received
            self._lessons.append(Lesson(head.pid, *stamps, fleet, known, microseconds(local)))

    def _learn(self) -> None:
        """From what was echoed in all that has come: of each peer from what it said last, whatever came last."""
        clock, lessons = (
            self._fleet_clock,
            self._lessons if self._gate is None else [*self._gate.lessons(), *self._lessons],
        )
        self._lessons = []
        latest = lessons if len(lessons) < 2 else {each.pid: each for each in sorted(lessons)}.values()
        for pid, answered, sent, received, fleet, known, arrived in latest:
            now = arrived / 1e6
            self.sessions.due[pid] = now + (REFERENCE_EVERY if pid == clock.reference else self._others_every)
            clock.take(pid, sent / 1e6, received / 1e6, answered / 1e6, now, fleet / 1e6 if known else None)
