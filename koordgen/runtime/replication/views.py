"""Who counts: how a majority agrees on the next view, by one ballot after another until one is decided.

View change: group membership by consensus. A view is the set of robots that count.

That is Paxos (Lamport 1998). The value of view w+1 is made of what its proposer was promised: everyone who promised is
in it, and the rounds of view w end with the greatest that one of them had applied. Who has promised applies no further
round, so nobody who stays goes beyond that end. All N robots vote, also those that do not count now. Everything here is
without clock, network and disk; `save` is called before any word leaves that must be true after a restart too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from koordgen.runtime.net.wire import MAX_ROBOTS, Accept, Accepted, Closing, Decided, Prepare, Promise, View
from koordgen.runtime.replication.log import Log, shortened

PATIENCE = 10  # ticks that each robot waits longer than the one before it, so that they do not outbid one another
GRACE = 5  # ticks that a proposer with a majority waits for the others it expects

Out = tuple[Collection[int], type[Any], tuple[Any, ...]]  # to whom, the message, its fields without the head
Ballots = Prepare | Promise | Accept | Accepted | Decided


def majority(n_sys: int) -> int:
    return n_sys // 2 + 1


@dataclass(frozen=True, slots=True)
class Vote:
    """What a robot has bound itself to, on view `number`: no ballot below `promised`; `value` got its vote in ballot
    `voted`. Must outlive its process."""

    number: int = 0
    promised: int = 0
    voted: int = 0
    value: View | None = None


@dataclass(frozen=True, slots=True)
class Word:
    """What a robot says of itself when it promises: by which view it goes, up to which round it said to have applied,
    and whether it still has that store and counts."""

    view: int
    applied: int
    state: bool
    voted: int = 0
    accepted: View | None = None


def promised(vote: Vote, number: int, ballot: int) -> Vote | None:
    """The vote after a promise, or None: it is bound to another ballot."""
    if number > vote.number:
        return Vote(number, ballot)
    if number < vote.number or ballot < vote.promised:
        return None
    return replace(vote, promised=ballot)


def voted(vote: Vote, ballot: int, value: View) -> Vote | None:
    """The vote after one for `value`, or None: it is bound to another ballot."""
    if value.number < vote.number or (value.number == vote.number and ballot < vote.promised):
        return None
    return Vote(value.number, ballot, ballot, value)


def decidable(words: Mapping[int, Word], absent: int, n_sys: int) -> View | None:
    """What may have been decided already, as far as those tell who have promised; of several such, only that of the
    highest ballot can have been. A value that too few can have voted for binds nobody."""
    votes = Counter(w.accepted for w in words.values() if w.accepted is not None)
    possible = [w for w in words.values() if w.accepted is not None and votes[w.accepted] + absent >= majority(n_sys)]
    return max(possible, key=lambda w: w.voted).accepted if possible else None


def choose(view: View, words: Mapping[int, Word]) -> View | None:
    """The successor of `view` that a proposer who goes by it may put to the vote, given the promises; None while they
    do not suffice.

    The rounds of `view` end with the last that may be stable: that a majority may have said to have applied, those who
    lost their store since and those who are silent included. So the others can go on whoever of them dies next. Who has
    applied more than that comes in anew, with the store that it had then: its events since do not count."""
    n_sys = len(view.members)
    absent = n_sys - len(words)
    if len(words) < majority(n_sys):
        return None
    bound = decidable(words, absent, n_sys)
    if bound is not None:
        return bound
    present = [w for w in words.values() if w.view == view.number]
    said = sorted((w.applied for w in present), reverse=True)
    needed = majority(n_sys) - absent  # of those here, for a majority
    last = max(view.since - 1, said[needed - 1] if needed <= len(said) else 0)
    if not any(w.state and w.applied >= last for w in present):
        return None
    number = view.number + 1

    def incarnation(old: int, word: Word | None) -> int:
        if word is None:
            return -1
        stays = old >= 0 and word.state and word.view == view.number and word.applied <= last
        return old if stays else number

    return View(number, last + 1, tuple([incarnation(old, words.get(p)) for p, old in enumerate(view.members)]))


def fits(view: View, n_sys: int) -> bool:
    """Whether this can be a view of such a fleet at all."""
    counted = [m for m in view.members if m >= 0]
    return (
        len(view.members) == n_sys
        and len(counted) >= majority(n_sys)
        and max(counted) <= view.number
        and view.since >= 1
    )


def described(view: View, names: Sequence[str]) -> str:
    """Who counts, in words."""
    out = [name for name, m in zip(names, view.members, strict=True) if m < 0]
    back = [name for name, m in zip(names, view.members, strict=True) if m == view.number]
    parts = [f"{', '.join(out)} {'does' if len(out) == 1 else 'do'} not count" if out else "all robots count"]
    if back:
        parts.append(f"{', '.join(back)} {'is' if len(back) == 1 else 'are'} back")
    return f"from round {view.since} on {'; '.join(parts)} (view {view.number})"


@dataclass(slots=True)
class _Proposal:
    ballot: int
    begun: int
    words: dict[int, Word]
    expected: Collection[int]
    enough: int | None = None  # the tick at which a majority had promised
    value: View | None = None
    votes: set[int] = field(default_factory=set)


class Views:
    """One robot's part in it. `view` is the latest it knows to be decided. `word` is what this robot can say of itself
    now; `holds` tells whether it has all closings of the rounds before a view, as all who vote for it must that have a
    store: so it outlives whoever had them alone; `follow` is told the view before, when there is another."""

    def __init__(
        self, pid: int, view: View, vote: Vote, word: Callable[[], Word], holds: Callable[[View], bool],
        follow: Callable[[View], None], save: Callable[[], None],
    ) -> None:  # fmt: skip
        self._pid = pid
        self._n = len(view.members)
        self._word = word
        self._holds = holds
        self._follow = follow
        self._save = save
        self._proposal: _Proposal | None = None
        self._reason: int | None = None  # the tick since which there is a reason for another view
        self.tick = 0
        self._rest = 0  # the tick until which nobody is let in after the last change
        self.view = view
        self.vote = vote

    @property
    def frozen(self) -> bool:
        """Whether this robot has promised to apply nothing until the next view is decided."""
        return self.vote.number > self.view.number

    def busy(self) -> bool:
        """Whether another view is on its way."""
        return self._reason is not None or self.vote.number > self.view.number

    def poll(self, tick: int, doubted: Collection[int], asking: Collection[int]) -> list[Out]:
        """What is to be sent at this tick, given members that are missed and others that want to be let in."""
        self.tick = tick
        word = self._word() if doubted or asking or self.frozen else None
        if word is None or not word.state:
            self._reason = self._proposal = None
            return []
        if self.vote.number > self.view.number + 1:  # others are further on and will say so
            return []
        if self._reason is None:
            self._reason = tick
        if not doubted and not self.frozen and tick < self._rest:  # who wants to be let in can wait
            return []
        trusted = [p for p, m in enumerate(self.view.members) if m >= 0 and p not in doubted]
        wait = PATIENCE * trusted.index(self._pid) if self._pid in trusted else PATIENCE * self._n
        proposal = self._proposal
        if proposal is None:
            if tick - self._reason < wait:
                return []
            proposal = self._begin(word, {*trusted, *asking})
        elif tick - proposal.begun > 2 * PATIENCE + wait:
            proposal = self._begin(word, {*trusted, *asking})
        proposal.words[self._pid] = self._own(word)
        return [*self._put(proposal), *self._agree(proposal), *self._ask(proposal)]

    def take(self, sender: int, message: Ballots) -> list[Out]:
        """Answer a message of another robot."""
        match message:
            case Prepare(ballot=ballot, view=view):
                if view.number < self.view.number:
                    return [((sender,), Decided, (self.view,))]
                self.adopt(view)
                number = view.number + 1
                vote = promised(self.vote, number, ballot)
                if vote is None:
                    return []
                self._bind(vote)
                own = self._own(self._word())
                fields = (number, ballot, own.view, own.applied, own.state, own.voted, own.accepted)
                return [((sender,), Promise, fields)]
            case Promise():
                return self._promise(sender, message)
            case Accept(ballot=ballot, value=value):
                if value.number <= self.view.number:
                    return [((sender,), Decided, (self.view,))]
                vote = voted(self.vote, ballot, value)
                if vote is None or not self._holds(value):  # it will be asked again
                    return []
                self._bind(vote)
                return [((sender,), Accepted, (value.number, ballot))]
            case Accepted():
                return self._count(sender, message)
            case Decided(value=value):
                self.adopt(value)
                return []

    def adopt(self, value: View) -> bool:
        """Go by a decided view; False when it is no news."""
        if value.number <= self.view.number:
            return False
        before, self.view = self.view, value
        self._proposal = self._reason = None
        self._rest = self.tick + PATIENCE
        self._follow(before)
        self._save()
        return True

    def _begin(self, word: Word, expected: Collection[int]) -> _Proposal:
        number = self.view.number + 1
        bound = self.vote.promised if self.vote.number == number else 0
        ballot = (bound // MAX_ROBOTS + 1) * MAX_ROBOTS + self._pid
        vote = promised(self.vote, number, ballot)
        assert vote is not None  # it is higher than any this robot has seen
        self._bind(vote)
        self._proposal = _Proposal(ballot, self.tick, {self._pid: self._own(word)}, expected)
        return self._proposal

    def _own(self, word: Word) -> Word:
        """The word together with what this robot has voted for, once it is bound to the number in question."""
        return replace(word, voted=self.vote.voted, accepted=self.vote.value)

    def _ask(self, proposal: _Proposal) -> list[Out]:
        others = [p for p in range(self._n) if p != self._pid]
        if proposal.value is not None:
            silent = [p for p in others if p not in proposal.votes]
            return [(silent, Accept, (proposal.ballot, proposal.value))]
        return [([p for p in others if p not in proposal.words], Prepare, (proposal.ballot, self.view))]

    def _put(self, proposal: _Proposal) -> list[Out]:
        """Put a value to the vote, if it is time."""
        if proposal.value is not None or len(proposal.words) < majority(self._n):
            return []
        if proposal.enough is None:
            proposal.enough = self.tick
        if any(p not in proposal.words for p in proposal.expected) and self.tick - proposal.enough < GRACE:
            return []
        proposal.value = choose(self.view, proposal.words)
        return self._agree(proposal)

    def _agree(self, proposal: _Proposal) -> list[Out]:
        """Vote for the own proposal, once that may be."""
        if proposal.value is None or self._pid in proposal.votes or not self._holds(proposal.value):
            return []
        vote = voted(self.vote, proposal.ballot, proposal.value)
        if vote is None:
            return []
        self._bind(vote)
        proposal.votes.add(self._pid)
        return self._decide(proposal)

    def _promise(self, sender: int, message: Promise) -> list[Out]:
        proposal = self._proposal
        if proposal is None or message.number != self.view.number + 1 or message.ballot != proposal.ballot:
            return []
        if message.view > self.view.number:  # a decision that this robot has not heard of
            self._proposal = None
            return []
        proposal.words[sender] = Word(message.view, message.applied, message.state, message.voted, message.accepted)
        out = self._put(proposal)
        return [*out, *self._ask(proposal)] if out or proposal.value is not None else []

    def _count(self, sender: int, message: Accepted) -> list[Out]:
        proposal = self._proposal
        if proposal is None or proposal.value is None or message.number != proposal.value.number:
            return []
        if message.ballot == proposal.ballot:
            proposal.votes.add(sender)
        return self._decide(proposal)

    def _decide(self, proposal: _Proposal) -> list[Out]:
        if proposal.value is None or len(proposal.votes) < majority(self._n):
            return []
        value = proposal.value
        self.adopt(value)
        return [([p for p in range(self._n) if p != self._pid], Decided, (value,))]

    def _bind(self, vote: Vote) -> None:
        self.vote = vote
        self._save()


# Which view counts in which round: the views from the next round to be applied on, nearly always one alone.

FAR = 2**53  # a round that never comes


class Course:
    """`first` is the view of the next round to be applied, `members` who counts in it, `single` whether none comes
    after it."""

    def __init__(self, view: View) -> None:
        self._views = [view]
        self.drop(view.since - 1)

    def append(self, view: View) -> None:
        """The next view."""
        self._views.append(view)
        self.single = False

    def drop(self, applied: int) -> None:
        """All rounds up to this one are applied."""
        while len(self._views) > 1 and self._views[1].since <= applied + 1:
            del self._views[0]
        self.first, self.single = self._views[0], len(self._views) == 1
        self.members = [pid for pid, incarnation in enumerate(self.first.members) if incarnation >= 0]

    def at(self, round_: int) -> View:
        """The view of a round not before the next one to be applied."""
        return next(v for v in reversed(self._views) if v.since <= round_ or v is self.first)

    def end(self, round_: int) -> int:
        """The last round of the view that `round_` is in; one far away for the latest."""
        return min((v.since - 1 for v in self._views if v.since > round_), default=FAR)

    def of_this_life(self, closing: Closing) -> Closing | None:
        """The closing as far as its author counted in that incarnation, or None."""
        if self.at(closing.round).members[closing.author] == closing.incarnation:
            return closing
        for view in self._views:
            if view.since > closing.first and view.members[closing.author] != closing.incarnation:
                single = closing.writes or closing.acted or closing.lock >= 0
                began = self.at(closing.first).members[closing.author] == closing.incarnation
                return shortened(closing, view.since - 1) if began and not single else None
        return None

    def pass_over(self, logs: Sequence[Log]) -> None:
        """Take for held what is not to come: the rounds, before the latest view, in which a robot does not count."""
        for pid, log in enumerate(logs):
            for begins, ends in self._absences(pid):
                if begins <= log.held + 1 <= ends:
                    log.skip(ends)

    def _absences(self, pid: int) -> Iterator[tuple[int, int]]:
        """The rounds, first and last, in which a robot does not count, before the latest view."""
        for i, (view, following) in enumerate(pairwise(self._views)):
            if view.members[pid] < 0:
                yield view.since if i else 0, following.since - 1
