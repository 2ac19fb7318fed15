"""The wire format: every datagram of the shared memory as a typed struct, MessagePack, at most 1200 bytes sealed.

A datagram is one byte `WIRE_FORMAT`, a tagged array (one of Message), and the MAC of `seal`. Times are microseconds,
`sent` and `received` on the clock of the robot that wrote them down. Nothing here judges a message beyond its types
and ranges; `link`, `memory` and `views` do.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2s
from typing import Annotated

import msgspec

from koordgen.runtime.net.seal import MAC_SIZE, MEMORY, seal, unseal_all

WIRE_FORMAT = 4  # raised whenever the meaning of a datagram changes; part of every interface hash
LIMIT = 1200  # bytes of a sealed datagram: what every path carries without IP fragments
MOST_PAYLOAD = LIMIT - MAC_SIZE
MAX_ROBOTS = 128
MAX_ECHOES = 8
RELEASE_SIZE = 16  # bytes of the digest that names a release
MOST_PIECES = 256  # of one blob

_TOP = 2**53
Token = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]
MaybeToken = Annotated[bytes, msgspec.Meta(max_length=8)]  # empty: not known yet
Release = Annotated[bytes, msgspec.Meta(max_length=RELEASE_SIZE)]  # empty: of a bundle that was built without a fleet
Natural = Annotated[int, msgspec.Meta(ge=0, le=_TOP)]
MaybeNatural = Annotated[int, msgspec.Meta(ge=-1, le=_TOP)]  # -1: none
Shift = Annotated[int, msgspec.Meta(ge=-_TOP, le=_TOP)]
Pid = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
Short = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # a round: enough for a year of rounds of 10 ms
MaybePerRobot = Annotated[tuple[Short, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
PerRobot = Annotated[tuple[Short, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Incarnations = Annotated[tuple[MaybeNatural, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Mask = Annotated[bytes, msgspec.Meta(max_length=MOST_PIECES // 8)]  # bit i of byte i // 8: piece i is there
Data = Annotated[bytes, msgspec.Meta(max_length=LIMIT)]


class Wired(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """What travels: immutable (so it never refers to itself), an array without names, nothing beyond its fields."""


class Echo(Wired, frozen=True):
    """The newest datagram heard from `pid`: the stamp in it, and when it arrived by the echoing robot's clock."""

    pid: Pid
    sent: Natural
    received: Natural


class Head(Wired, frozen=True):
    """What every datagram begins with. `boot` is drawn anew at each start of the sender's process; `sequence` only
    grows within a boot; `epoch` names the mission and is empty until the sender holds everyone's init result; `fleet`
    is to be added to the sender's clock for fleet time, as far as it knows. `echoes` are there as often as clocks learn
    from them."""

    application: Natural
    interface: Token
    program: Token
    pid: Pid
    boot: Token
    epoch: MaybeToken
    sequence: Natural
    sent: Natural
    fleet: Shift | None
    echoes: Annotated[tuple[Echo, ...], msgspec.Meta(max_length=MAX_ECHOES)]


class Write(Wired, frozen=True):
    """A shared variable's new value (for an allread variable, of its author's slot); `index` counts the program's
    shared variables. A `patch` is what changed of the value's encoding at the start of the round (see `patch`)."""

    index: Annotated[int, msgspec.Meta(ge=0, lt=65536)]
    value: msgspec.Raw
    patch: bool = False


class Closing(Wired, frozen=True):
    """`author` is done with the rounds `first` to `round`: with writes or `acted` they are one round, without it wrote
    nothing in any of them (so the silence of a long outage is one closing). Round 0 is the result of `init`.

    `incarnation` tells which of its lives in the mission wrote it (see View). `stopped` holds in all of the rounds.
    `acted`: an event of the author's ended. `prompt`: the author waits until a majority says that it
    has applied this round. `lock`: of an atomic event, of which one a round and lock counts; -1 for all else."""

    author: Pid
    incarnation: Natural
    first: Natural
    round: Natural
    stopped: bool = False
    acted: bool = False
    prompt: bool = False
    lock: Annotated[int, msgspec.Meta(ge=-1, lt=65536)] = -1
    writes: Annotated[tuple[Write, ...], msgspec.Meta(max_length=256)] = ()


