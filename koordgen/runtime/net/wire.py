"""Wire format: the messages of the shared memory as typed structs. `codec` encodes them as datagrams.

Times are microseconds. A time `sent` or `received` is on the clock of the robot that recorded it. Decoding checks types
and ranges; `link` and the package `replication` check the meaning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec

from koordgen.runtime.net.seal import MAC_SIZE

WIRE_FORMAT = 4  # raised whenever the meaning of a datagram changes; part of every interface hash
LIMIT = 1200  # largest size of a sealed datagram in bytes, so that no network splits it into IP fragments
MOST_PAYLOAD = LIMIT - MAC_SIZE
MAX_ROBOTS = 128
MAX_INSTANCES = 1024  # largest number of instances (an application on a robot) in a fleet
MOST_WRITES = 256  # largest number of shared variables, and therefore of writes in an entry
MAX_ECHOES = 8
RELEASE_SIZE = 16  # bytes of the digest that names a release
MOST_FRAGMENTS = 256  # largest number of fragments of one entry or snapshot

TOP = 2**53
Token = Annotated[bytes, msgspec.Meta(min_length=8, max_length=8)]
MaybeToken = Annotated[bytes, msgspec.Meta(max_length=8)]  # empty: the token is not known yet
Release = Annotated[bytes, msgspec.Meta(max_length=RELEASE_SIZE)]  # empty: the bundle was built without a fleet file
Natural = Annotated[int, msgspec.Meta(ge=0, le=TOP)]
MaybeNatural = Annotated[int, msgspec.Meta(ge=-1, le=TOP)]  # -1: no number
Shift = Annotated[int, msgspec.Meta(ge=-TOP, le=TOP)]
Pid = Annotated[int, msgspec.Meta(ge=0, lt=MAX_ROBOTS)]
Short = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]  # a round number: enough for a year of rounds of 10 ms
MaybePerRobot = Annotated[tuple[Short, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
PerRobot = Annotated[tuple[Short, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Incarnations = Annotated[tuple[MaybeNatural, ...], msgspec.Meta(min_length=1, max_length=MAX_ROBOTS)]
Stops = Annotated[tuple[MaybeNatural, ...], msgspec.Meta(max_length=MAX_INSTANCES)]
LastEvents = Annotated[tuple[Short, ...], msgspec.Meta(max_length=MAX_INSTANCES)]
# Bit i % 8 of byte i // 8 is 1 if fragment i was received.
Mask = Annotated[bytes, msgspec.Meta(max_length=MOST_FRAGMENTS // 8)]
Data = Annotated[bytes, msgspec.Meta(max_length=LIMIT)]


class Wired(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Base of all messages: immutable, encoded as an array, without unknown fields.

    An immutable struct cannot contain itself, so the garbage collector need not track it (gc=False).
    """


class Echo(Wired, frozen=True):
    """Echo of the newest datagram from robot `pid`.

    sent: time stamp of that datagram, on the clock of robot `pid`.
    received: arrival time of that datagram, on the clock of the robot that sends the echo.
    """

    pid: Pid
    sent: Natural
    received: Natural


