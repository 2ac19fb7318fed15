"""What one robot says to its peers: the head of every datagram, words with closings in as few datagrams as they fit in,
and closings that are longer than one in pieces."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.gate import NOT_STAMPED, Fields, Gate, Stamped
from koordgen.runtime.net.ledger import Ledger
from koordgen.runtime.net.pieces import cut, lacking
from koordgen.runtime.net.seal import MEMORY, seal
from koordgen.runtime.net.sessions import Sessions
from koordgen.runtime.net.transport import Coupled, Transport
from koordgen.runtime.net.wire import (
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
    encode,
    encoder,
    overhead,
    pack,
)
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.clock import Clock

REFERENCE_EVERY, OTHERS_EVERY = 0.1, 1.0  # seconds between exchanges that the clock learns from
OTHERS = 16  # clocks of others that it learns from in that time: of more each comes more rarely
ECHOES_A_LESSON = 2  # so many echoes are sent for each of them: some are lost
RESTAMP = 0.1  # seconds for which words that echo nothing tell the same offset: others only find how long they took
MOST_DATAGRAMS = 4  # to one peer for one catch-up
MOST_PIECES_AT_ONCE = 16
NOTHING: Mapping[int, Partly] = MappingProxyType({})

Stamps = tuple[int, int, int | None, tuple[Echo, ...]]  # of Head, from its sequence on


class _Turn(NamedTuple):
    """What is echoed in one datagram, to whom it is due, and when there may be some due again."""

    echoes: tuple[Echo, ...]
    due: Sequence[int]
    next_echo: float


_NOBODY = _Turn((), (), -math.inf)


class Speech:
    """`sessions` are those of the peers that may be listened to. A `gate`, told how own words begin, puts most of them
    together and seals them, into the same bytes; and where there is a `way` from it to the peers, sends them."""

    def __init__(
        self,
        program: Program,
        settings: Settings,
        key: bytes | None,
        transport: Transport,
        clock: Clock,
        fleet_clock: FleetClock,
        boot: bytes,
        sessions: Sessions,
        gate: Gate | None = None,
        way: Coupled | None = None,
    ) -> None:
        self.epoch = b""
        self.room = LIMIT - overhead(len(settings.peers))  # bytes for closings or a piece in one datagram
        self._pid = settings.pid
        hashes = bytes.fromhex(program.interface_hash), bytes.fromhex(program.program_hash)
        self._own = settings.application_id, *hashes, settings.pid, boot  # what stays of a head
        self._release = bytes.fromhex(settings.release)
        self._key = key
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._sessions = sessions
        self._gate = gate
        self._way = way  # out of the gate
        self._to: Sequence[int] = ()  # to whom something was said last,
        self._place = -1  # and where they are, see Coupled.place
        self._stamped = Stamped() if gate is None else gate.stamped  # it knows the last number and offset, too
        self._others_every = others_every(len(settings.peers))
        self._echoed: dict[int, float] = {}  # when each peer was last sent an echo, the one that waits longest first
        self._next_echo = -math.inf  # none is due to anyone before

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Closing | None,
              start: int | None) -> None:  # fmt: skip
        self._send([to], Hello(self._head([to], 0.0), to, challenge, answer, holds, init, start, self._release))

    def say(self, to: Collection[int], kind: type[Message], *fields: Any) -> None:
        """One message of this kind, with its fields behind the head."""
        if to:
            self._send(to, kind(self._head(to), *fields))

    def round(self, to: Sequence[int], word: Fields, closings: Sequence[Closing],
              partly: Mapping[int, Partly] = NOTHING) -> None:  # fmt: skip
        """A word with closings: one datagram, or as few as they fit in, at most MOST_DATAGRAMS; the rest waits to be
        asked for. Of a closing that is longer than a datagram go those pieces that are not in `partly`, by author."""
        if not to or (not closings and self.own(to, word, 0, None)):
            return
        head = self._head(to)
        payload = pack(Round(head, *word, tuple(closings)))
        if len(payload) <= MOST_PAYLOAD:
            self._transport.send(to, seal(self._key, MEMORY, payload))
            return
        self._divided(to, head, word, closings, partly)

    def own(self, to: Sequence[int], word: Fields, round_: int, ledger: Ledger | None) -> bool:
        """A word with the own closing of a round, out of the ledger, or with none (0), by the gate. False: not possible
        here, nothing was said nor changed, and `round` says the same."""
        gate, way = self._gate, self._way
        if gate is None or not to:
            return not to
        if to is not self._to and way is not None:
            self._to, self._place = to, way.place(to)
        if way is not None and (ledger is None or ledger is gate.ledger) and (place := self._place) >= 0:
            error = gate.send(place, word, round_)
            if error == NOT_STAMPED:
                now, stamps, turn = self._stamps(to)
                error = gate.send(place, (*stamps, *word), round_)
                if error >= 0:
                    self._spend(now, stamps, turn)
            if error > 0:
                way.failed(error)
            return error >= 0
        now, stamps, turn = self._stamps(to)
        datagram = gate.say((*stamps, *word), 0 if ledger is None else ledger.at, round_)
        if not datagram:
            return False
        self._spend(now, stamps, turn)
        self._transport.send(to, datagram)
        return True

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

    def _head(self, to: Collection[int], every: float | None = None) -> Head:
        now, stamps, turn = self._stamps(to, every)
        self._spend(now, stamps, turn)
        return Head(*self._own, self.epoch, *stamps)

    def _stamps(self, to: Collection[int], every: float | None = None) -> tuple[float, Stamps, _Turn]:
        """The time, what a head ends with, and the turn in it; nothing is spent of it yet."""
        now = self._clock.now()
        offset = self._fleet_clock.offset(now)
        turn = _NOBODY if every is None and now < self._next_echo else self._turn(to, now, every)
        fleet = None if offset is None else round(offset * 1e6)
        return now, (self._stamped.sequence + 1, microseconds(now), fleet, turn.echoes), turn

    def _spend(self, now: float, stamps: Stamps, turn: _Turn) -> None:
        """That was said."""
        if turn is not _NOBODY:
            self._next_echo = turn.next_echo
            for pid in turn.due:
                del self._echoed[pid]
                self._echoed[pid] = now
        stamped, (sequence, _, fleet, _) = self._stamped, stamps
        stamped.sequence, stamped.fleet, stamped.known = sequence, fleet or 0, fleet is not None
        stamped.until = min(self._next_echo, now + RESTAMP)

    def _turn(self, to: Collection[int], now: float, every: float | None) -> _Turn:
        """Of those whose turn it is: as often as they learn from it, which from the reference they do most."""
        if every is None:
            reference = self._fleet_clock.reference == self._pid
            every = (REFERENCE_EVERY if reference else self._others_every) / ECHOES_A_LESSON
        sessions = self._sessions
        if len(self._echoed) < len(sessions.boots):
            self._echoed = dict.fromkeys(sorted(sessions.boots), -math.inf) | self._echoed
        everyone, due, next_ = len(to) == len(sessions.boots), list[int](), self._next_echo
        for pid, last in self._echoed.items():
            if now - last < every or len(due) == MAX_ECHOES:
                break
            if everyone or pid in to:
                due.append(pid)
        else:
            last = now  # it was everyone's turn
        if everyone and now - last < every:  # nobody is left
            next_ = max(last, now - every / 2) + every  # those who are due a little later wait for one another
        echoes = tuple([Echo(p, sent, sessions.arrived[p]) for p in due if (sent := sessions.sent[p]) >= 0])
        return _Turn(echoes, due, next_)

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
                if len(batches) == MOST_DATAGRAMS:
                    return batches  # the rest waits to be asked for, and may be long
                batch, room = [], self.room
            batch.append(closing)
            room -= length
        return [*batches, tuple(batch)]

    def _send(self, to: Collection[int], message: Message) -> None:
        self._transport.send(list(to), encode(message, self._key))


def others_every(n_sys: int) -> float:
    """Seconds between exchanges with one who is not the reference. They are there for when it becomes the reference; to
    learn from all others at the pace of a small fleet would be a large one's greatest expense."""
    return OTHERS_EVERY * max(1.0, n_sys / OTHERS)


def microseconds(seconds: float) -> int:
    return round(seconds * 1e6) if seconds > 0.0 else 0