class View(Wired, frozen=True):
    """Who counts from round `since` on. `members[p]` is robot p's incarnation, the number of the view that admitted it
    last, or -1: it does not count."""

    number: Natural
    since: Natural
    members: Incarnations


class Hello(Wired, frozen=True, tag=0):
    """Joining, from one robot to another. A boot is taken for live only when `answer` repeats the `challenge` that
    the receiver has open for it, and a challenge opens once. `holds`: those whose init result the sender holds.
    `release` names the bundles that were built together (see RELEASE in a bundle): a robot listens to its own only."""

    head: Head
    to: Pid
    challenge: Token
    answer: MaybeToken
    holds: Annotated[tuple[Pid, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    init: Closing | None
    start: Natural | None  # of round 1, in fleet time
    release: Release = b""


class Round(Wired, frozen=True, tag=1):
    """The sender's word: it is in `round`, goes by view number `view`, has applied all rounds up to `applied`, and
    holds robot p's closings up to `held[p]`; empty: everyone's up to `applied`, as in most rounds. All members hold
    everything up to `settled`. Any robot may carry any other's closings. `emergency`: someone with the fleet's key has
    stopped the fleet."""

    head: Head
    view: Natural
    round: Natural
    applied: Natural
    settled: Natural
    emergency: bool
    held: MaybePerRobot
    closings: tuple[Closing, ...]


class Partly(Wired, frozen=True):
    """Of a robot's next closing, these pieces are there."""

    author: Pid
    round: Natural
    digest: Token
    mask: Mask


class Need(Wired, frozen=True, tag=2):
    """A word as in Round, from one who asks at once for what it lacks up to `through`, and for the receiver's word."""

    head: Head
    view: Natural
    through: Natural
    applied: Natural
    held: PerRobot
    partly: Annotated[tuple[Partly, ...], msgspec.Meta(max_length=8)]


class Piece(Wired, frozen=True, tag=3):
    """One of `count` pieces of an encoded closing that is longer than a datagram; `digest` is the whole's."""

    head: Head
    author: Pid
    incarnation: Natural
    round: Natural
    digest: Token
    index: Annotated[int, msgspec.Meta(ge=0, lt=MOST_PIECES)]
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_PIECES)]
    data: Data


class Prepare(Wired, frozen=True, tag=4):
    """Ballot `ballot` for the successor of `view`, which is decided, begins: will you vote in no lower one, and apply
    no round meanwhile?"""

    head: Head
    ballot: Natural
    view: View


class Promise(Wired, frozen=True, tag=5):
    """Yes. The sender went by `view` and had said to have applied up to `applied` in it; `state`: it still has the
    store of that round; `accepted` is what it has voted for in ballot `voted`."""

    head: Head
    number: Natural
    ballot: Natural
    view: Natural
    applied: Natural
    state: bool
    voted: Natural
    accepted: View | None


class Accept(Wired, frozen=True, tag=6):
    """Vote for this view."""

    head: Head
    ballot: Natural
    value: View


class Accepted(Wired, frozen=True, tag=7):
    """The sender has voted for what was put to it in that ballot."""

    head: Head
    number: Natural
    ballot: Natural


class Decided(Wired, frozen=True, tag=8):
    """A majority has voted for this view."""

    head: Head
    value: View


class Want(Wired, frozen=True, tag=9):
    """From one who does not count or has no store. `incarnation` -1: let me in. Else that view has admitted it, and it
    asks for the State; of the one applied up to `round` with this `digest` it has the pieces in `mask`."""

    head: Head
    view: Natural
    incarnation: MaybeNatural
    round: Natural
    digest: MaybeToken
    mask: Mask


