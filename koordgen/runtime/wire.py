"""The wire format: every datagram of the shared memory as a typed struct, MessagePack, at most 1200 bytes sealed.

A datagram is one byte `WIRE_FORMAT`, a tagged array (Hello, Round or Need), and the MAC of `seal`. Times are
microseconds, `sent` and `received` on the clock of the robot that wrote them down. Nothing here judges a message
beyond its types and ranges; `link` and `memory` do.
"""

from __future__ import annotations

from hashlib import blake2s
from typing import Annotated

import msgspec

from koordgen.runtime.seal import MAC_SIZE, MEMORY, seal, unseal

WIRE_FORMAT = 2  # raised whenever the meaning of a datagram changes; part of every interface hash
LIMIT = 1200  # bytes of a sealed datagram: what every path carries without IP fragments
MAX_ROBOTS = 128
MAX_ECHOES = 8

Token = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]
MaybeToken = Annotated[bytes, msgspec.Meta(max_length=8)]  # empty: not known yet
Natural = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Pid = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
PerRobot = Annotated[tuple[Natural, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]


class Echo(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The newest datagram heard from `pid`: the stamp in it, and when it arrived by the echoing robot's clock."""

    pid: Pid
    sent: Natural
    received: Natural


class Head(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What every datagram begins with. `boot` is drawn anew at each start of the sender's process; `sequence` only
    grows within a boot; `epoch` names the mission and is empty until the sender holds everyone's init result."""

    application: Natural
    interface: Token
    program: Token
    pid: Pid
    boot: Token
    epoch: MaybeToken
    sequence: Natural
    sent: Natural
    echoes: Annotated[tuple[Echo, ...], msgspec.Meta(max_length=MAX_ECHOES)]


class Write(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A shared variable's new value (for an allread variable, of its author's slot); `index` counts the program's
    shared variables."""

    index: Annotated[int, msgspec.Meta(ge=0, lt=65536)]
    value: msgspec.Raw


class Closing(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """`author` is done with the rounds `first` to `round`: with writes they are one round, without it wrote nothing
    in any of them (so the silence of a long outage is one closing). Round 0 is the result of `init`. `stopped` holds
    in all of them. `commit`: the writes are those of an atomic event, which go before all plain ones of the round."""

    author: Pid
    first: Natural
    round: Natural
    stopped: bool
    commit: bool
    writes: Annotated[tuple[Write, ...], msgspec.Meta(max_length=256)] = ()


class Hello(msgspec.Struct, frozen=True, array_like=True, tag=0, forbid_unknown_fields=True):
    """Joining, from one robot to another. A boot is taken for live only when `answer` repeats the `challenge` that
    the receiver has open for it, and a challenge opens once. `holds`: those whose init result the sender holds."""

    head: Head
    to: Pid
    challenge: Token
    answer: MaybeToken
    holds: Annotated[tuple[Pid, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    init: Closing | None
    start: Natural | None  # of round 1, in fleet time


class Round(msgspec.Struct, frozen=True, array_like=True, tag=1, forbid_unknown_fields=True):
    """The sender is in `round`, should hold every closing before it, and does hold those of robot p up to `held[p]`.
    All robots hold everything up to `settled`. Any robot may carry any other's closings."""

    head: Head
    round: Natural
    settled: Natural
    held: PerRobot
    closings: tuple[Closing, ...]


class Need(msgspec.Struct, frozen=True, array_like=True, tag=2, forbid_unknown_fields=True):
    """The sender holds robot p's closings up to `held[p]` and asks at once for what it lacks up to `through`."""

    head: Head
    through: Natural
    held: PerRobot


Message = Hello | Round | Need

encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)
_FORMAT = bytes([WIRE_FORMAT])


def encode(message: Message, key: bytes | None) -> bytes:
    """A sealed datagram; the caller sees to its length."""
    return seal(key, MEMORY, _FORMAT + encoder.encode(message))


def decode(datagram: bytes, key: bytes | None) -> Message | str:
    """The message, or why there is none. Nothing is looked at before the MAC was found right. Never raises."""
    if len(datagram) > LIMIT:
        return "oversize"
    payload = unseal(key, MEMORY, datagram)
    if payload is None:
        return "not authentic"
    if payload[:1] != _FORMAT:
        return "another format version"
    try:
        message: Message = _decoder.decode(memoryview(payload)[1:])
    except (msgspec.DecodeError, RecursionError):
        return "malformed"
    return message


def epoch_of(boots: list[bytes]) -> bytes:
    """The mission's name: a digest of all robots' boots in the order of their pids, so that robots which have met the
    same boots agree on it without a coordinator."""
    return blake2s(b"".join(boots), digest_size=8, person=b"k-epoch").digest()


def overhead(n_sys: int) -> int:
    """The most bytes a sealed datagram has beside its closings, with `n_sys` robots."""
    top = 2**53
    token = bytes(8)
    echoes = tuple(Echo(MAX_ROBOTS - 1, top, top) for _ in range(min(MAX_ECHOES, n_sys)))
    head = Head(top, token, token, MAX_ROBOTS - 1, token, token, top, top, echoes)
    held = (top,) * n_sys
    hello = Hello(head, MAX_ROBOTS - 1, token, token, tuple(range(n_sys)), None, top)
    return MAC_SIZE + 1 + max(len(encoder.encode(Round(head, top, top, held, ()))), len(encoder.encode(hello))) + 2
