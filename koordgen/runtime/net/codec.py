"""Codec of the wire format: messages to sealed datagrams and back.

A datagram is one byte `WIRE_FORMAT`, a tagged MessagePack array (one of Message), and the MAC of `seal`; at most LIMIT
bytes. It is separate from `wire` because it can be compiled, and msgspec's structs cannot."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from hashlib import blake2s

import msgspec

from koordgen.runtime.net.seal import MAC_SIZE, MEMORY, seal, unsealer
from koordgen.runtime.net.wire import (
    LIMIT,
    MAX_ECHOES,
    MAX_ROBOTS,
    MOST_FRAGMENTS,
    RELEASE_SIZE,
    TOP,
    WIRE_FORMAT,
    Echo,
    Entry,
    Fragment,
    Head,
    Hello,
    Message,
    RoundMessage,
    Snapshot,
)

encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)
_entries: msgspec.msgpack.Decoder[Entry] = msgspec.msgpack.Decoder(Entry)
_states: msgspec.msgpack.Decoder[Snapshot] = msgspec.msgpack.Decoder(Snapshot)
_FORMAT = bytes([WIRE_FORMAT])


def pack(message: Message) -> bytes:
    """Return the part of a datagram that the MAC covers: the format byte and the encoded message."""
    return _FORMAT + encoder.encode(message)


def encode(message: Message, key: bytes | None) -> bytes:
    """Return a sealed datagram. Its length is not checked."""
    return seal(key, MEMORY, pack(message))


def decode(datagram: bytes, key: bytes | None) -> Message | str:
    """Return the message of a datagram, or why it is refused. Nothing is read before its MAC was verified.

    Never raises. The values of an entry refer to the payload in which they arrived, which therefore stays in memory."""
    return decoder(key)(datagram)


@lru_cache(maxsize=4)
def decoder(key: bytes | None) -> Callable[[bytes], Message | str]:
    """Return `decode` for one key."""
    unseal, decode_payload = unsealer(key, MEMORY), _decoder.decode

    def decode_(datagram: bytes) -> Message | str:
        if len(datagram) > LIMIT:
            return "oversize"
        payload = unseal(datagram)
        if payload is None:
            return "not authentic"
        if payload[0] != WIRE_FORMAT:
            return "another format version"
        try:
            return decode_payload(payload[1:])
        except (ValueError, RecursionError):
            return "malformed"

    return decode_


def entry_of(blob: bytes) -> Entry | None:
    """Return the entry that arrived in fragments, or None if the bytes are no entry."""
    try:
        return _entries.decode(blob)
    except (ValueError, RecursionError):
        return None


def snapshot_of(blob: bytes) -> Snapshot | None:
    """Return the snapshot that arrived in fragments, or None if the bytes are no snapshot."""
    try:
        return _states.decode(blob)
    except (ValueError, RecursionError):
        return None


def epoch_of(boots: list[bytes]) -> bytes:
    """Return the epoch, the id of a mission: a digest of all robots' boot ids in the order of their pids.

    Robots that know the same boot ids therefore agree on the epoch without a coordinator.
    """
    return blake2s(b"".join(boots), digest_size=8, person=b"k-epoch").digest()


def overhead(n_sys: int) -> int:
    """Return the greatest number of bytes in a sealed datagram besides its entries or a fragment's data.

    `n_sys`: robots of the fleet.
    """
    token = bytes(8)
    echoes = tuple(Echo(MAX_ROBOTS - 1, TOP, TOP) for _ in range(min(MAX_ECHOES, n_sys)))
    head = Head(TOP, token, token, MAX_ROBOTS - 1, token, token, TOP, TOP, TOP, echoes)
    held = (2**32 - 1,) * n_sys
    fragment = Fragment(head, MAX_ROBOTS - 1, TOP, TOP, token, MOST_FRAGMENTS - 1, MOST_FRAGMENTS, b"")
    hello = Hello(head, MAX_ROBOTS - 1, token, token, tuple(range(n_sys)), None, TOP, bytes(RELEASE_SIZE))
    round_ = RoundMessage(head, TOP, TOP, TOP, TOP, True, held, ())
    return MAC_SIZE + 1 + max(len(encoder.encode(m)) for m in (fragment, hello, round_)) + 4