class StatePiece(Wired, frozen=True, tag=10):
    """One of `count` pieces of an encoded State; `digest` is the whole's."""

    head: Head
    round: Natural
    digest: Token
    index: Annotated[int, msgspec.Meta(ge=0, lt=MOST_PIECES)]
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_PIECES)]
    data: Data


class State(Wired, frozen=True):
    """The shared store after round `applied`: what someone needs who comes (back) in. `values[i]` is variable i's
    value, an allread variable's as the array of its slots. `stopped[p]`: the round in which robot p stopped, or -1.
    `acted[p]`: the last round in which an event of robot p counted."""

    view: View
    applied: Natural
    values: tuple[msgspec.Raw, ...]
    stopped: Incarnations
    acted: PerRobot


Message = Hello | Round | Need | Piece | Prepare | Promise | Accept | Accepted | Decided | Want | StatePiece

encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)
_closings: msgspec.msgpack.Decoder[Closing] = msgspec.msgpack.Decoder(Closing)
_states: msgspec.msgpack.Decoder[State] = msgspec.msgpack.Decoder(State)
_FORMAT = bytes([WIRE_FORMAT])


def pack(message: Message) -> bytes:
    """What of a datagram is sealed."""
    return _FORMAT + encoder.encode(message)


def encode(message: Message, key: bytes | None) -> bytes:
    """A sealed datagram; the caller sees to its length."""
    return seal(key, MEMORY, pack(message))


def decode(datagram: bytes, key: bytes | None) -> Message | str:
    """Return the message in a datagram, or why there is none."""
    return decode_all((datagram,), key)[0]


def decode_all(datagrams: Sequence[bytes], key: bytes | None) -> list[Message | str]:
    """Return the message in each datagram, or why there is none. Nothing is read before its MAC was verified.

    Never raises. A closing keeps the payload that it arrived in alive; slices of a view would keep three objects.
    """
    decoded, found = _decoder.decode, list[Message | str]()
    for datagram, payload in zip(datagrams, unseal_all(key, MEMORY, datagrams), strict=True):
        if len(datagram) > LIMIT:
            found.append("oversize")
        elif payload is None:
            found.append("not authentic")
        elif payload[0] != WIRE_FORMAT:
            found.append("another format version")
        else:
            try:
                found.append(decoded(payload[1:]))
            except (ValueError, RecursionError):
                found.append("malformed")
    return found


def closing_of(blob: bytes) -> Closing | None:
    """The closing that came in pieces, or None when that is none."""
    try:
        return _closings.decode(blob)
    except (ValueError, RecursionError):
        return None


def state_of(blob: bytes) -> State | None:
    """The State that came in pieces, or None when that is none."""
    try:
        return _states.decode(blob)
    except (ValueError, RecursionError):
        return None


def epoch_of(boots: list[bytes]) -> bytes:
    """The mission's name: a digest of all robots' boots in the order of their pids, so that robots which have met the
    same boots agree on it without a coordinator."""
    return blake2s(b"".join(boots), digest_size=8, person=b"k-epoch").digest()


def overhead(n_sys: int) -> int:
    """The most bytes a sealed datagram has beside its closings or a piece's data, with `n_sys` robots."""
    token = bytes(8)
    echoes = tuple(Echo(MAX_ROBOTS - 1, _TOP, _TOP) for _ in range(min(MAX_ECHOES, n_sys)))
    head = Head(_TOP, token, token, MAX_ROBOTS - 1, token, token, _TOP, _TOP, _TOP, echoes)
    held = (2**32 - 1,) * n_sys
    piece = Piece(head, MAX_ROBOTS - 1, _TOP, _TOP, token, MOST_PIECES - 1, MOST_PIECES, b"")
    hello = Hello(head, MAX_ROBOTS - 1, token, token, tuple(range(n_sys)), None, _TOP, bytes(RELEASE_SIZE))
    round_ = Round(head, _TOP, _TOP, _TOP, _TOP, True, held, ())
    return MAC_SIZE + 1 + max(len(encoder.encode(m)) for m in (piece, hello, round_)) + 4
