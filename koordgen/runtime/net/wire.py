"""Wire format: the messages of the shared memory as typed structs. `codec` encodes them as datagrams.

Times are microseconds, `sent` and `received` on the clock of the robot that recorded them. Only types and ranges are
checked here; `link` and the room `replication` check the rest."""

from __future__ import annotations

from typing import Annotated

import msgspec

from koordgen.runtime.net.seal import MAC_SIZE

WIRE_FORMAT = 4  # raised whenever the meaning of a datagram changes; part of every interface hash
LIMIT = 1200  # bytes of a sealed datagram: what every path carries without IP fragments
MOST_PAYLOAD = LIMIT - MAC_SIZE
MAX_ROBOTS = 128
MAX_ECHOES = 8
RELEASE_SIZE = 16  # bytes of the digest that names a release
MOST_FRAGMENTS = 256  # largest number of fragments of one entry or snapshot

TOP = 2**53
Token = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]
MaybeToken = Annotated[bytes, msgspec.Meta(max_length=8)]  # empty: not known yet
Release = Annotated[bytes, msgspec.Meta(max_length=RELEASE_SIZE)]  # empty: a bundle built without a fleet
Natural = Annotated[int, msgspec.Meta(ge=0, le=TOP)]
MaybeNatural = Annotated[int, msgspec.Meta(ge=-1, le=TOP)]  # -1: none
Shift = Annotated[int, msgspec.Meta(ge=-TOP, le=TOP)]
Pid = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
Short = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # a round number: enough for a year of rounds of 10 ms
MaybePerRobot = Annotated[tuple[Short, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
PerRobot = Annotated[tuple[Short, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Incarnations = Annotated[tuple[MaybeNatural, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Mask = Annotated[bytes, msgspec.Meta(max_length=MOST_FRAGMENTS // 8)]  # bit i of byte i // 8: fragment i is held
Data = Annotated[bytes, msgspec.Meta(max_length=LIMIT)]


class Wired(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Base of all messages: immutable (so never self-referential), encoded as an array, no extra fields."""


class Echo(Wired, frozen=True):
    """Echo of the newest datagram from `pid`: its stamp, and its arrival on the echoing robot's clock."""

    pid: Pid
    sent: Natural
    received: Natural


class Head(Wired, frozen=True):
    """Head of every datagram.

    boot: random id of the sender's process.
    sequence: number of the datagram, which increases within a boot.
    epoch: id of the mission; empty until the sender holds all robots' init results.
    fleet: fleet time minus the sender's clock; None if unknown.
    echoes: echoes of the peers' datagrams, included as often as the fleet clocks need them.
    """

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
    """New value of a shared variable; of an allread variable, the author's slot.

    `index` counts the program's shared variables. `patch`: `value` is what changed of the value's encoding since the
    beginning of the round (see module `patch`).
    """

    index: Annotated[int, msgspec.Meta(ge=0, lt=65536)]
    value: msgspec.Raw
    patch: bool = False


class Entry(Wired, frozen=True):
    """Log entry: `author` has ended the rounds `first` to `round`.

    With writes or `acted` these are one round; else the author did nothing in any of them, so the silence of a long
    outage is one entry. Round 0 is the result of `init`. `incarnation`: that of the author when it wrote the entry (see
    View). `stopped`: the author had stopped in all of the rounds. `acted`: an event of the author ended.
    `awaits_commit`: the author waits for reports that this round was applied. `lock`: the lock of an atomic event, of
    which one counts in each round; -1 for all others.
    """

    author: Pid
    incarnation: Natural
    first: Natural
    round: Natural
    stopped: bool = False
    acted: bool = False
    awaits_commit: bool = False
    lock: Annotated[int, msgspec.Meta(ge=-1, lt=65536)] = -1
    writes: Annotated[tuple[Write, ...], msgspec.Meta(max_length=256)] = ()


class View(Wired, frozen=True):
    """Members from round `since` on.

    `members[p]` is robot p's incarnation, which is the number of the view that admitted it last, or -1 if it is no
    member.
    """

    number: Natural
    since: Natural
    members: Incarnations


class Hello(Wired, frozen=True, tag=0):
    """Joining message from one robot to another.

    A boot counts as live only if `answer` repeats the `challenge` that the receiver has issued for it; each challenge
    is used once. `holds`: robots whose init result the sender holds. `release` names the bundles that were built
    together (see RELEASE in a bundle): a robot accepts only those of its own release."""

    head: Head
    to: Pid
    challenge: Token
    answer: MaybeToken
    holds: Annotated[tuple[Pid, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    init: Entry | None
    start: Natural | None  # of round 1, in fleet time
    release: Release = b""


class RoundMessage(Wired, frozen=True, tag=1):
    """Progress report and log entries.

    The sender is in `round` and uses view number `view`. It has applied all rounds up to `applied`, and holds robot p's
    entries up to `held[p]`; an empty `held` means `applied` for all, as in most rounds. All members hold everything up
    to `settled`. `emergency`: the sender knows of an emergency stop. `entries` may be of any robot."""

    head: Head
    view: Natural
    round: Natural
    applied: Natural
    settled: Natural
    emergency: bool
    held: MaybePerRobot
    entries: tuple[Entry, ...]


class HeldFragments(Wired, frozen=True):
    """Fragments of a robot's next entry that the sender holds."""

    author: Pid
    round: Natural
    digest: Token
    mask: Mask


class Nack(Wired, frozen=True, tag=2):
    """Progress report as in RoundMessage, and a request.

    The receiver shall send what the sender lacks up to round `through`, and its own progress report.
    """

    head: Head
    view: Natural
    through: Natural
    applied: Natural
    held: PerRobot
    received: Annotated[tuple[HeldFragments, ...], msgspec.Meta(max_length=8)]


class Fragment(Wired, frozen=True, tag=3):
    """Fragment of an encoded entry that is longer than a datagram.

    `digest` is the digest of the whole encoded entry."""

    head: Head
    author: Pid
    incarnation: Natural
    round: Natural
    digest: Token
    index: Annotated[int, msgspec.Meta(ge=0, lt=MOST_FRAGMENTS)]
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_FRAGMENTS)]
    data: Data


class Prepare(Wired, frozen=True, tag=4):
    """Ballot `ballot` for the successor of `view`, which is decided, begins.

    A robot that promises votes in no lower ballot, and applies no round until the successor is decided.
    """

    head: Head
    ballot: Natural
    view: View


class Promise(Wired, frozen=True, tag=5):
    """Answer to Prepare.

    view: number of the sender's latest view.
    applied: last round that it has reported as applied in that view.
    has_store: it still has the store of that round.
    accepted: view that it has voted for, in ballot `voted`; None without a vote.
    """

    head: Head
    number: Natural
    ballot: Natural
    view: Natural
    applied: Natural
    has_store: bool
    voted: Natural
    accepted: View | None


class Accept(Wired, frozen=True, tag=6):
    """Request to vote for a view."""

    head: Head
    ballot: Natural
    value: View


class Accepted(Wired, frozen=True, tag=7):
    """The sender has voted for the value of that ballot."""

    head: Head
    number: Natural
    ballot: Natural


class Decided(Wired, frozen=True, tag=8):
    """Announcement of a decided view: a majority has voted for it."""

    head: Head
    value: View


class RejoinRequest(Wired, frozen=True, tag=9):
    """Request of a robot that is no member or has no store.

    With `incarnation` -1 it asks to be admitted. Otherwise a view has admitted it with that incarnation, and it asks
    for the Snapshot; it already holds the fragments in `mask` of the snapshot after `round` with this `digest`."""

    head: Head
    view: Natural
    incarnation: MaybeNatural
    round: Natural
    digest: MaybeToken
    mask: Mask


class SnapshotFragment(Wired, frozen=True, tag=10):
    """Fragment number `index` of `count` of an encoded Snapshot. `digest` is the digest of the whole."""

    head: Head
    round: Natural
    digest: Token
    index: Annotated[int, msgspec.Meta(ge=0, lt=MOST_FRAGMENTS)]
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_FRAGMENTS)]
    data: Data


class Snapshot(Wired, frozen=True):
    """Shared store after round `applied`, for a robot that rejoins.

    `values[i]` is variable i's value, an allread variable's as the array of its slots. `stopped[p]`: the round in which
    robot p stopped, or -1. `acted[p]`: the last round in which an event of robot p counted.
    """

    view: View
    applied: Natural
    values: tuple[msgspec.Raw, ...]
    stopped: Incarnations
    acted: PerRobot


Ballots = Prepare | Promise | Accept | Accepted | Decided
ReplicaMessage = RoundMessage | Nack | Fragment | Ballots | RejoinRequest | SnapshotFragment
Message = Hello | ReplicaMessage
