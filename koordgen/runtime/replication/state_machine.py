"""Replicated state machine: one robot's copy of the shared store, and the logs that determine it.

S_r is the store at the beginning of round r. S_1 consists of the initial values and the results of all robots' `init`.
S_{r+1} is S_r after the entries of round r of all members are applied: first one transaction for each lock, then the
plain writes by instance (with one application: by ascending pid). So two robots that have applied the same rounds have
equal stores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import Contribution, Entry, EntryPart, Snapshot, View
from koordgen.runtime.replication.apply import Store, arbitrate, merge
from koordgen.runtime.replication.log import EntryLog, Logged
from koordgen.runtime.replication.schedule import Schedule

AHEAD = 8  # largest number of rounds by which a peer's clock may be ahead of this robot's clock
DROP_EVERY = 4  # rounds between two drops of settled entries, because each drop visits all logs
WINDOW = 256  # number of unsettled entries of one author at which the author runs no more events
NO_INCARNATION = -2  # a number that is never an incarnation
MOST_PAST = 16  # past stores that are no longer needed are dropped once so many are kept


class InstanceEvent:
    """Event of one of this robot's instances in a round: number `place` of those of the robot.

    shared: name in the program -> value that the event wrote. Other fields: see EntryPart.
    """

    __slots__ = ("lock", "place", "shared", "stopped")

    def __init__(self, place: int, shared: Mapping[str, Any], stopped: bool, lock: int) -> None:
        self.place, self.shared, self.stopped, self.lock = place, shared, stopped, lock


class StateMachine:
    """One robot's copy of the store, and the logs of all robots.

    Invariant: settled <= committed <= applied <= last own entry held."""

    def __init__(
        self,
        layout: Layout,
        pid: int,
        view: View,
        shared: Store,
        applied: int = 0,
        stopped: Mapping[int, int] | None = None,
        acted: Sequence[int] = (),
    ) -> None:
        self._layout = layout
        self._pid = pid
        self._n = layout.n_sys
        self._own = frozenset([author.number for author in layout.authors[pid]])
        self._schedule = Schedule(view)
        self.view = view  # latest view that this robot has adopted
        self.logs = [EntryLog(applied) for _ in range(self._n)]
        self.applied = applied  # last round that `shared` contains; `shared` is S_{applied + 1}
        self.committed = min(applied, view.since - 1)  # last committed round: no later view can leave it out
        self.settled = 0  # last round up to which every member holds all entries
        self.arrived = [0] * self._n  # for each robot, the round in which its last new entry arrived
        self.lacking = 0  # number of members whose entry of round applied + 1 is missing
        self._incarnations: Sequence[int] = ()  # for each robot, the incarnation that its entries must have
        self.is_frozen = False  # True: rounds of the next view must not be applied until that view is decided
        self.shared = shared
        self.stopped = dict(stopped or {})  # instance -> the round in which it stopped
        self.acted = list(acted) or [0] * layout.instances  # for each instance, the last round with a counted event
        self.won: dict[int, int] = {}  # instance of this robot -> last round in which its transaction won its lock
        self.awaiting: tuple[int, ...] = ()  # robots whose outputs wait for the commit of the last applied round
        self.unfit = 0  # number of patches that did not fit their value; all robots ignore the same patches
        self._past = [(applied, shared, self.acted)]  # stores to which a view change may rewind
        self._dropped = 0  # last round up to which settled entries were dropped
        self._update()

    @classmethod
    def begin(cls, layout: Layout, pid: int, view: View, inits: Sequence[Entry]) -> StateMachine:
        """Return the state machine at round 1, from the round-0 entries (results of `init`) of all robots."""
        state = cls(layout, pid, view, layout.initial())
        state._apply([Logged(e, layout.read(e) or ()) for e in sorted(inits, key=lambda e: e.author)], 0)
        state._past = [(0, state.shared, state.acted)]
        return state

    @classmethod
    def from_snapshot(cls, layout: Layout, pid: int, snapshot: Snapshot) -> StateMachine | None:
        """Return the state machine of a snapshot; None if the snapshot does not fit the program."""
        n = layout.n_sys
        shared = layout.unpack(snapshot.values)
        if shared is None or len(snapshot.view.members) != n:
            return None
        if not len(snapshot.stopped) == len(snapshot.acted) == layout.instances:
            return None
        stopped = {p: r for p, r in enumerate(snapshot.stopped) if r >= 0}
        return cls(layout, pid, snapshot.view, shared, snapshot.applied, stopped, snapshot.acted)

    def snapshot(self) -> Snapshot:
        """Return a snapshot of the store, for a robot that rejoins."""
        stopped = tuple([self.stopped.get(i, -1) for i in range(self._layout.instances)])
        return Snapshot(self._schedule.first, self.applied, self._layout.pack(self.shared), stopped, tuple(self.acted))

    # Methods that query the state.

    @property
    def held(self) -> tuple[int, ...]:
        """For each robot, the last round up to which its entries are held without a gap."""
        return tuple([log.held for log in self.logs])

    @property
    def is_full(self) -> bool:
        """True if this robot must run no event, because too many of its own entries are not settled."""
        log = self.logs[self._pid]
        return log.held - self.settled > WINDOW // 2 and len(log.kept) >= WINDOW

    @property
    def all_stopped(self) -> int | None:
        """First applied round by which all instances of members have stopped; None if one has not stopped."""
        authors, stopped = self._layout.authors, self.stopped
        rounds = [stopped.get(a.number) for p, m in enumerate(self.view.members) if m >= 0 for a in authors[p]]
        return None if None in rounds else max([r for r in rounds if r is not None], default=0)

    def missing(self, through: int) -> list[int]:
        """Return the members of which this robot lacks an entry up to round `through`."""
        if through <= self.applied and self._schedule.is_single:
            return []
        members = self.view.members
        return [p for p, log in enumerate(self.logs) if log.held < through and members[p] >= 0]

    def own(self, first: int) -> list[Entry]:
        """Return this robot's own entries from round `first` on."""
        log = self.logs[self._pid]
        return log.between(first, log.held)

    # Methods that add entries to the logs.

    def close(self, round_: int, shared: Mapping[str, Any], *, stopped: bool, acted: bool = False,
              awaits_commit: bool = False, lock: int = -1, parts: Sequence[InstanceEvent] = ()) -> Entry:  # fmt: skip
        """Append this robot's own entry of round `round_`, and return the entry.

        stopped: all instances of this robot have stopped.
        shared: name -> value that the round's event wrote.
        acted: an event ended in the round.
        lock: lock of a transaction; -1 for a plain event.
        parts: the round's events, for a robot with several instances, which passes no `shared`, `acted` and `lock`.
        Earlier rounds without an entry get a silent entry.
        """
        pid = self._pid
        log, first = self.logs[pid], self.logs[pid].held + 1
        if (shared or acted or lock >= 0 or parts) and first < round_:
            self.close(round_ - 1, {}, stopped=stopped)
            first = round_
        incarnation = self.view.members[pid]
        if parts:
            encoded, events = self._encoded(parts)
            entry = Entry(pid, incarnation, first, round_, stopped, True, awaits_commit, -1, encoded)
        else:
            writes, values = self._layout.written(shared, self.shared, pid) if shared else ((), ())
            entry = Entry(pid, incarnation, first, round_, stopped, acted, awaits_commit, lock, writes)
            events = []
            if writes or acted or lock >= 0:
                author = self._layout.authors[pid][0]
                events = [Contribution(author.number, author.pid, lock, acted, False, values or ())]
        log.append(entry, events)
        self._note_held(pid, first - 1)
        return entry

    def _encoded(self, parts: Sequence[InstanceEvent]) -> tuple[dict[int, EntryPart], list[Contribution]]:
        """Return the events of several own instances as parts of an entry, and as other robots decode them."""
        encoded: dict[int, EntryPart] = {}
        events: list[Contribution] = []
        for part in parts:
            author = self._layout.authors[self._pid][part.place]
            writes, values = self._layout.written(part.shared, self.shared, self._pid, part.place)
            encoded[author.application] = EntryPart(part.stopped, True, part.lock, writes)
            events.append(Contribution(author.number, author.pid, part.lock, True, part.stopped, values or ()))
        return encoded, events

    def append(self, entry: Entry, round_: int) -> str | None:
        """Append another robot's entry, which arrived in round `round_`. Return why it is refused, or None.

        An entry that is already held is ignored, not refused.
        """
        author, last = entry.author, entry.round
        if author >= self._n:
            return "entry does not fit"
        log = self.logs[author]
        held = log.held
        if last <= held:
            return None
        if not 1 <= entry.first <= last:
            return "entry does not fit"
        if last > round_ + AHEAD:
            return "entry too far ahead"
        if self._incarnations[author] != entry.incarnation:
            part = self._schedule.valid_part(entry)
            if part is None:
                return "entry of another view"
            if part.round <= held:
                return None
            entry = part
        if author == self._pid:
            return "entry of this robot from another robot"
        events = self._layout.read(entry)
        if events is None:
            return "entry does not fit"
        if len(log.kept) >= 2 * WINDOW or not log.has_room(entry.first):
            return "no room for an entry"
        log.append(entry, events)
        if log.held > held:
            self.arrived[author] = round_
            self._note_held(author, held)
        return None

    def _note_held(self, author: int, before: int) -> None:
        """Decrement `lacking` if the author's entry of round applied + 1 is held now and was not before."""
        if before <= self.applied < self.logs[author].held and self._schedule.first.members[author] >= 0:
            self.lacking -= 1

    def settle(self, through: int) -> None:
        """Record that every member holds all entries up to round `through`. Drop them, a few rounds at a time."""
        if through > self.settled:
            self.settled = through
            if through >= self._dropped + DROP_EVERY:
                self._dropped = through
                for log in self.logs:
                    log.drop(through)

    # Methods that apply rounds.

    def apply_rounds(self) -> bool:
        """Apply each next round whose entries are all held. Return whether a round was applied."""
        before = self.applied
        while not self.lacking and not (self.is_frozen and self.applied >= self.view.since - 1):
            round_ = self.applied + 1
            entries = [self.logs[p].at(round_) for p in self._schedule.members]
            through = round_
            if not entries[0].entry.acted and not any(e.is_single for e in entries):  # all entries are silent
                through = min(self._schedule.end(round_), min([e.entry.round for e in entries]))
            self._apply(entries, through)
        return self.applied > before

    def _apply(self, entries: Sequence[Logged], through: int) -> None:
        """Apply one entry of each member, by ascending pid, up to round `through`.

        Winning transactions are applied before plain writes. So a plain write overrides a transaction, and the plain
        write of the highest instance overrides other plain writes.
        """
        awaiting: list[int] = []
        stopping: list[tuple[int, int]] = []  # instances that stop, and the round
        contended = False
        events: list[Contribution] = []
        for logged in entries:
            entry = logged.entry
            if entry.awaits_commit and entry.round == through:
                awaiting.append(entry.author)
            for event in logged.events:
                events.append(event)
                if event.lock >= 0:
                    contended = True
            if entry.stopped:
                since = max(entry.first, self.applied + 1) if through else 0
                stopping += [(author.number, since) for author in self._layout.authors[entry.author]]
        self.awaiting = tuple(awaiting)
        if self._layout.is_composed:
            events.sort(key=_instance)
        if contended:
            commits, plain = arbitrate(events, through, self._layout.instances)
            self.won.update({e.instance: through for e in commits if e.instance in self._own})
            events = [*commits, *plain]
        stopping += [(event.instance, through) for event in events if event.stopped]
        shared, acted, unfit = merge(self._layout, events, through, self.shared, self.acted)
        self.unfit += unfit
        for instance, since in stopping:
            self.stopped.setdefault(instance, since)
        self.applied = through
        if shared is not self.shared or acted is not self.acted:
            self.shared, self.acted = shared, acted
            self._keep_past()
        self._update()

    def _keep_past(self) -> None:
        """Keep the present store for `rewind`, and drop stores that are older than the last committed store."""
        past = self._past
        if len(past) >= MOST_PAST:
            for index in range(len(past) - 1, 0, -1):
                if past[index][0] <= self.committed:
                    del past[:index]
                    break
        past.append((self.applied, self.shared, self.acted))

    def _update(self) -> None:
        """Update the values that depend on the last applied round and on the view."""
        if not self._schedule.is_single:
            self._schedule.skip_absences(self.logs)
            self._schedule.drop(self.applied)
        # While several views are scheduled, `valid_part` must check each entry.
        self._incarnations = self.view.members if self._schedule.is_single else (NO_INCARNATION,) * self._n
        self._count()

    def _count(self) -> None:
        logs, applied = self.logs, self.applied
        self.lacking = len([p for p in self._schedule.members if logs[p].held <= applied])

    # Methods that change the view.

    def adopt(self, view: View) -> None:
        """Switch to the next view.

        Entries for rounds of the new view are dropped if their author was removed or has a new incarnation."""
        self._truncate(view)
        self._schedule.append(view)
        self.view = view
        self.is_frozen = False
        self._update()

    def rewind(self, view: View) -> bool:
        """Switch to the next view, and rewind the store to the beginning of that view.

        A robot must rewind if it has applied rounds that the new view discards. Its events in them do not count.
        Return False if the store to rewind to is no longer kept."""
        last = view.since - 1
        found = next(((shared, acted) for round_, shared, acted in reversed(self._past) if round_ <= last), None)
        if found is None or self.applied < last:
            return False
        self._truncate(view)
        for log in self.logs:
            log.skip(last)
        self._schedule, self.view = Schedule(view), view
        self.is_frozen = False
        self.shared, self.acted = found
        self.applied = last
        self.committed = min(self.committed, last)
        self.settled = min(self.settled, last)
        self.stopped = {instance: r for instance, r in self.stopped.items() if r <= last}
        self.won, self.awaiting = {}, ()
        self._past = [(last, *found)]
        self._update()
        return True

    def _truncate(self, view: View) -> None:
        for log, old, new in zip(self.logs, self.view.members, view.members, strict=True):
            if old != new:
                log.truncate(view.since - 1)


def _instance(event: Contribution) -> int:
    return event.instance
