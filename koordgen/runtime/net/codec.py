"""Codec of the wire format: messages to sealed datagrams and back.

A datagram consists of one byte `WIRE_FORMAT`, a tagged MessagePack array (one of Message), and the MAC of `seal`. It
has at most LIMIT bytes. The codec is separate from `wire`, because mypyc can compile the codec but not msgspec's
structs."""

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
    """Return a message as a sealed datagram. The length of the datagram is not checked."""
    return seal(key, MEMORY, pack(message))


def decode(datagram: bytes, key: bytes | None) -> Message | str:
    """Return the message of a datagram, or the reason why the datagram is refused. Never raises.

    The MAC is verified before any other byte is read. Values of entries refer to the datagram's payload, which
    therefore stays in memory."""
    return decoder(key)(datagram)


@lru_cache(maxsize=4)
def decoder(key: bytes | None) -> Callable[[bytes], Message | str]:
    """Return the function `decode` with `key` bound to it."""
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
    """Decode an entry that arrived in fragments. Return None if the bytes are no valid entry."""
    try:
        return _entries.decode(blob)
    except (ValueError, RecursionError):
        return None


def snapshot_of(blob: bytes) -> Snapshot | None:
    """Decode a snapshot that arrived in fragments. Return None if the bytes are no valid snapshot."""
    try:
        return _states.decode(blob)
    except (ValueError, RecursionError):
        return None


def epoch_of(boot_ids: list[bytes]) -> bytes:
    """Return the epoch, the id of a mission: a digest of all robots' boot ids in the order of their pids.

    Robots that know the same boot ids therefore agree on the epoch without a coordinator.
    """
    return blake2s(b"".join(boot_ids), digest_size=8, person=b"k-epoch").digest()


def overhead(n_sys: int) -> int:
    """Return the most bytes that a sealed datagram needs besides entries or the data of a fragment.

    `n_sys`: number of robots in the fleet.
    """
    token = bytes(8)
    echoes = tuple(Echo(MAX_ROBOTS - 1, TOP, TOP) for _ in range(min(MAX_ECHOES, n_sys)))
    head = Head(TOP, token, token, MAX_ROBOTS - 1, token, token, TOP, TOP, TOP, echoes)
    held = (2**32 - 1,) * n_sys
    fragment = Fragment(head, MAX_ROBOTS - 1, TOP, TOP, token, MOST_FRAGMENTS - 1, MOST_FRAGMENTS, b"")
    hello = Hello(head, MAX_ROBOTS - 1, token, token, tuple(range(n_sys)), None, TOP, bytes(RELEASE_SIZE))
    round_ = RoundMessage(head, TOP, TOP, TOP, TOP, True, held, ())
    return MAC_SIZE + 1 + max(len(encoder.encode(m)) for m in (fragment, hello, round_)) + 4