class Head(Wired, frozen=True):
    """Head of every datagram.

    boot: random id of the sender's process.
    sequence: number of the datagram; it increases within a boot.
    epoch: id of the mission; empty until the sender holds the `init` results of all robots.
    sent: time at which the datagram was sent, on the sender's clock.
    fleet: fleet time minus the sender's clock; None if unknown.
    echoes: echoes of the peers' datagrams, sent as often as the fleet clocks need them.
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
    """Write of a shared variable: its new value.

    For an allread variable, the new value is that of the author's slot.

    index: place of the variable among the program's shared variables.
    patch: `value` is not the encoded value but a patch to the value at the beginning of the round (module `patch`).
    """

    index: Annotated[int, msgspec.Meta(ge=0, lt=65536)]
    value: msgspec.Raw
    patch: bool = False


Writes = Annotated[tuple[Write, ...], msgspec.Meta(max_length=MOST_WRITES)]
ApplicationNumber = Annotated[int, msgspec.Meta(ge=0, lt=MAX_INSTANCES)]
Lock = Annotated[int, msgspec.Meta(ge=-1, lt=65536)]


class EntryPart(Wired, frozen=True):
    """Part of an entry: the event of one instance, of a robot that runs several applications.

    stopped: the instance has stopped in this round.
    acted: an event of the instance ended in the round.
    lock: lock of a transaction, of which one counts in each round; -1 without a transaction.
    """

    stopped: bool
    acted: bool
    lock: Lock
    writes: Writes


Parts = Annotated[dict[ApplicationNumber, EntryPart], msgspec.Meta(min_length=1, max_length=MAX_INSTANCES)]


class Entry(Wired, frozen=True):
    """Log entry: `author` has ended the rounds `first` to `round`.

    An entry with writes, `acted` or a lock covers exactly one round. A silent entry may cover many rounds, so a long
    outage is one entry. The entry of round 0 contains the result of `init`.

    incarnation: incarnation of the author when it wrote the entry (see View).
    stopped: the author had stopped in all of these rounds, with all its instances.
    acted: an event of the author ended in the round.
    awaits_commit: the author waits for reports that the round was applied.
    lock: lock of a transaction, of which one counts in each round; -1 without a transaction, or with parts.
    writes: writes of the author's only instance. An author with several instances has here a part for each instance
        that had an event, by the number of its application.
    """

    author: Pid
    incarnation: Natural
    first: Natural
    round: Natural
    stopped: bool = False
    acted: bool = False
    awaits_commit: bool = False
    lock: Lock = -1
    writes: Writes | Parts = ()


class Contribution(msgspec.Struct, frozen=True, gc=False):
    """Event of one instance in a round, decoded from an entry. It is not sent.

    instance: number of the instance.
    slot: the instance's slot in the allread variables of its application.
    acted, stopped, lock: see EntryPart. If the author has only this instance, the entry says whether it has stopped.
    values: the event's writes, as pairs (index of the variable, value); a patch is a layout.Unpatched.
    """

    instance: int
    slot: int
    lock: int
    acted: bool
    stopped: bool
    values: Sequence[tuple[int, Any]]


class View(Wired, frozen=True):
    """View number `number`: the members of the fleet from round `since` on.

    `members[p]` is the incarnation of robot p: the number of the view that admitted the robot last. It is -1 if robot p
    is no member.
    """

    number: Natural
    since: Natural
    members: Incarnations


class Hello(Wired, frozen=True, tag=0):
    """Joining message from one robot to another.

    challenge: random token of the sender, which the receiver must repeat. Each token is used once.
    answer: last challenge that the receiver of this Hello has sent. A boot counts as live only if its answer is right.
    holds: robots whose `init` result the sender holds.
    init: round-0 entry of the sender; None if the sender's process has not run `init`.
    release: digest of the bundles that were built together. A robot accepts only messages of its own release."""

    head: Head
    to: Pid
    challenge: Token
    answer: MaybeToken
    holds: Annotated[tuple[Pid, ...], msgspec.Meta(max_length=MAX_ROBOTS)]
    init: Entry | None
    start: Natural | None  # start of round 1 in fleet time
    release: Release = b""


class RoundMessage(Wired, frozen=True, tag=1):
    """Progress report and log entries.

    view: number of the sender's view.
    round: the sender's present round.
    applied: last round that the sender has applied.
    settled: last round up to which all members hold all entries.
    emergency: the sender knows of an emergency stop.
    held: `held[p]` is the last round up to which the sender holds robot p's entries; empty: `applied` for all robots.
    entries: log entries of any robots."""

    head: Head
    view: Natural
    round: Natural
    applied: Natural
    settled: Natural
    emergency: bool
    held: MaybePerRobot
    entries: tuple[Entry, ...]


class HeldFragments(Wired, frozen=True):
    """Report of the fragments of one entry that the sender of the report has received.

    `author`, `round` and `digest` identify the entry. Bit i % 8 of byte i // 8 of `mask` is 1 if fragment i was
    received."""

    author: Pid
    round: Natural
    digest: Token
    mask: Mask


class Nack(Wired, frozen=True, tag=2):
    """Progress report as in RoundMessage, and a request for missing entries.

    The receiver is asked to send the entries up to round `through` that the sender lacks, and its own progress report.
    """

    head: Head
    view: Natural
    through: Natural
    applied: Natural
    held: PerRobot
    received: Annotated[tuple[HeldFragments, ...], msgspec.Meta(max_length=8)]


class Fragment(Wired, frozen=True, tag=3):
    """Fragment number `index` of `count` of an encoded entry that is longer than a datagram.

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
    """Request to promise for ballot `ballot` on the successor of `view`. `view` is decided.

    A robot that promises votes in no lower ballot, and applies no round until the successor is decided.
    """

    head: Head
    ballot: Natural
    view: View


class Promise(Wired, frozen=True, tag=5):
    """Promise of an acceptor, the answer to Prepare.

    number: number of the view that the promise is for.
    view: number of the sender's latest view.
    applied: last round that the sender has reported as applied in view `view`.
    has_store: the sender still has the store of round `applied`.
    accepted: view that the sender has voted for in ballot `voted`; None without a vote.
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
    """Request to vote for view `value` in ballot `ballot`."""

    head: Head
    ballot: Natural
    value: View


class Accepted(Wired, frozen=True, tag=7):
    """Vote of an acceptor, the answer to Accept: for view number `number` as proposed in ballot `ballot`."""

    head: Head
    number: Natural
    ballot: Natural


class Decided(Wired, frozen=True, tag=8):
    """Announcement that view `value` is decided, because a majority has voted for it."""

    head: Head
    value: View


class RejoinRequest(Wired, frozen=True, tag=9):
    """Request of a robot that is no member or has no store.

    With `incarnation` -1, the robot asks to be admitted. Otherwise a view has admitted the robot with `incarnation`,
    and the robot asks for fragments of a Snapshot. It already has the fragments in `mask` of the snapshot after round
    `round` with digest `digest`."""

    head: Head
    view: Natural
    incarnation: MaybeNatural
    round: Natural
    digest: MaybeToken
    mask: Mask


class SnapshotFragment(Wired, frozen=True, tag=10):
    """Fragment number `index` of `count` of an encoded Snapshot.

    `digest` is the digest of the whole encoded snapshot."""

    head: Head
    round: Natural
    digest: Token
    index: Annotated[int, msgspec.Meta(ge=0, lt=MOST_FRAGMENTS)]
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_FRAGMENTS)]
    data: Data


class Snapshot(Wired, frozen=True):
    """Shared store after round `applied`, for a robot that rejoins.

    values: `values[i]` is the encoded value of variable i; for an allread variable, the array of its slots.
    stopped: `stopped[i]` is the round in which instance i stopped, or -1.
    acted: `acted[i]` is the last round in which an event of instance i counted.
    """

    view: View
    applied: Natural
    values: tuple[msgspec.Raw, ...]
    stopped: Stops
    acted: LastEvents


Ballots = Prepare | Promise | Accept | Accepted | Decided
ReplicaMessage = RoundMessage | Nack | Fragment | Ballots | RejoinRequest | SnapshotFragment
Message = Hello | ReplicaMessage
