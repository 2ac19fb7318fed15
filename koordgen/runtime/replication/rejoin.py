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

PATIENCE = 5  # ticks without a new fragment, after which the robot asks another member
MOST_AT_ONCE = 16  # largest number of fragments that answer one request
SNAPSHOTS = 2  # number of snapshots kept for robots that have begun to fetch them


@dataclass(slots=True)
class Rejoin:
    """State of a robot that rejoins.

    since: number of the view that the robot knew when it was removed.
    fragments: fragments received of the snapshot that contains all rounds up to `round`.
    source: number that selects the member from which the snapshot is fetched.
    arrived: tick of the last new fragment, or of the last change of `source`.
    silent: entry that closes the rounds since the robot was admitted again, in which it ran no event.
    """

    pid: int
    since: int
    fragments: Reassembly | None = None
    round: int = 0
    source: int = 0
    arrived: int = 0
    silent: Entry | None = None

    def incarnation(self, view: View) -> int:
        """Return the incarnation under which the robot was admitted again; -1 if it was not."""
        own = view.members[self.pid]
        return own if own > self.since else -1

    def silence(self, round_: int, view: View) -> Entry | None:
        """Return one silent entry for all rounds since the admission up to `round_`.

        None before the admission.
        """
        incarnation = self.incarnation(view)
        if incarnation < 0 or round_ < view.since:
            return None
        first = self.silent.first if self.silent is not None else view.since
        self.silent = Entry(self.pid, incarnation, first, round_)
        return self.silent

    def poll(self, tick: int, view: View) -> list[Send]:
        """Return a request for admission, or, once admitted, for the missing fragments of the snapshot."""
        others = [p for p in range(len(view.members)) if p != self.pid]
        incarnation = self.incarnation(view)
        if incarnation < 0:
            return [Send(others, RejoinRequest, (view.number, -1, 0, b"", b""))]
        members = [p for p in others if view.members[p] >= 0]
        if tick - self.arrived > PATIENCE:
            self.arrived, self.source, self.fragments = tick, self.source + 1, None
        if not members:
            return []
        known = self.fragments
        place = (0, b"", b"") if known is None else (self.round, known.name, known.mask)
        return [Send([members[self.source % len(members)]], RejoinRequest, (view.number, incarnation, *place))]

    def step(self, fragment: SnapshotFragment, tick: int) -> Snapshot | str | None:
        """Add a fragment. Return the snapshot if complete, a reason if the fragment is refused, else None."""
        if self.fragments is None:
            self.fragments, self.round = Reassembly(fragment.digest, fragment.count), fragment.round
        refused = self.fragments.take((fragment.digest, fragment.index, fragment.count, fragment.data))
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

    def answer(self, sender: int, want: RejoinRequest, applied: int, take: Callable[[], Snapshot]) -> list[Send]:
        """Return messages with the fragments that `sender` lacks of the snapshot that it has begun to fetch.

        If that snapshot is no longer kept, or `sender` has begun none, a snapshot of the present store is used. The
        store contains all rounds up to `applied`. `take` creates the snapshot; it is called only if none of that round
        is kept."""
        known = [k for k in self._kept if k[0] == want.round and k[1][0][0] == want.digest]
        if not known and (not self._kept or self._kept[-1][0] != applied):
            self._kept = [*self._kept[1 - SNAPSHOTS :], (applied, cut(encoder.encode(take()), self._room))]
        round_, fragments = known[0] if known else self._kept[-1]
        wanted: Sequence[int] = lacking(len(fragments), want.mask if known else b"")
        return [Send((sender,), SnapshotFragment, (round_, *fragments[index])) for index in wanted[:MOST_AT_ONCE]]
