"""Authenticated datagrams between one robot and its peers: who may speak, replays, clock stamps, what is counted.

Nothing received raises, blocks or changes any state before it was found genuine, of this format, application,
interface and program, fresh, and of this mission; what is not is dropped and counted by its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from koordgen.runtime import gate
from koordgen.runtime.clock import Clock, FleetClock
from koordgen.runtime.gate import Gate, Lesson, Usual
from koordgen.runtime.metrics import Metrics
from koordgen.runtime.pieces import cut, lacking
from koordgen.runtime.program import Program
from koordgen.runtime.seal import MAC_SIZE, MEMORY, seal, unseal_all
from koordgen.runtime.sessions import Sessions
from koordgen.runtime.settings import Settings
from koordgen.runtime.transport import Transport
from koordgen.runtime.wire import (
    LIMIT,
    MAX_ECHOES,
    MOST_PAYLOAD,
    Closing,
    Echo,
    Head,
    Hello,
    Message,
    Partly,
    Piece,
    Round,
    View,
    encode,
    encoder,
    opened,
    overhead,
    pack,
)

REFERENCE_EVERY, OTHERS_EVERY = 0.05, 1.0  # seconds between exchanges that the clock learns from
ECHOES_A_LESSON = 2  # so many echoes are sent for each of them: some are lost
MOST_DATAGRAMS = 4  # to one peer for one catch-up
MOST_PIECES_AT_ONCE = 16
NOTHING: Mapping[int, Partly] = MappingProxyType({})

_REASONS = {gate.FALSE: "not authentic", gate.TOO_LONG: "oversize", gate.REPLAYED: "replayed"}

Fields = tuple[int, int, int, int, bool, tuple[int, ...]]  # of Round, between its head and its closings


class Usuals(NamedTuple):
    """Usual datagrams as they came one after the other, when the view of this number was the present one."""

    view: int
    rows: list[Usual]


Heard = Message | Usuals


class Link:
    """`report` gets what the people at the robots must know, once for each peer. `native`: with the gate, where it can
    be compiled."""

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
        self._key = key
        found = gate.library() if native else None
        columns = {**self.sessions.columns(), **metrics.columns()}
        self._gate = None if found is None else Gate(found, len(settings.peers), self.pid, columns, key, MEMORY)
        self._view = -1  # the present one's number
        self._epoch = b""
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._reference = 0
        self._report = report
        self._reported: set[tuple[int, str]] = set()
        self._sequence = 0
        self._echoed: dict[int, float] = {}  # when each peer was last sent an echo
        self._next_echo = -math.inf  # none is due to anyone before
        self.room = LIMIT - overhead(len(settings.peers))  # bytes for closings or a piece in one datagram

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Closing | None,
              start: int | None) -> None:  # fmt: skip
        self._send([to], Hello(self._head([to], 0.0), to, challenge, answer, holds, init, start))

    def say(self, to: Collection[int], kind: type[Message], *fields: Any) -> None:
        """One message of this kind, with its fields behind the head."""
        if to:
            self._send(to, kind(self._head(to), *fields))

    def round(self, to: Collection[int], word: Fields, closings: Sequence[Closing],
              partly: Mapping[int, Partly] = NOTHING) -> None:  # fmt: skip
        """A word with closings: one datagram, or as few as they fit in, at most MOST_DATAGRAMS; the rest waits to be
        asked for. Of a closing that is longer than a datagram go those pieces that are not in `partly`, by author."""
        if not to:
            return
        head = self._head(to)
        payload = pack(Round(head, *word, tuple(closings)))
        if len(payload) <= MOST_PAYLOAD:
            self._transport.send(list(to), seal(self._key, MEMORY, payload))
            return
        self._divided(to, head, word, closings, partly)

    def _divided(self, to: Collection[int], head: Head, word: Fields, closings: Sequence[Closing],
                 partly: Mapping[int, Partly]) -> None:  # fmt: skip
        """The same for what is too long for one datagram."""
        small = []
        for closing in closings:
            if len(closing.writes) and len(blob := encoder.encode(closing)) > self.room:
                self._pieces(to, closing, blob, partly.get(closing.author))
            else:
                small.append(closing)
        for index, batch in enumerate(self._batches(small)):
            self._send(to, Round(self._head(to) if index else head, *word, batch))

    @property
    def epoch(self) -> bytes:
        """The mission's; empty before there is one."""
        return self._epoch

    @epoch.setter
    def epoch(self, epoch: bytes) -> None:
        self._epoch = epoch
        self._introduce(self.sessions.boots)

    def follow(self, view: View) -> None:
        """From now on this view is the present one."""
        self._view = view.number
        if self._gate is not None:
            self._gate.follow(view.number, view.members)

    def receive(self) -> list[Heard]:
        """What arrived and may be listened to. A Hello of a boot that was not adopted is among it: `joining` judges."""
        datagrams = self._transport.receive()
        if not datagrams:
            return []
        local = self._clock.now()  # all of them have arrived by now
        fleet = self._fleet_clock.read(local) if self._fleet_clock.known else None
        if self._gate is None:
            return self._heard(zip(datagrams, unseal_all(self._key, MEMORY, datagrams), strict=True), local, fleet)
        usual, verdicts = self._gate.take(datagrams, local, fleet)
        for row in usual or ():
            if row.lesson is not None:
                self._learn(row.sender, row.lesson, local)
        if not verdicts and usual:
            return [Usuals(self._view, usual)]
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
            if verdict in _REASONS:
                self.reject(_REASONS[verdict])
                continue
            message = opened(len(datagram), datagram[:-MAC_SIZE])
            if isinstance(message, str):
                self.reject(message)
            elif verdict == gate.USUAL or self._admit(message, local, fleet):
                found.append(message)
                run = []
        return found

    def adopt(self, hello: Hello) -> None:
        """From now on this boot of the peer is the one that counts."""
        head, now = hello.head, _microseconds(self._clock.now())
        self.sessions.adopt(head.pid, head.boot, head.sequence, head.sent, now)
        self._introduce([head.pid])

    def is_adopted(self, hello: Hello) -> bool:
        return self.sessions.boots.get(hello.head.pid) == hello.head.boot

    def _introduce(self, pids: Iterable[int]) -> None:
        """Let the gate know these peers in this mission."""
        if self._gate is None:
            return
        head = Head(self._application, self._interface, self._program, self.pid, self.boot, self.epoch, 0, 0, None, ())
        common = pack(Round(head, 0, 0, 0, 0, False, (), ()))
        until = common.index(encoder.encode(self.boot)) - 1  # the pid is one byte
        self._gate.begin(common[:until] if self.epoch else b"")
        for pid in pids:
            self._gate.adopt(pid, encoder.encode(self.sessions.boots[pid]) + encoder.encode(self.epoch))

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
                f"robot {self._names[pid]} runs {what} ({theirs.hex()}, here {ours.hex()}) and is not listened to: "
                "build all bundles from the same source and fleet file"
            )
        return what

    def _stamps(self, message: Message, local: float, fleet: float | None) -> None:
        """Learn from a datagram that was here at `local`, which is `fleet` by the fleet's clock."""
        head, sessions = message.head, self.sessions
        pid, sent = head.pid, head.sent
        if sent > sessions.sent[pid]:
            sessions.sent[pid], sessions.arrived[pid] = sent, _microseconds(local)
        for echo in head.echoes:
            if echo.pid == self.pid:
                self._learn(pid, Lesson(echo.sent, echo.received, sent, head.fleet), local)
        if isinstance(message, Round) and message.round > sessions.round[pid]:
            before, sessions.round[pid] = sessions.round[pid], message.round
            delay = None if fleet is None or head.fleet is None else fleet - (sent + head.fleet) / 1e6
            self.metrics.heard(pid, message.round - before if before else 1, delay, local)

    def _learn(self, pid: int, lesson: Lesson, local: float) -> None:
        """From what this peer heard of us and answered, here at `local`."""
        clock, timed = self._fleet_clock, self.sessions.timed
        if local - timed[pid] < (REFERENCE_EVERY if pid == clock.reference else OTHERS_EVERY):
            return
        timed[pid] = local
        now, fleet = _microseconds(local) / 1e6, None if lesson.fleet is None else lesson.fleet / 1e6
        clock.take(pid, lesson.sent / 1e6, lesson.received / 1e6, lesson.answered / 1e6, now, fleet)

    def _head(self, to: Collection[int], every: float | None = None) -> Head:
        self._sequence += 1
        now = self._clock.now()
        offset = self._fleet_clock.offset(now)
        echoes = () if every is None and now < self._next_echo else self._echoes(to, now, every)
        return Head(
            self._application,
            self._interface,
            self._program,
            self.pid,
            self.boot,
            self.epoch,
            self._sequence,
            _microseconds(now),
            None if offset is None else round(offset * 1e6),
            echoes,
        )

    def _echoes(self, to: Collection[int], now: float, every: float | None) -> tuple[Echo, ...]:
        """Of those whose turn it is: as often as they learn from it, which from the reference they do most."""
        if every is None:
            reference = self._fleet_clock.reference == self.pid
            every = (REFERENCE_EVERY if reference else OTHERS_EVERY) / ECHOES_A_LESSON
        sessions, echoed = self.sessions, self._echoed
        due = [p for p in to if now - echoed.get(p, -math.inf) >= every and p in sessions.boots]
        if len(due) <= MAX_ECHOES and len(to) == len(sessions.boots):  # nobody is left
            self._next_echo = now + every / ECHOES_A_LESSON
        if len(due) > MAX_ECHOES:
            due = sorted(due, key=lambda p: (echoed.get(p, -math.inf), p))[:MAX_ECHOES]
        echoed.update(dict.fromkeys(due, now))
        return tuple([Echo(p, sent, sessions.arrived[p]) for p in due if (sent := sessions.sent[p]) >= 0])

    def _pieces(self, to: Collection[int], closing: Closing, blob: bytes, known: Partly | None) -> None:
        pieces = cut(blob, self.room)
        mask = known.mask if known is not None and known.digest == pieces[0][0] else b""
        for index in lacking(len(pieces), mask)[:MOST_PIECES_AT_ONCE]:
            place = closing.author, closing.incarnation, closing.round
            digest, _, count, data = pieces[index]
            self._send(to, Piece(self._head(to), *place, digest, index, count, data))

    def _batches(self, closings: Sequence[Closing]) -> list[tuple[Closing, ...]]:
        if len(closings) < 2:
            return [tuple(closings)]
        batches: list[tuple[Closing, ...]] = []
        batch: list[Closing] = []
        room = self.room
        for closing in closings:
            length = len(encoder.encode(closing))
            if batch and length > room:
                batches.append(tuple(batch))
                batch, room = [], self.room
            batch.append(closing)
            room -= length
        return [*batches, tuple(batch)][:MOST_DATAGRAMS]

    def _send(self, to: Collection[int], message: Message) -> None:
        self._transport.send(list(to), encode(message, self._key))


def _microseconds(seconds: float) -> int:
    return round(seconds * 1e6) if seconds > 0.0 else 0
