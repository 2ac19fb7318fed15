"""Rejoin and state transfer, for a robot that is no member or has lost its store.

1. The robot asks all robots to admit it (RejoinRequest with incarnation -1). A view change gives it a new incarnation.
2. It closes its rounds with silent entries, so that no other robot waits for it.
3. It fetches a snapshot of the store, fragment by fragment, from one member at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from koordgen.runtime.net.codec import encoder, snapshot_of
from koordgen.runtime.net.fragments import Reassembly, cut, lacking
from koordgen.runtime.net.wire import Entry, RejoinRequest, Snapshot, SnapshotFragment, View
from koordgen.runtime.replication.messages import Send

TIMEOUT = 5  # ticks without a new fragment after which the robot asks another member for the snapshot
MOST_AT_ONCE = 16  # largest number of fragments that answer one request
SNAPSHOTS = 2  # number of snapshots kept for robots that have begun to fetch them


@dataclass(slots=True)
class Rejoin:
    """State of a robot that rejoins.

    since: number of the latest view that the robot knew when it was removed.
    fragments: received fragments of the snapshot that contains all rounds up to `round`.
    source: number that selects the member from which the snapshot is fetched.
    arrived: tick of the last new fragment, or of the last change of `source`.
    silent: entry that closes all rounds since the robot was admitted again; the robot ran no event in them.
    """

    pid: int
    since: int
    fragments: Reassembly | None = None
    round: int = 0
    source: int = 0
    arrived: int = 0
    silent: Entry | None = None

    def incarnation(self, view: View) -> int:
        """Return the robot's new incarnation; -1 if no view has admitted the robot again."""
        own = view.members[self.pid]
        return own if own > self.since else -1

    def silence(self, round_: int, view: View) -> Entry | None:
        """Return one silent entry for all rounds from the robot's admission up to `round_`.

        Return None if the robot was not admitted yet.
        """
        incarnation = self.incarnation(view)
        if incarnation < 0 or round_ < view.since:
            return None
        first = self.silent.first if self.silent is not None else view.since
        self.silent = Entry(self.pid, incarnation, first, round_)
        return self.silent

    def poll(self, tick: int, view: View) -> list[Send]:
        """Return a request for admission. Once the robot is admitted, return a request for snapshot fragments."""
        others = [p for p in range(len(view.members)) if p != self.pid]
        incarnation = self.incarnation(view)
        if incarnation < 0:
            return [Send(others, RejoinRequest, (view.number, -1, 0, b"", b""))]
        members = [p for p in others if view.members[p] >= 0]
        if tick - self.arrived > TIMEOUT:
            self.arrived, self.source, self.fragments = tick, self.source + 1, None
        if not members:
            return []
        known = self.fragments
        place = (0, b"", b"") if known is None else (self.round, known.name, known.mask)
        return [Send([members[self.source % len(members)]], RejoinRequest, (view.number, incarnation, *place))]

    def step(self, fragment: SnapshotFragment, tick: int) -> Snapshot | str | None:
        """Add a fragment. Return the snapshot once it is complete, the reason for a refusal, or else None."""
        if self.fragments is None:
            self.fragments, self.round = Reassembly(fragment.digest, fragment.count), fragment.round
        refused = self.fragments.add((fragment.digest, fragment.index, fragment.count, fragment.data))
        if refused is not None:
            return refused
        self.arrived = tick
        blob = self.fragments.blob()
        if blob is None:
            return None
        self.fragments = None
        return snapshot_of(blob) or "store does not fit"


class Snapshots:
    """Snapshots for robots that rejoin, encoded and cut into fragments of `room` bytes."""

    def __init__(self, room: int) -> None:
        self._room = room
        self._kept: list[tuple[int, list[tuple[bytes, int, int, bytes]]]] = []

    def answer(self, sender: int, want: RejoinRequest, applied: int, create: Callable[[], Snapshot]) -> list[Send]:
        """Return messages with the snapshot fragments that robot `sender` lacks.

        They belong to the snapshot that the robot has begun to fetch. If that snapshot is no longer kept, or the robot
        has begun none, they belong to a snapshot of the present store.

        applied: last round in the present store.
        create: function that creates a snapshot; called only if no snapshot of the present store is kept."""
        known = [k for k in self._kept if k[0] == want.round and k[1][0][0] == want.digest]
        if not known and (not self._kept or self._kept[-1][0] != applied):
            self._kept = [*self._kept[1 - SNAPSHOTS :], (applied, cut(encoder.encode(create()), self._room))]
        round_, fragments = known[0] if known else self._kept[-1]
        wanted: Sequence[int] = lacking(len(fragments), want.mask if known else b"")
        return [Send((sender,), SnapshotFragment, (round_, *fragments[index])) for index in wanted[:MOST_AT_ONCE]]
