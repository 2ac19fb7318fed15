"""Sender of one robot's messages: adds heads, and splits messages that are longer than a datagram.

A round message is sent in as few datagrams as possible. Entries longer than a datagram are sent in fragments."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.net.codec import encode, encoder, overhead, pack
from koordgen.runtime.net.fleet_clock import FleetClock
from koordgen.runtime.net.fragments import cut, lacking
from koordgen.runtime.net.seal import MEMORY, seal
from koordgen.runtime.net.sessions import PeerSession
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    MOST_PAYLOAD,
    Echo,
    Entry,
    Fragment,
    Head,
    HeldFragments,
    Hello,
    Message,
    RoundMessage,
)
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.clock import Clock

REFERENCE_EVERY, OTHERS_EVERY = 0.1, 1.0  # seconds between two exchanges with the reference, with another peer
OTHERS = 16  # largest fleet in which OTHERS_EVERY holds; in a larger fleet, exchanges with each peer are rarer
ECHOES_A_LESSON = 2  # number of echoes sent for each exchange that the fleet clock needs, because some echoes are lost
ECHOED = 1024  # number of last datagrams whose echoes are of use; a peer echoes the last datagram that it has received
MOST_DATAGRAMS = 4  # largest number of datagrams of one round message
MOST_FRAGMENTS_AT_ONCE = 16
NOTHING: Mapping[int, HeldFragments] = MappingProxyType({})

# Fields of a RoundMessage after its head.
Fields = tuple[int, int, int, int, bool, tuple[int, ...], tuple[Entry, ...]]


class Sending(Protocol):
    """Interface of a sender of messages. `room`: bytes in one datagram for entries or a fragment."""

    epoch: bytes
    room: int

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Entry | None,
              start: int | None) -> None: ...  # fmt: skip

    def send(self, to: Collection[int], kind: type[Any], *fields: Any) -> None: ...

    def round(self, to: Sequence[int], fields: Any, received: Mapping[int, HeldFragments] = NOTHING) -> None: ...


class MessageSender:
    """Sender of one robot's messages.

    sessions: pid -> session of an adopted peer. Datagrams of these peers are echoed, for the fleet clock.
    stamps: time stamps of the last ECHOED datagrams, in microseconds. Echoes of other datagrams are of no use."""

    def __init__(
        self,
        program: Program,
        settings: Settings,
        key: bytes | None,
        transport: Transport,
        clock: Clock,
        fleet_clock: FleetClock,
        boot: bytes,
        sessions: Mapping[int, PeerSession],
    ) -> None:
        self.epoch = b""
        self.room = LIMIT - overhead(len(settings.peers))  # bytes in one datagram for entries or a fragment
        self._pid = settings.pid
        hashes = bytes.fromhex(program.interface_hash), bytes.fromhex(program.program_hash)
        self._own = settings.application_id, *hashes, settings.pid, boot  # fields at the beginning of every head
        self._release = bytes.fromhex(settings.release)
        self._key = key
        self._transport = transport
        self._clock = clock
        self._fleet_clock = fleet_clock
        self._sessions = sessions
        self.stamps: set[int] = set()
        self._stamped: deque[int] = deque()  # the same, by age
        self._sequence = 0  # sequence number of the last datagram
        self._others_every = others_every(len(settings.peers))
        self._echoed: dict[int, float] = {}  # pid -> time of the last echo to that peer, by ascending time
        self._next_echo = -math.inf  # time before which no echo is due

    def hello(self, to: int, challenge: bytes, answer: bytes, holds: tuple[int, ...], init: Entry | None,
              start: int | None) -> None:  # fmt: skip
        self._send([to], Hello(self._head([to], 0.0), to, challenge, answer, holds, init, start, self._release))

    def send(self, to: Collection[int], kind: type[Message], *fields: Any) -> None:
        """Send a message of class `kind`; `fields` are its fields after the head."""
        if to:
            self._send(list(to), kind(self._head(to), *fields))

    def round(self, to: Sequence[int], fields: Fields, received: Mapping[int, HeldFragments] = NOTHING) -> None:
        """Send a round message in as few datagrams as possible, at most MOST_DATAGRAMS.

        fields: fields of the RoundMessage without the head. Entries that do not fit are sent later, on request.
        received: author -> fragments of the author's long entry that the receiver has. Only other fragments are sent.
        """
        if not to:
            return
        head = self._head(to)
        payload = pack(RoundMessage(head, *fields))
        if len(payload) <= MOST_PAYLOAD:
            self._transport.send(to, seal(self._key, MEMORY, payload))
        else:
            self._divided(to, head, fields, received)

    def _divided(self, to: Sequence[int], head: Head, fields: Fields, received: Mapping[int, HeldFragments]) -> None:
        """Send a round message that is too long for one datagram."""
        small = []
        for entry in fields[-1]:
            if len(entry.writes) and len(blob := encoder.encode(entry)) > self.room:
                self._fragments(to, entry, blob, received.get(entry.author))
            else:
                small.append(entry)
        for index, batch in enumerate(self._batches(small)):
            self._send(to, RoundMessage(self._head(to) if index else head, *fields[:-1], batch))

    def _head(self, to: Collection[int], every: float | None = None) -> Head:
        """Return the head of the next datagram to robots `to`.

        `every`: seconds between echoes to one peer; None: as often as the peers' clocks need echoes."""
        now = self._clock.now()
        offset = self._fleet_clock.offset(now)
        echoes = () if every is None and now < self._next_echo else self._echoes(to, now, every)
        self._sequence += 1
        sent = microseconds(now)
        self._stamp(sent)
        return Head(
            *self._own, self.epoch, self._sequence, sent, None if offset is None else round(offset * 1e6), echoes
        )

    def _stamp(self, sent: int) -> None:
        """Remember the time stamp of a datagram, and forget the oldest one."""
        stamps, stamped = self.stamps, self._stamped
        if sent not in stamps:
            stamps.add(sent)
            stamped.append(sent)
            if len(stamped) > ECHOED:
                stamps.remove(stamped.popleft())

    def _echoes(self, to: Collection[int], now: float, every: float | None) -> tuple[Echo, ...]:
        """Return the echoes that are due to peers in `to`. The reference robot sends echoes most often."""
        if every is None:
            reference = self._fleet_clock.reference == self._pid
            every = (REFERENCE_EVERY if reference else self._others_every) / ECHOES_A_LESSON
        sessions, echoed = self._sessions, self._echoed
        if len(echoed) < len(sessions):
            echoed = self._echoed = dict.fromkeys(sorted(sessions), -math.inf) | echoed
        everyone = len(to) == len(sessions)
        due: list[int] = []
        for pid, last in echoed.items():
            if now - last < every or len(due) == MAX_ECHOES:
                break
            if everyone or pid in to:
                due.append(pid)
        else:
            last = now  # an echo to every peer was due
        if everyone and now - last < every:  # no further echo is due now
            # Echoes that will be due within half a period are postponed, so that they share one datagram.
            self._next_echo = max(last, now - every / 2) + every
        for pid in due:
            del echoed[pid]  # the next line inserts the peer at the end
            echoed[pid] = now
        return tuple([Echo(p, sessions[p].sent, sessions[p].arrived) for p in due if sessions[p].sent >= 0])

    def _fragments(self, to: Sequence[int], entry: Entry, blob: bytes, known: HeldFragments | None) -> None:
        fragments = cut(blob, self.room)
        mask = known.mask if known is not None and known.digest == fragments[0][0] else b""
        for index in lacking(len(fragments), mask)[:MOST_FRAGMENTS_AT_ONCE]:
            place = entry.author, entry.incarnation, entry.round
            digest, _, count, data = fragments[index]
            self._send(to, Fragment(self._head(to), *place, digest, index, count, data))

    def _batches(self, entries: Sequence[Entry]) -> list[tuple[Entry, ...]]:
        if len(entries) < 2:
            return [tuple(entries)]
        batches: list[tuple[Entry, ...]] = []
        batch: list[Entry] = []
        room = self.room
        for entry in entries:
            length = len(encoder.encode(entry))
            if batch and length > room:
                batches.append(tuple(batch))
                if len(batches) == MOST_DATAGRAMS:
                    return batches  # further entries are sent on request
                batch, room = [], self.room
            batch.append(entry)
            room -= length
        return [*batches, tuple(batch)]

    def _send(self, to: Sequence[int], message: Message) -> None:
        self._transport.send(to, encode(message, self._key))


def others_every(n_sys: int) -> float:
    """Return the seconds between two exchanges with a peer that is not the reference.

    The fleet clock needs these exchanges because the peer may become the reference. In a large fleet they are rarer,
    because they would otherwise cost more than all other messages."""
    return OTHERS_EVERY * max(1.0, n_sys / OTHERS)


def microseconds(seconds: float) -> int:
    return round(seconds * 1e6) if seconds > 0.0 else 0
