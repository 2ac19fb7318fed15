"""View changes alone. Whatever messages are lost, repeated or late, and whichever process dies: one view is decided for
each number, and it leaves out no round that was committed before it."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import Any

import pytest

from koordgen.runtime.net.wire import Accepted, Ballots, Prepare, Promise, View
from koordgen.runtime.replication.messages import Send, Vote
from koordgen.runtime.replication.progress import majority
from koordgen.runtime.replication.views import Report, Views, accept, is_possible, promise
from tests.runtime.replication.states import head

FIRST = View(0, 1, (0, 0, 0))
NEXT = View(1, 11, (0, 0, -1))


def test_a_promise_binds_to_no_lower_ballot_and_keeps_the_vote() -> None:
    vote = Vote(1, 5, 5, NEXT)
    assert promise(vote, 1, 4) is None
    assert promise(vote, 1, 5) == vote, "a request that is repeated is answered again"
    assert promise(vote, 1, 7) == Vote(1, 7, 5, NEXT)
    assert promise(vote, 2, 1) == Vote(2, 1), "the value that it has voted for is decided"
    assert promise(vote, 0, 9) is None


def test_a_vote_needs_no_promise_but_breaks_none() -> None:
    assert accept(Vote(), 5, NEXT) == Vote(1, 5, 5, NEXT)
    assert accept(Vote(1, 5), 5, NEXT) == Vote(1, 5, 5, NEXT)
    assert accept(Vote(1, 6), 5, NEXT) is None
    assert accept(Vote(2, 0), 5, NEXT) is None


@pytest.mark.parametrize(
    ("view", "good"),
    [
        (View(3, 9, (0, 3, -1)), True),
        (View(3, 9, (0, -1, -1)), False),
        (View(3, 9, (0, 4, 0)), False),
        (View(3, 9, (0, 0)), False),
        (View(3, 9, (0, 0, 0, 0)), False),
        (View(3, 0, (0, 0, 0)), False),
    ],
)
def test_which_views_are_possible(view: View, good: bool) -> None:
    assert is_possible(view, 3) == good


@dataclass
class Node:
    """One robot with a stand-in for its store: the last round applied, and what was persisted."""

    pid: int
    fleet: Chaos
    kept: tuple[View, Vote, int]
    applied: int = 0
    state: bool = True
    views: Views = field(init=False)

    def __post_init__(self) -> None:
        self.boot()

    def boot(self) -> None:
        view, vote, self.applied = self.kept
        self.views = Views(self.pid, view, vote, self.report, lambda value: True, self.follow)

    def die(self) -> None:
        """The process dies and comes back, without a store."""
        self.state = False
        self.boot()

    def report(self) -> Report:
        return Report(self.views.view.number, self.applied, self.state)

    def save(self) -> None:
        self.kept = self.views.view, self.views.vote, self.applied

    def follow(self, before: View) -> None:
        view = self.views.view
        self.fleet.decided(view)
        goes_on = view.number == before.number + 1 and view.members[self.pid] == before.members[self.pid]
        if self.state and goes_on:
            assert self.applied < view.since, "applied rounds after the end of the view before"
        elif self.state and view.number == before.number + 1 and view.members[self.pid] == view.number:
            self.state = self.applied >= view.since - 1  # it goes back to its own store of that round
            self.applied = min(self.applied, view.since - 1)
        else:
            self.state, self.applied = False, min(self.applied, view.since - 1)

    def counts(self) -> bool:
        return self.views.view.members[self.pid] >= 0


class Chaos:
    """Robots that send each other ballots over a network that may do anything. A robot persists before it sends."""

    def __init__(self, n: int, seed: int, loss: float, node: type[Node] = Node) -> None:
        self.n, self.rng, self.loss = n, Random(seed), loss
        self.by_number: dict[int, View] = {}
        self.committed: dict[int, int] = {}  # by view: the last round that was committed in it
        self.reported: dict[tuple[int, int], int] = {}  # by view and robot: the last round reported as applied
        self.flying: list[tuple[int, Ballots]] = []
        self.tick = 0
        first = View(0, 1, (0,) * n)
        self.nodes = [node(pid, self, (first, Vote(), 0)) for pid in range(n)]

    def decided(self, view: View) -> None:
        known = self.by_number.setdefault(view.number, view)
        assert known == view, f"two views for number {view.number}: {known} and {view}"
        assert is_possible(view, self.n)
        assert view.since > self.committed.get(view.number - 1, 0), "a committed round is left out"

    def send(self, sender: int, sends: list[Send]) -> None:
        self.nodes[sender].save()
        for send in sends:
            for pid in send.to:
                copies = 0 if self.rng.random() < self.loss else 2 if self.rng.random() < self.loss / 2 else 1
                self.flying += [(pid, send.kind(head(sender), *send.fields))] * copies

    def deliver(self) -> None:
        if self.flying:
            at = self.rng.randrange(len(self.flying)) if self.loss else 0
            pid, message = self.flying.pop(at)
            self.send(pid, self.nodes[pid].views.step(message.head.pid, message))

    def apply(self, node: Node) -> None:
        """Apply a round, and report it."""
        if node.state and node.counts() and not node.views.is_frozen:
            node.applied = max(node.applied, node.views.view.since - 1) + 1
            node.save()
            number = node.views.view.number
            self.reported[number, node.pid] = node.applied
            reported = sorted((r for (w, _), r in self.reported.items() if w == number), reverse=True)
            if len(reported) >= majority(self.n):
                self.committed[number] = max(self.committed.get(number, 0), reported[majority(self.n) - 1])
            later = self.by_number.get(number + 1)
            assert later is None or self.committed.get(number, 0) < later.since, "committed after it was left out"

    def transfer(self, node: Node) -> None:
        """Transfer the state to a robot that was admitted again."""
        view = node.views.view
        if not node.state and node.counts() and view.members[node.pid] > 0 and not node.views.is_frozen:
            sources = [o for o in self.nodes if o.state and o.views.view == view and o.applied >= view.since - 1]
            if sources:
                node.applied, node.state = self.rng.choice(sources).applied, True

    def step(self) -> None:
        node = self.rng.choice(self.nodes)
        match self.rng.randrange(12):
            case 0 | 1 | 2:
                self.tick += 1
                others = [p for p, m in enumerate(node.views.view.members) if m >= 0 and p != node.pid]
                suspected = [p for p in others if self.rng.random() < 0.3]
                asking = [p for p, m in enumerate(node.views.view.members) if m < 0 and self.rng.random() < 0.5]
                self.send(node.pid, node.views.poll(self.tick, suspected, asking))
            case 3:
                self.apply(node)
            case 4:
                self.transfer(node)
            case 5 if self.rng.random() < 0.1 and sum(n.state for n in self.nodes) > majority(self.n):
                node.die()
            case _:
                self.deliver()
        if len(self.flying) > 200:
            del self.flying[: self.rng.randrange(200)]

    def heal(self) -> bool:
        """Without loss, all robots are admitted and go by one view. Return False if no store is left with all committed
        rounds: too many robots lost theirs at once."""
        self.loss = 0.0
        self.flying.clear()
        for _ in range(400):
            self.tick += 1
            newest = max((n.views.view for n in self.nodes), key=lambda v: v.number)
            for node in self.nodes:
                self.transfer(node)
                if node.views.view.number < newest.number:
                    node.views.adopt(newest)
                others = [o for o in self.nodes if o is not node]
                asking = [o.pid for o in others if not o.state and not o.counts()]
                suspected = [o.pid for o in others if not o.state and o.counts() and newest.members[o.pid] == 0]
                self.send(node.pid, node.views.poll(self.tick, suspected, asking))
            while self.flying:
                self.deliver()
            if all(n.state and n.counts() and n.views.view == newest and not n.views.is_frozen for n in self.nodes):
                return True
        left = [(n.views.view, n.applied, n.views.vote) for n in self.nodes if n.state]
        assert not any(applied >= view.since - 1 for view, applied, _ in left), f"no common view: {left}"
        return False


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_one_view_is_decided_for_each_number_whatever_happens(n: int, loss: float) -> None:
    changes = 0
    for seed in range(12):
        chaos = Chaos(n, seed, loss)
        for _ in range(1500):
            chaos.step()
        changes += len(chaos.by_number)
    assert changes >= (10 if n > 1 else 0), "too quiet to show anything"


@pytest.mark.parametrize("n", [3, 5])
def test_after_the_chaos_all_robots_come_together(n: int) -> None:
    healed = 0
    for seed in range(20):
        chaos = Chaos(n, seed, 0.3)
        for _ in range(600):
            chaos.step()
        healed += chaos.heal()
    assert healed >= 8


class Forgetful(Node):
    """A robot that forgets its votes when it dies."""

    def save(self) -> None:
        self.kept = self.views.view, Vote(), self.applied


def test_a_vote_that_is_not_persisted_is_noticed() -> None:
    """Show that the tests above see such a fault."""
    with pytest.raises(AssertionError):
        for seed in range(300):
            chaos = Chaos(3, seed, 0.3, Forgetful)
            for _ in range(1500):
                if chaos.rng.random() < 0.05:
                    node = chaos.rng.choice(chaos.nodes)
                    node.boot()
                chaos.step()


def step(views: Views, sender: int, message: type[Any], *fields: Any) -> list[Send]:
    return views.step(sender, message(head(sender), *fields))


def alone(view: View = FIRST) -> Views:
    return Views(0, view, Vote(), lambda: Report(view.number, 9, True), lambda v: True, lambda v: None)


def test_a_late_accepted_of_an_earlier_ballot_does_not_count() -> None:
    views = alone(View(0, 1, (0,) * 5))
    [send] = views.poll(0, [4], [])
    assert send.kind is Prepare
    ballot, _ = send.fields
    for sender in (1, 2):
        step(views, sender, Promise, 1, ballot, 0, 9, True, 0, None)
    views.poll(1, [4], [])
    views.poll(9, [4], [])
    assert step(views, 1, Accepted, 1, ballot - 1) == [] and step(views, 2, Accepted, 2, ballot) == []
    assert views.view.number == 0
    step(views, 1, Accepted, 1, ballot)
    step(views, 1, Accepted, 1, ballot)
    assert views.view.number == 0, "one robot's vote counts once"
    step(views, 2, Accepted, 1, ballot)
    assert views.view == View(1, 10, (0, 0, 0, -1, -1))
