"""View change: group membership by consensus. A view is the set of member robots from some round on.

Each view is decided by one instance of Paxos (Lamport, "The part-time parliament", 1998). All N robots are acceptors,
also those that are no members at present. The proposer derives the value of view w+1 from the promises that it
received:

- The members are the robots that promised. Robots that still have the store keep their incarnation; the others get a
new one and need a state transfer.
- View w ends with the last round that a majority may have reported as applied. So no committed round is lost.

A robot that has promised applies no further round until the view is decided (it is frozen). A robot votes only if it
holds all entries of the rounds before the new view, so a majority holds the entries that the view begins with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from koordgen.runtime.net.wire import MAX_ROBOTS, Accept, Accepted, Ballots, Decided, Prepare, Promise, View
from koordgen.runtime.replication.messages import Send, Vote
from koordgen.runtime.replication.progress import majority

STAGGER = 10  # ticks by which each further robot delays its proposal, so that proposers do not outbid one another
GRACE = 5  # ticks that a proposer with promises of a majority waits for promises of further expected robots


class Report(NamedTuple):
    """Report that a robot sends with its promise.

    view: number of the robot's latest view.
    applied: last round that the robot has reported as applied in that view.
    has_store: the robot still has the store after that round.
    voted: ballot in which the robot has voted.
    accepted: view that the robot has voted for; None without a vote.
    """

    view: int
    applied: int
    has_store: bool
    voted: int = 0
    accepted: View | None = None


def promise(vote: Vote, number: int, ballot: int) -> Vote | None:
    """Return the Vote of a robot after a promise for view `number` in ballot `ballot`.

    Return None if an earlier promise, for a later view or a higher ballot, forbids the new promise.
    """
    if number > vote.number:
        return Vote(number, ballot)
    if number < vote.number or ballot < vote.promised:
        return None
    return replace(vote, promised=ballot)


def accept(vote: Vote, ballot: int, value: View) -> Vote | None:
    """Return the Vote of a robot after it votes for `value`; None if an earlier promise forbids that."""
    if value.number < vote.number or (value.number == vote.number and ballot < vote.promised):
        return None
    return Vote(value.number, ballot, ballot, value)


def bound_value(reports: Mapping[int, Report], absent: int, n_sys: int) -> View | None:
    """Return the view that may already be decided, or None.

    Of several views, the one with the highest ballot is returned. A view is ignored if no majority can have voted for
    it, even if all `absent` robots have."""
    votes = Counter(r.accepted for r in reports.values() if r.accepted is not None)
    possible = [r for r in reports.values() if r.accepted is not None and votes[r.accepted] + absent >= majority(n_sys)]
    return max(possible, key=lambda r: r.voted).accepted if possible else None


def choose(view: View, reports: Mapping[int, Report]) -> View | None:
    """Return the successor of `view` that its proposer may put to the vote.

    Return None without promises of a majority, or if no robot that promised has the store of the last round.

    `view` ends with the last round that a majority may have reported as applied. Absent robots are counted as if they
    had reported that round. Robots that lost their store are counted by their last reports. A robot that has applied
    more rounds gets a new incarnation and returns to the store of the last round; its later events do not count."""
    n_sys = len(view.members)
    absent = n_sys - len(reports)
    if len(reports) < majority(n_sys):
        return None
    bound = bound_value(reports, absent, n_sys)
    if bound is not None:
        return bound
    present = [r for r in reports.values() if r.view == view.number]
    applied = sorted((r.applied for r in present), reverse=True)
    needed = majority(n_sys) - absent  # number of reports that form a majority together with all absent robots
    last = max(view.since - 1, applied[needed - 1] if needed <= len(applied) else 0)
    if not any(r.has_store and r.applied >= last for r in present):
        return None
    number = view.number + 1

    def incarnation(old: int, report: Report | None) -> int:
        if report is None:
            return -1
        stays = old >= 0 and report.has_store and report.view == view.number and report.applied <= last
        return old if stays else number

    return View(number, last + 1, tuple([incarnation(old, reports.get(p)) for p, old in enumerate(view.members)]))


def is_possible(view: View, n_sys: int) -> bool:
    """Return whether `view` is a valid view for a fleet of `n_sys` robots."""
    members = [m for m in view.members if m >= 0]
    return (
        len(view.members) == n_sys
        and len(members) >= majority(n_sys)
        and max(members) <= view.number
        and view.since >= 1
    )


def describe(view: View, names: Sequence[str]) -> str:
    """Return a text for users: which robots count in a view, and which are back."""
    out = [name for name, m in zip(names, view.members, strict=True) if m < 0]
    back = [name for name, m in zip(names, view.members, strict=True) if m == view.number]
    parts = [f"{', '.join(out)} {'does' if len(out) == 1 else 'do'} not count" if out else "all robots count"]
    if back:
        parts.append(f"{', '.join(back)} {'is' if len(back) == 1 else 'are'} back")
    return f"from round {view.since} on {'; '.join(parts)} (view {view.number})"


@dataclass(slots=True)
class _Proposal:
    """Proposal of this robot for the next view.

    ballot: ballot of the proposal.
    begun: tick at which the proposal began.
    reports: pid -> report of a robot that has promised.
    expected: robots whose promises are expected.
    promised_at: tick at which a majority had promised; None before that.
    value: view that was put to the vote; None before that.
    votes: robots that have voted for `value`.
    """

    ballot: int
    begun: int
    reports: dict[int, Report]
    expected: Collection[int]
    promised_at: int | None = None
    value: View | None = None
    votes: set[int] = field(default_factory=set)


class Views:
    """View changes on one robot: acceptor and, if needed, proposer. Methods return messages to send.

    view: latest view that the robot knows to be decided.
    vote: the robot's promise and vote. The caller persists `view` and `vote` before it sends the messages.
    report: function that returns the robot's present report.
    holds_all: function that returns whether the robot may vote for a view (see Replica._holds_all).
    adopted: function that is called with the previous view after a new view was adopted.
    """

    def __init__(
        self, pid: int, view: View, vote: Vote, report: Callable[[], Report], holds_all: Callable[[View], bool],
        adopted: Callable[[View], None],
    ) -> None:  # fmt: skip
        self._pid = pid
        self._n = len(view.members)
        self._report = report
        self._holds_all = holds_all
        self._adopted = adopted
        self._proposal: _Proposal | None = None
        self._reason: int | None = None  # first tick at which a view change was needed; None: no need
        self._no_joins_before = 0  # tick until which robots that join wait after a view change
        self.tick = 0
        self.view = view
        self.vote = vote

    @property
    def is_frozen(self) -> bool:
        """True if the robot has promised for a view that is not decided yet; it then applies no rounds."""
        return self.vote.number > self.view.number

    @property
    def is_busy(self) -> bool:
        """True if a view change is in progress."""
        return self._reason is not None or self.is_frozen

    def poll(self, tick: int, suspected: Collection[int], joining: Collection[int]) -> list[Send]:
        """Begin or continue a proposal if members are suspected, robots want to join, or this robot is frozen."""
        self.tick = tick
        report = self._report() if suspected or joining or self.is_frozen else None
        if report is None or not report.has_store:
            self._reason = self._proposal = None
            return []
        if self.vote.number > self.view.number + 1:  # other robots know a later view and will send it
            return []
        if self._reason is None:
            self._reason = tick
        if not suspected and not self.is_frozen and tick < self._no_joins_before:
            return []
        trusted = [p for p, m in enumerate(self.view.members) if m >= 0 and p not in suspected]
        wait = STAGGER * trusted.index(self._pid) if self._pid in trusted else STAGGER * self._n
        proposal = self._proposal
        if proposal is None:
            if tick - self._reason < wait:
                return []
            proposal = self._begin(report, {*trusted, *joining})
        elif tick - proposal.begun > 2 * STAGGER + wait:
            proposal = self._begin(report, {*trusted, *joining})
        proposal.reports[self._pid] = self._with_vote(report)
        return [*self._put(proposal), *self._vote_for(proposal), *self._ask(proposal)]

    def step(self, sender: int, message: Ballots) -> list[Send]:
        """Handle a Paxos message of robot `sender`. Return the messages to send."""
        match message:
            case Prepare():
                return self._prepare(sender, message)
            case Promise():
                return self._promise(sender, message)
            case Accept():
                return self._accept(sender, message)
            case Accepted():
                return self._accepted(sender, message)
            case Decided(value=value):
                self.adopt(value)
                return []

    def adopt(self, value: View) -> bool:
        """Switch to a decided view. Return False if the view is not later than the present one."""
        if value.number <= self.view.number:
            return False
        before, self.view = self.view, value
        self._proposal = self._reason = None
        self._no_joins_before = self.tick + STAGGER
        self._adopted(before)
        return True

    # Methods that handle messages to this robot as an acceptor.

    def _prepare(self, sender: int, message: Prepare) -> list[Send]:
        if message.view.number < self.view.number:
            return [Send((sender,), Decided, (self.view,))]
        self.adopt(message.view)
        number = message.view.number + 1
        vote = promise(self.vote, number, message.ballot)
        if vote is None:
            return []
        self.vote = vote
        own = self._with_vote(self._report())
        return [Send((sender,), Promise, (number, message.ballot, *own))]

    def _accept(self, sender: int, message: Accept) -> list[Send]:
        value = message.value
        if value.number <= self.view.number:
            return [Send((sender,), Decided, (self.view,))]
        vote = accept(self.vote, message.ballot, value)
        if vote is None or not self._holds_all(value):  # the proposer will repeat its request
            return []
        self.vote = vote
        return [Send((sender,), Accepted, (value.number, message.ballot))]

    def _with_vote(self, report: Report) -> Report:
        """Return the report with this robot's vote added. The robot has already promised for the next view."""
        return report._replace(voted=self.vote.voted, accepted=self.vote.value)

    # Methods for the proposals of this robot.

    def _begin(self, report: Report, expected: Collection[int]) -> _Proposal:
        number = self.view.number + 1
        bound = self.vote.promised if self.vote.number == number else 0
        # No other robot uses this ballot, and it is higher than the ballot that this robot has promised.
        ballot = (bound // MAX_ROBOTS + 1) * MAX_ROBOTS + self._pid
        vote = promise(self.vote, number, ballot)
        assert vote is not None
        self.vote = vote
        self._proposal = _Proposal(ballot, self.tick, {self._pid: self._with_vote(report)}, expected)
        return self._proposal

    def _ask(self, proposal: _Proposal) -> list[Send]:
        """Return requests to the robots that have not answered the proposal yet."""
        others = [p for p in range(self._n) if p != self._pid]
        if proposal.value is not None:
            silent = [p for p in others if p not in proposal.votes]
            return [Send(silent, Accept, (proposal.ballot, proposal.value))]
        return [Send([p for p in others if p not in proposal.reports], Prepare, (proposal.ballot, self.view))]

    def _put(self, proposal: _Proposal) -> list[Send]:
        """Put a view to the vote once a majority and all expected robots have promised.

        After GRACE ticks, the promises of a majority suffice.
        """
        if proposal.value is not None or len(proposal.reports) < majority(self._n):
            return []
        if proposal.promised_at is None:
            proposal.promised_at = self.tick
        if any(p not in proposal.reports for p in proposal.expected) and self.tick - proposal.promised_at < GRACE:
            return []
        proposal.value = choose(self.view, proposal.reports)
        return self._vote_for(proposal)

    def _vote_for(self, proposal: _Proposal) -> list[Send]:
        """Vote for this robot's own proposal, once it was put to the vote and this robot may vote for it."""
        if proposal.value is None or self._pid in proposal.votes or not self._holds_all(proposal.value):
            return []
        vote = accept(self.vote, proposal.ballot, proposal.value)
        if vote is None:
            return []
        self.vote = vote
        proposal.votes.add(self._pid)
        return self._decide(proposal)

    def _promise(self, sender: int, message: Promise) -> list[Send]:
        proposal = self._proposal
        if proposal is None or message.number != self.view.number + 1 or message.ballot != proposal.ballot:
            return []
        if message.view > self.view.number:  # the sender knows a later view than this robot
            self._proposal = None
            return []
        proposal.reports[sender] = Report(
            message.view, message.applied, message.has_store, message.voted, message.accepted
        )  # fmt: skip
        sends = self._put(proposal)
        return [*sends, *self._ask(proposal)] if sends or proposal.value is not None else []

    def _accepted(self, sender: int, message: Accepted) -> list[Send]:
        proposal = self._proposal
        if proposal is None or proposal.value is None or message.number != proposal.value.number:
            return []
        if message.ballot == proposal.ballot:
            proposal.votes.add(sender)
        return self._decide(proposal)

    def _decide(self, proposal: _Proposal) -> list[Send]:
        """Announce the proposed view once a majority has voted for it."""
        if proposal.value is None or len(proposal.votes) < majority(self._n):
            return []
        value = proposal.value
        self.adopt(value)
        return [Send([p for p in range(self._n) if p != self._pid], Decided, (value,))]
