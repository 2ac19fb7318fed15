"""Replica: one robot's part in the protocol, as a pure state machine.

Inputs are messages (`step`), time (`tick`) and the robot's own rounds (`propose`). `ready` returns the work that
results: data to persist, messages to send and progress to act on. A replica uses no clock, network, disk or
randomness; `driver` uses them on its behalf.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from koordgen.runtime.net.assembly import Assembly
from koordgen.runtime.net.layout import Layout
from koordgen.runtime.net.wire import (
    Ballots,
    Decided,
    Entry,
    Fragment,
    Nack,
    RejoinRequest,
    ReplicaMessage,
    RoundMessage,
    Snapshot,
    SnapshotFragment,
    View,
)
from koordgen.runtime.program.runner import NOT_CURRENT
from koordgen.runtime.replication.failure_detector import FailureDetector
from koordgen.runtime.replication.messages import NO_PARTS, Applied, HardState, Ready, Send
from koordgen.runtime.replication.progress import Progress, commit_index, majority
from koordgen.runtime.replication.rejoin import Rejoin, Snapshots
from koordgen.runtime.replication.retransmission import (
    RetransmissionPolicy,
    is_fleet_late,
    is_helper,
    recipients,
    some,
)
from koordgen.runtime.replication.state_machine import AHEAD, InstanceEvent, StateMachine
from koordgen.runtime.replication.views import Report, Views, is_possible

TICKS = 5  # number of ticks in a round
REQUEST_TICK = 3  # first tick of a round at which entries of that round are requested, not only earlier entries
JOIN_TICKS = 3 * TICKS  # ticks for which a request to join is valid
HEARD_TICKS = 2 * TICKS  # ticks for which a robot counts as reachable after a message
SETTLE_AFTER = 3  # number of rounds by which `settled` must lag behind `applied` to be computed again


class Replica:
    """Replica of one robot.

    state: the robot's copy of the store. None if the robot has no valid copy: its process restarted, or a view has
        removed the robot.
    hard_state: the last persisted hard state.
    peer_timeout: rounds without entries after which a member is suspected.
    room: largest number of bytes that a datagram has for a fragment of a snapshot.
    """

    def __init__(
        self,
        pid: int,
        layout: Layout,
        state: StateMachine | None,
        hard_state: HardState,
        peer_timeout: int,
        room: int,
    ) -> None:
        self.pid, self._n = pid, layout.n_sys
        self._layout = layout
        self._peer_timeout = peer_timeout  # rounds without entries after which a member is suspected
        self._others = tuple([p for p in range(self._n) if p != pid])
        self.peers = {p: Progress() for p in self._others}
        self._tick, self.round = 0, 1  # present tick and present round
        self.state = state
        # Store at the beginning of the view that removed this robot. The robot continues with this store if the next
        # view admits the robot and the store can be rewound to the beginning of that view.
        self._spare: StateMachine | None = None
        self.rejoin = None if state is not None else Rejoin(pid, hard_state.view.number)
        self.acknowledged = hard_state.applied  # last round that this robot may have reported as applied
        self.views = Views(pid, hard_state.view, hard_state.vote, self.promise_report, self._holds_all, self._adopted)
        self.policy = RetransmissionPolicy(pid, self._n)
        self._detector = FailureDetector(self._n, self.round)
        self._assembly = Assembly()
        self._snapshots = Snapshots(room)
        self._turn = pid  # number that increases with each request, to select a different recipient each time
        self._join_asked = -JOIN_TICKS  # tick at which any robot last asked to join
        self.published = hard_state.applied if state is None else state.logs[pid].held  # last own round that was sent
        self.emergency = False  # True once this robot knows of an emergency stop
        self.store_changes = 0  # number of times that the store was replaced or lost
        self._persisted = hard_state
        self._applied = Applied(-1, -1)  # progress that `ready` has returned last
        self._private: object = None
        self._sends: list[Send] = []
        self._rejected: list[str] = []
        self._requested: list[int] = []
        self._moved = 0, self.round  # the last applied round, and the round in which it was applied
        self._has_progress = True  # peers' reports, the applied round or the view have changed since the last `ready`

    # Properties that other packages read.

    @property
    def is_out(self) -> bool:
        """True if this robot has no valid store: it restarted, was removed from the fleet, or lost the store."""
        return self.state is None

    @property
    def is_busy(self) -> bool:
        """True if the next tick may have work to do for a rejoin or a view change."""
        return self.rejoin is not None or self.views.is_busy

    @property
    def status(self) -> str:
        """Reason why this robot has no store, as text for users."""
        if self.rejoin is not None and self.rejoin.incarnation(self.views.view) >= 0:
            return f"{NOT_CURRENT}: admitted again, receives the shared store"
        return f"{NOT_CURRENT}: removed from the fleet, asks to rejoin"

    @property
    def laggard(self) -> int:
        """Pid of the member whose reports show the fewest applied rounds."""
        applied = self._member_progress()
        return min(applied, key=lambda p: applied[p], default=self.pid)

    def unaware(self, round_: int) -> list[int]:
        """Return the other members that have not reported round `round_` as applied."""
        return [p for p, applied in self._member_progress().items() if applied < round_]

    def _member_progress(self) -> dict[int, int]:
        """Return pid -> last round that a member has reported as applied in the present view; -1: no report."""
        view = self.views.view
        return {
            p: peer.applied if peer.view == view.number else -1
            for p, peer in self.peers.items()
            if view.members[p] >= 0
        }

    # Methods that return work to the driver.

    def ready(self) -> Ready:
        """Return the work since the last call: data to persist, messages to send and new progress."""
        apply = self._new_progress() if self._has_progress else None
        view, vote, persisted, persist = self.views.view, self.views.vote, self._persisted, None
        if view is not persisted.view or vote is not persisted.vote or self.acknowledged != persisted.applied:
            self._persisted = persist = HardState(view, self.acknowledged, vote)
        ready = Ready(persist, self._private, self._sends, apply, self._rejected, self._requested)
        self._private = None
        if self._sends:
            self._sends = []
        if self._rejected:
            self._rejected = []
        if self._requested:
            self._requested = []
        return ready

    def _new_progress(self) -> Applied | None:
        """Update the commit index. Return the last applied and committed rounds; None if both are unchanged."""
        self._has_progress = False
        state, known = self.state, self._applied
        if state is None:
            return None
        applied = self.acknowledged = state.applied
        committed = commit_index(self.peers.values(), self.views.view, applied)
        if committed > state.committed:
            state.committed = committed
        if applied == known.applied and state.committed == known.committed:
            return None
        self._applied = Applied(applied, state.committed)
        return self._applied

    def _send(self, sends: Sequence[Send]) -> None:
        self._sends += [send for send in sends if send.to]

    def _send_round(self, to: Sequence[int], round_: int, entries: Sequence[Entry] = (),
                    received: Mapping[int, Any] = NO_PARTS) -> None:  # fmt: skip
        """Send a round message to robots `to`: the progress report of round `round_`, and `entries`."""
        if to:
            self._sends.append(Send(to, RoundMessage, (*self._progress_report(round_), tuple(entries)), received))

    def _progress_report(self, round_: int) -> tuple[int, int, int, int, bool, tuple[int, ...]]:
        """Return the fields of a RoundMessage between its head and its entries."""
        state = self.state
        if state is None:
            return self.views.view.number, 0, self.acknowledged, 0, self.emergency, (0,) * self._n
        held = state.held if state.applied < round_ - 1 else ()  # empty: all entries up to `applied` are held
        return state.view.number, round_, state.applied, state.settled, self.emergency, held

    def _reject(self, reason: str) -> None:
        self._rejected.append(reason)

    # Methods for the rounds of this robot.

    def skip_rounds(self, through: int, stopped: bool) -> None:
        """Close the rounds up to `through`, during which the robot did not run, with a silent entry.

        The silent entry is sent together with the robot's next entry.
        """
        state = self.state
        if state is not None and state.logs[self.pid].held < through:
            state.close(through, {}, stopped=stopped)

    def propose(self, round_: int, shared: Mapping[str, Any], *, stopped: bool, acted: bool = False,
                awaits_commit: bool = False, lock: int = -1, private: object = None,
                parts: Sequence[InstanceEvent] = ()) -> None:  # fmt: skip
        """Close round `round_` and send this robot's entry of the round. Parameters: see StateMachine.close.

        `private` is persisted before the entry is sent. Peers that lack older entries also get these older entries,
        unless this robot is late.
        """
        self._private = private
        first, self.published = self.published + 1, round_
        state = self.state
        if state is None:
            silent = None if self.rejoin is None else self.rejoin.silence(round_, self.views.view)
            self._send_round(self._others, round_, () if silent is None else (silent,))
            return
        entry = state.close(
            round_, shared, stopped=stopped, acted=acted, awaits_commit=awaits_commit, lock=lock, parts=parts
        )
        own: Sequence[Entry] = (entry,) if entry.first <= first else state.own(first)
        served: list[int] = []
        lacking = [] if self.policy.is_strained(round_) else [p for p, peer in self.peers.items() if peer.lacks]
        for pid in some(lacking, round_):
            repeated = self._lacked_entries(state, pid, is_helper(self.pid, pid, round_, self._n))
            if repeated:
                last = max([e.round for e in repeated if e.author == self.pid], default=0)
                entries = [*(e for e in own if e.round > last), *repeated]
                self._send_round([pid], round_, entries, self.peers[pid].received)
                served.append(pid)
        self._send_round([p for p in self._others if p not in served] if served else self._others, round_, own)

    def send_report(self, round_: int) -> None:
        """Send a progress report to all robots."""
        self._send_round(self._others, round_)

    def acknowledge(self, round_: int) -> None:
        """Send a progress report to the robots whose outputs of the last applied round wait for a commit."""
        if self.state is not None:
            self._send_round([p for p in self.state.awaiting if p != self.pid], round_)

    def declare_emergency(self) -> None:
        """Announce an emergency stop now, and in every later round message."""
        self.emergency = True
        self._send_round(self._others, 0)

    def request(self, tick: int, on_time: bool, awaited: int | None) -> bool:
        """Request missing entries and reports. Return whether a request was sent.

        tick: tick within the present round.
        on_time: the robot woke when it was due.
        awaited: round whose commit the robot waits for, or None. Reports are requested from members that have not
            reported this round as applied.
        """
        state, round_ = self.state, self.round
        if state is None:
            return False
        through = round_ if tick >= REQUEST_TICK else round_ - 1
        missing = [p for p in state.missing(through) if p != self.pid]
        unaware = self.unaware(awaited) if awaited is not None and (awaited < through or tick >= 1) else []
        self.policy.wakes(round_, on_time and not is_fleet_late(len(missing), self._n))
        if not (missing or unaware) or not self.policy.asks(round_, on_time, self._is_lost(state, missing)):
            return False
        self._turn += 1
        authors, groups = recipients(missing, unaware, self._others, self._turn)
        self._requested += authors
        view, _, applied, *_ = self._progress_report(through)
        need = view, through, applied, state.held, self._assembly.received()
        self._send([Send(to, Nack, need) for to in groups])
        return True

    def _is_lost(self, state: StateMachine, missing: Sequence[int]) -> bool:
        """Return whether entries of the robots `missing` are known to be lost.

        Entries are lost if later entries of their author have arrived, or if a peer has applied more rounds.
        """
        applied = max([peer.applied for peer in self.peers.values()], default=0)
        return any(state.logs[p].later or state.logs[p].held < applied for p in missing)

    def _lacked_entries(self, state: StateMachine, pid: int, helps: bool) -> list[Entry]:
        """Return the entries that peer `pid` lacked by its last report. Each report is answered once.

        helps: also return entries of other authors. This robot's own entries come first, so that several robots that
            answer at the same time begin with different entries.
        """
        peer = self.peers[pid]
        if not peer.lacks or state.view.members[pid] < 0:
            return []
        peer.lacks = False
        found: list[Entry] = []
        for author in (*range(self.pid, self._n), *range(self.pid)) if helps else (self.pid,):
            low = max(peer.holds(author), state.settled) + 1
            if low <= peer.wanted:
                found += state.logs[author].between(low, peer.wanted)
        return found

    # Methods for the work at each tick.

    def tick(self, tick: int) -> bool:
        """Begin tick `tick`; ticks are counted from the beginning of round 1.

        Check for robots that are suspected or want to join, and continue this robot's own rejoin. Return False if no
        work resulted, as at the beginning of most rounds."""
        self._tick = self.views.tick = tick
        self.round = tick // TICKS + 1
        if self.emergency:
            self._send_round(self._others, self.round)
        if tick % TICKS == 0 and self._is_calm():
            return self.emergency
        since = tick - HEARD_TICKS
        if 1 + len([peer for peer in self.peers.values() if peer.heard > since]) < majority(self._n):
            self._detector.restart_all(self.round)
            self._moved = -1, self.round
        else:
            joining = [p for p, peer in self.peers.items() if peer.asked_to_join > tick - JOIN_TICKS]
            self._send(self.views.poll(tick, self._suspects(), joining))
            self._freeze()
            if self._is_stranded():
                self._lose_store(self.views.view.number)
        if self.rejoin is not None:
            self._send(self.rejoin.poll(tick, self.views.view))
        return True

    def _is_calm(self) -> bool:
        """Return whether all entries have arrived in time and no robot needs a view change or a rejoin."""
        calm = not self.is_busy and self._join_asked <= self._tick - JOIN_TICKS
        return calm and self.state is not None and self.state.applied >= self.round - 1

    def _is_stranded(self) -> bool:
        """Return whether this robot lacks entries that it will never get.

        The condition: for 2 * `peer_timeout` rounds this robot has heard a majority but applied no round, and a
        majority has applied more. Robots that had the missing entries have failed since, or received the effects in a
        snapshot. A majority without this robot has all committed rounds, so this robot may discard its store and
        rejoin.
        """
        state = self.state
        if state is None or state.applied != self._moved[0] or not state.lacking:
            self._moved = -1 if state is None else state.applied, self.round
            return False
        if self.views.is_frozen or self.round <= self._moved[1] + 2 * self._peer_timeout:
            return False
        ahead = [p for p, peer in self.peers.items() if peer.view == state.view.number and peer.applied > state.applied]
        return len(ahead) >= majority(self._n)

    def _suspects(self) -> list[int]:
        if self.state is None:
            return []
        last = self.round - self._peer_timeout
        missing = [p for p in self.state.missing(last - 1) if p != self.pid]
        return self._detector.suspects(missing, self.state.arrived, last)

    def apply_rounds(self) -> bool:
        """Apply all rounds whose entries have arrived. Return whether a round was applied."""
        state = self.state
        if state is None or not state.apply_rounds():
            return False
        self._has_progress = True
        if state.applied >= state.settled + SETTLE_AFTER:
            state.settle(min([state.applied, *self._member_progress().values()]))
        return True

    # Methods that handle messages of other robots.

    def step(self, message: ReplicaMessage) -> None:
        """Handle a message of another robot. The link has checked that it is authentic and of this mission."""
        sender = message.head.pid
        peer = self.peers[sender]
        peer.heard = self._tick
        match message:
            case RoundMessage():  # most frequent, so it is tested first
                self._round(sender, peer, message)
            case Nack():
                self._need(sender, peer, message)
            case Fragment():
                self._fragment(message)
            case RejoinRequest():
                self._want(sender, message)
            case SnapshotFragment():
                self._state_fragment(message)
            case _:
                self._ballot(sender, message)

    def _round(self, sender: int, peer: Progress, message: RoundMessage) -> None:
        view, state, round_, settled = message.view, self.state, self.round, message.settled
        if message.emergency:
            self.emergency = True
        if view < self.views.view.number:
            self._inform(sender, view)
        if state is None:
            return
        for entry in message.entries:
            refused = state.append(entry, round_)
            if refused is not None:
                self._reject(refused)
        wanted = message.round - 1
        if not self._is_possible(message.applied, message.held, wanted if wanted > settled else settled):
            return
        if peer.report(view, message.applied, message.held, wanted, again=False):
            self._has_progress = True
        if settled > state.settled and view == state.view.number:
            state.settle(min(settled, state.applied))

    def _is_possible(self, applied: int, held: Sequence[int], latest: int) -> bool:
        """Return whether a progress report names only rounds that are possible now.

        If not, a rejection is counted.

        latest: greatest round in the report besides `applied` and `held`.
        """
        last = self.round + AHEAD
        if applied <= last and latest <= last and (not held or (len(held) == self._n and max(held) <= last)):
            return True
        self._reject("report does not fit")
        return False

    def _need(self, sender: int, peer: Progress, message: Nack) -> None:
        self._inform(sender, message.view)
        state, through = self.state, message.through
        if state is None:
            return
        if not self._is_possible(message.applied, message.held, through):
            return
        if peer.report(message.view, message.applied, message.held, through, again=True):
            self._has_progress = True
        received = peer.received = {p.author: p for p in message.received}
        has_ours = message.held[self.pid] >= through  # the sender needs only entries of other robots
        helps = has_ours or is_helper(self.pid, sender, self.round, self._n)
        entries = self._lacked_entries(state, sender, helps)
        if entries or has_ours:  # if not, this robot will close its round and send the entry later
            self._send_round([sender], self.round, entries, received)

    def _fragment(self, fragment: Fragment) -> None:
        """Handle a fragment of an entry."""
        state = self.state
        if state is None or fragment.author >= self._n:
            return
        logs, last = state.logs, self.round + AHEAD
        found = self._assembly.add(fragment, lambda author, round_: logs[author].held < round_ <= last)
        if isinstance(found, str):
            self._reject(found)
        elif found is not None and (refused := state.append(found, self.round)) is not None:
            self._reject(refused)

    def _want(self, sender: int, want: RejoinRequest) -> None:
        """Handle a request to join, or for a snapshot."""
        view, state = self.views.view, self.state
        self._inform(sender, want.view)
        if want.incarnation < 0:
            if want.view >= view.members[sender]:
                self.peers[sender].asked_to_join = self._join_asked = self._tick
        elif state is not None and want.incarnation == view.members[sender] and state.applied >= view.since - 1:
            self._send(self._snapshots.answer(sender, want, state.applied, state.snapshot))

    def _state_fragment(self, fragment: SnapshotFragment) -> None:
        """Handle a fragment of a snapshot."""
        rejoin, view = self.rejoin, self.views.view
        if rejoin is None or rejoin.incarnation(view) < 0 or self.views.is_frozen:
            return  # a frozen robot must not receive a store with more rounds than its promise has reported
        found = rejoin.step(fragment, self._tick)
        if isinstance(found, str):
            self._reject(found)
        elif found is not None:
            self._restore(rejoin, found)

    def _restore(self, rejoin: Rejoin, snapshot: Snapshot) -> None:
        """End the rejoin: continue with the store of a received snapshot."""
        view, state = self.views.view, None
        is_of_view = is_possible(snapshot.view, self._n) and snapshot.view.number == view.number
        if is_of_view and snapshot.applied >= view.since - 1:
            state = StateMachine.from_snapshot(self._layout, self.pid, snapshot)
        if state is None:
            self._reject("store does not fit")
            return
        if rejoin.silent is not None and rejoin.silent.round > state.applied:
            state.close(rejoin.silent.round, {}, stopped=False)
        self._spare = self.rejoin = None
        self._replace(state)
        self._detector.restart_all(self.round)

    def _lose_store(self, since: int) -> None:
        """Discard the store and begin to rejoin. Only a view later than `since` can admit this robot again."""
        self.rejoin = Rejoin(self.pid, since, arrived=self._tick)
        self._replace(None)

    def _replace(self, state: StateMachine | None) -> None:
        """Replace the store. None: this robot has no store from now on."""
        self.state = state
        self._has_progress = True
        self.store_changes += 1
        if state is not None:
            self.published = state.logs[self.pid].held

    # Methods for view changes.

    def _ballot(self, sender: int, message: Ballots) -> None:
        value = getattr(message, "value", None) or getattr(message, "accepted", None)
        if value is not None and not is_possible(value, self._n):
            self._reject("view does not fit")
            return
        self._send(self.views.step(sender, message))
        self._freeze()

    def _inform(self, sender: int, view: int) -> None:
        """Send the present view to robot `sender` if its view is earlier; at most once a tick."""
        peer = self.peers[sender]
        if view < self.views.view.number and peer.informed != self._tick:
            peer.informed = self._tick
            self._send([Send((sender,), Decided, (self.views.view,))])

    def _freeze(self) -> None:
        if self.state is not None:
            self.state.is_frozen = self.views.is_frozen

    def promise_report(self) -> Report:
        """Return this robot's report for a promise. Its last applied round counts as reported from now on."""
        if self.state is not None:
            self.acknowledged = self.state.applied
        return Report(self.views.view.number, self.acknowledged, self.state is not None or self._spare is not None)

    def _holds_all(self, value: View) -> bool:
        """Return whether this robot may vote for a view.

        A robot must not vote in three cases: the view would make the robot lose its store, the robot lacks entries of
        rounds before the view, or it has no store and is no member of the view. The voters are a majority, so several
        robots hold the entries before the view."""
        state, last = self.state, value.since - 1
        if state is None:
            return value.members[self.pid] >= 0
        stays = value.number == state.view.number + 1 and value.members[self.pid] >= 0
        return stays and (state.applied >= last or not state.missing(last))

    def _adopted(self, before: View) -> None:
        """Continue in the view that was just decided. `before` is the previous view."""
        view, state, own = self.views.view, self.state, self.views.view.members[self.pid]
        self._has_progress = True
        is_next = view.number == before.number + 1
        if state is not None and is_next and own == before.members[self.pid]:
            state.adopt(view)
        else:
            self._leave(before, is_next)
        self._assembly.clear()
        for pid, peer in self.peers.items():
            peer.asked_to_join = -JOIN_TICKS
            if view.members[pid] != before.members[pid]:
                peer.reset()
                self._detector.restart(pid, self.round)
        if self.state is None:
            self.acknowledged = min(self.acknowledged, view.since - 1)
            if self.rejoin is not None:
                self.rejoin.silent = None

    def _leave(self, before: View, is_next: bool) -> None:
        """Handle a view that removed this robot, gave it a new incarnation, or is not the next one.

        If possible, the store is rewound to the beginning of the view. If the view admits this robot again, the robot
        continues with the rewound store. Otherwise the robot rejoins, and the rewound store is kept as a spare. A store
        that cannot be rewound is discarded.
        """
        view, last = self.views.view, self.state or self._spare
        kept = last if last is not None and is_next and last.rewind(view) else None
        if self.state is not None:
            self.rejoin = Rejoin(self.pid, before.number, arrived=self._tick)
        if kept is not None:
            self.acknowledged = kept.applied
        if kept is not None and view.members[self.pid] == view.number:
            self._spare = self.rejoin = None
            self._replace(kept)
            return
        self._spare = kept
        if self.state is not None:
            self._replace(None)
