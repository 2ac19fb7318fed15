"""Views alone: whatever is lost, doubled, late or forgotten by a process that dies, one view is decided for a number,
and it leaves out nothing that was stable before it."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import Any

import pytest

from koordgen.runtime.net.wire import Accepted, Head, Prepare, Promise, View
from koordgen.runtime.replication.views import Ballots, Out, Views, Vote, Word, fits, majority, promised, voted

FIRST = View(0, 1, (0, 0, 0))
NEXT = View(1, 11, (0, 0, -1))


def head(pid: int) -> Head:
    return Head(0, bytes(8), bytes(8), pid, bytes(8), bytes(8), 0, 0, None, ())


def test_a_promise_binds_to_no_lower_ballot_and_keeps_the_vote() -> None:
    vote = Vote(1, 5, 5, NEXT)
    assert promised(vote, 1, 4) is None
    assert promised(vote, 1, 5) == vote, "asked again, it is answered again"
    assert promised(vote, 1, 7) == Vote(1, 7, 5, NEXT)
    assert promised(vote, 2, 1) == Vote(2, 1), "another number: what it has voted for is decided"
    assert promised(vote, 0, 9) is None


def test_a_vote_needs_no_promise_but_goes_against_none() -> None:
    assert voted(Vote(), 5, NEXT) == Vote(1, 5, 5, NEXT)
    assert voted(Vote(1, 5), 5, NEXT) == Vote(1, 5, 5, NEXT)
    assert voted(Vote(1, 6), 5, NEXT) is None
    assert voted(Vote(2, 0), 5, NEXT) is None


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
def test_what_can_be_a_view(view: View, good: bool) -> None:
    assert fits(view, 3) == good


@dataclass
class Node:
    """One robot with a stand-in for its store: how far it is, and what outlives its process."""

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
        self.views = Views(self.pid, view, vote, self.word, lambda value: True, self.follow, self.save)

    def die(self) -> None:
        """The process dies and comes back, without a store."""
        self.state = False
        self.boot()

    def word(self) -> Word:
        self.save()
        return Word(self.views.view.number, self.applied, self.state)

    def save(self) -> None:
        self.kept = self.views.view, self.views.vote, self.applied

    def follow(self, before: View) -> None:
        view = self.views.view
        self.fleet.decided(view)
        goes_on = view.number == before.number + 1 and view.members[self.pid] == before.members[self.pid]
        if self.state and goes_on:
            assert self.applied < view.since, "went beyond the end of a view that it has left"
        elif self.state and view.number == before.number + 1 and view.members[self.pid] == view.number:
            self.state = self.applied >= view.since - 1  # it takes back its own store
            self.applied = min(self.applied, view.since - 1)
        else:
            self.state, self.applied = False, min(self.applied, view.since - 1)

    def counts(self) -> bool:
        return self.views.view.members[self.pid] >= 0


class Chaos:
    """Robots that send each other ballots over a network without any promise."""

    def __init__(self, n: int, seed: int, loss: float, node: type[Node] = Node) -> None:
        self.n, self.rng, self.loss = n, Random(seed), loss
        self.by_number: dict[int, View] = {}
        self.stable: dict[int, int] = {}  # the last round that was stable in a view
        self.said: dict[tuple[int, int], int] = {}  # view and robot -> the last round it said to have applied
        self.flying: list[tuple[int, Ballots]] = []
        self.tick = 0
        first = View(0, 1, (0,) * n)
        self.nodes = [node(pid, self, (first, Vote(), 0)) for pid in range(n)]

    def decided(self, view: View) -> None:
        known = self.by_number.setdefault(view.number, view)
        assert known == view, f"two views for number {view.number}: {known} and {view}"
        assert fits(view, self.n)
        assert view.since > self.stable.get(view.number - 1, 0), "a stable round is left out"

    def send(self, sender: int, outs: list[Out]) -> None:
        for to, kind, fields in outs:
            for pid in to:
                copies = 0 if self.rng.random() < self.loss else 2 if self.rng.random() < self.loss / 2 else 1
                self.flying += [(pid, kind(head(sender), *fields))] * copies

    def deliver(self) -> None:
        if self.flying:
            at = self.rng.randrange(len(self.flying)) if self.loss else 0
            pid, message = self.flying.pop(at)
            self.send(pid, self.nodes[pid].views.take(message.head.pid, message))

    def apply(self, node: Node) -> None:
        """Go on by a round, and say so."""
        if node.state and node.counts() and not node.views.frozen:
            node.applied = max(node.applied, node.views.view.since - 1) + 1
            node.save()
            number = node.views.view.number
            self.said[number, node.pid] = node.applied
            said = sorted((r for (w, _), r in self.said.items() if w == number), reverse=True)
            if len(said) >= majority(self.n):
                self.stable[number] = max(self.stable.get(number, 0), said[majority(self.n) - 1])
            later = self.by_number.get(number + 1)
            assert later is None or self.stable.get(number, 0) < later.since, "stable after it was left out"

    def gather(self, node: Node) -> None:
        """One that is in again gets the store of one that has it."""
        view = node.views.view
        if not node.state and node.counts() and view.members[node.pid] > 0 and not node.views.frozen:
            sources = [o for o in self.nodes if o.state and o.views.view == view and o.applied >= view.since - 1]
            if sources:
                node.applied, node.state = self.rng.choice(sources).applied, True

    def step(self) -> None:
        node = self.rng.choice(self.nodes)
        match self.rng.randrange(12):
            case 0 | 1 | 2:
                self.tick += 1
                others = [p for p, m in enumerate(node.views.view.members) if m >= 0 and p != node.pid]
                doubted = [p for p in others if self.rng.random() < 0.3]
                asking = [p for p, m in enumerate(node.views.view.members) if m < 0 and self.rng.random() < 0.5]
                self.send(node.pid, node.views.poll(self.tick, doubted, asking))
            case 3:
                self.apply(node)
            case 4:
                self.gather(node)
            case 5 if self.rng.random() < 0.1 and sum(n.state for n in self.nodes) > majority(self.n):
                node.die()
            case _:
                self.deliver()
        if len(self.flying) > 200:
            del self.flying[: self.rng.randrange(200)]

    def heal(self) -> bool:
        """Without loss: everyone who is not in is let in, and all go by one view. False when no store is left that has
        all: too many lost theirs at once."""
        self.loss = 0.0
        self.flying.clear()
        for _ in range(400):
            self.tick += 1
            newest = max((n.views.view for n in self.nodes), key=lambda v: v.number)
            for node in self.nodes:
                self.gather(node)
                if node.views.view.number < newest.number:
                    node.views.adopt(newest)
                others = [o for o in self.nodes if o is not node]
                asking = [o.pid for o in others if not o.state and not o.counts()]
                doubted = [o.pid for o in others if not o.state and o.counts() and newest.members[o.pid] == 0]
                self.send(node.pid, node.views.poll(self.tick, doubted, asking))
            while self.flying:
                self.deliver()
            if all(n.state and n.counts() and n.views.view == newest and not n.views.frozen for n in self.nodes):
                return True
        left = [(n.views.view, n.applied, n.views.vote) for n in self.nodes if n.state]
        assert not any(applied >= view.since - 1 for view, applied, _ in left), f"no common view: {left}"
        return False


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_one_view_for_each_number_whatever_happens(n: int, loss: float) -> None:
    changes = 0
    for seed in range(12):
        chaos = Chaos(n, seed, loss)
        for _ in range(1500):
            chaos.step()
        changes += len(chaos.by_number)
    assert changes >= (10 if n > 1 else 0), "too quiet to show anything"


@pytest.mark.parametrize("n", [3, 5])
def test_after_the_chaos_all_come_together(n: int) -> None:
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


def test_a_vote_that_is_not_kept_is_noticed() -> None:
    """What the test above would see."""
    with pytest.raises(AssertionError):
        for seed in range(300):
            chaos = Chaos(3, seed, 0.3, Forgetful)
            for _ in range(1500):
                if chaos.rng.random() < 0.05:
                    node = chaos.rng.choice(chaos.nodes)
                    node.boot()
                chaos.step()


def take(views: Views, sender: int, message: type[Any], *fields: Any) -> list[Out]:
    return views.take(sender, message(head(sender), *fields))


def alone(view: View = FIRST) -> tuple[Views, list[Vote]]:
    saved: list[Vote] = []
    views = Views(
        0,
        view,
        Vote(),
        lambda: Word(view.number, 9, True),
        lambda v: True,
        lambda v: None,
        lambda: saved.append(views.vote),
    )
    return views, saved


def test_a_late_accepted_of_an_earlier_ballot_counts_for_nothing() -> None:
    views, _ = alone(View(0, 1, (0,) * 5))
    [(_, kind, (ballot, _))] = views.poll(0, [4], [])
    assert kind is Prepare
    for sender in (1, 2):
        take(views, sender, Promise, 1, ballot, 0, 9, True, 0, None)
    views.poll(1, [4], [])
    views.poll(9, [4], [])
    assert take(views, 1, Accepted, 1, ballot - 1) == [] and take(views, 2, Accepted, 2, ballot) == []
    assert views.view.number == 0
    take(views, 1, Accepted, 1, ballot)
    take(views, 1, Accepted, 1, ballot)
    assert views.view.number == 0, "one robot's vote counts once"
    take(views, 2, Accepted, 1, ballot)
    assert views.view == View(1, 10, (0, 0, 0, -1, -1))
