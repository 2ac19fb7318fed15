"""The protocol explored: every state of three robots within bounds keeps what is promised, and each of the rules is
missed when it is broken."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import pytest

from koordgen.runtime.net.wire import View
from koordgen.runtime.replication import progress, views
from koordgen.runtime.replication.messages import Vote
from koordgen.runtime.replication.progress import Progress, majority
from koordgen.runtime.replication.rejoin import Rejoin
from koordgen.runtime.replication.views import Report
from tests.model import protocol, rounds
from tests.model.explore import BEGIN, Found, explore
from tests.model.heal import Healing
from tests.model.protocol import Protocol
from tests.model.state import COMMIT, FIRST, PLAIN, Bounds, Robot, Rules, State

ROUNDS = Bounds(rounds=2, views=0, crashes=1, actors=(0, 1))
CHANGE = Bounds(rounds=2, views=1, crashes=1, proposers=(0,), kinds=(PLAIN,), actors=(1,))

RIVALS = Bounds(rounds=1, views=1, crashes=1, proposers=(0, 1), kinds=(), rivals=True)
SMALL = Bounds(rounds=1, views=1, crashes=1, proposers=(0, 1), kinds=(PLAIN,), actors=(0,))
LATER = replace(SMALL, views=2)
# Robot 2 has died, and view 1 has let it in again; it has no store yet.
LET_IN = State(
    robots=(Robot(view=1), Robot(view=1), Robot(store=False, view=1)),
    words=((-1, 0),) * 3,
    histories=((), ()),
    decided=(FIRST, View(1, 1, (0, 0, 1))),
)
# View 1 goes on without robot 2, which has not heard of it.
LEFT_OUT = LET_IN._replace(
    robots=(Robot(view=1), Robot(view=1), Robot()),
    words=((0, 0), (0, 0), (0,)),
    decided=(FIRST, View(1, 1, (0, 0, -1))),
)


def holds(found: Found) -> None:
    print(found)
    assert not found.violation, str(found)
    assert found.complete


@pytest.mark.parametrize(
    ("bounds", "start"),
    [
        (ROUNDS, BEGIN), pytest.param(RIVALS, BEGIN, marks=pytest.mark.slow), (SMALL, BEGIN), (LATER, LET_IN),
        pytest.param(LATER, LEFT_OUT, marks=pytest.mark.slow),
    ],
    ids=["rounds", "rivals", "small", "let in", "left out"],
)  # fmt: skip
def test_every_state_keeps_what_is_promised(bounds: Bounds, start: State) -> None:
    holds(explore(Protocol(bounds), start=start))


@pytest.mark.slow
@pytest.mark.parametrize(
    "bounds",
    [
        CHANGE,
        Bounds(rounds=2, views=0, crashes=1),
        Bounds(rounds=2, views=1, crashes=1, proposers=(0, 1), kinds=(PLAIN, COMMIT), actors=(0,)),
        Bounds(rounds=2, views=2, crashes=1, proposers=(0,), kinds=(PLAIN,), actors=(1,)),
        Bounds(rounds=1, views=1, ballots=2, crashes=1, proposers=(0, 1), kinds=(), rivals=True),
        Bounds(rounds=1, views=1, crashes=2, proposers=(0, 1), kinds=(PLAIN,), actors=(0, 1)),
    ],
    ids=["change", "rounds", "commits", "two changes", "ballots", "two crashes"],
)
def test_more_states_keep_what_is_promised(bounds: Bounds) -> None:
    found = explore(Protocol(bounds), most=1_000_000)
    print(found)
    assert not found.violation, str(found)


def one(n_sys: int) -> int:
    return 1


def least(view: View, words: Mapping[int, Report]) -> View | None:
    """`choose`, but the view ends with the least round that one of them has applied."""
    value = CHOOSE(view, words)
    if value is None or any(w.accepted for w in words.values()):
        return value
    return replace_since(value, min(w.applied for w in words.values()) + 1)


def replace_since(value: View, since: int) -> View:
    return View(value.number, since, value.members)


def whoever(view: View, words: Mapping[int, Report]) -> View | None:
    """`choose`, but who lost its store goes on as if it had not."""
    value = CHOOSE(view, words)
    if value is None or any(w.accepted for w in words.values()):
        return value
    members = tuple(old if pid in words else -1 for pid, old in enumerate(view.members))
    return View(value.number, value.since, members)


def deaf(view: View, words: Mapping[int, Report]) -> View | None:
    """`choose`, but without heed to what was voted for."""
    return CHOOSE(view, {p: Report(w.view, w.applied, w.has_store) for p, w in words.items()})


def everywhere(peers: Collection[Progress], view: View, applied: int) -> int:
    """`commit_index`, but whatever view was meant."""
    reported = sorted(peer.applied for peer in peers)
    return min(applied, reported[1 - majority(len(reported) + 1)])


def alone(peers: Collection[Progress], view: View, applied: int) -> int:
    return applied


def unbound(vote: Vote, number: int, ballot: int) -> Vote:
    return Vote(number, ballot)


CHOOSE = views.choose


SHARED: list[tuple[str, object, str, object, Bounds, State]] = [
    ("one vote decides", protocol, "majority", one, RIVALS, BEGIN),
    ("one report commits", progress, "majority", one, SMALL, BEGIN),
    ("a view ends with the least applied round", views, "choose", least, SMALL, BEGIN),
    ("votes are not heeded", views, "choose", deaf, RIVALS, BEGIN),
    ("a promise binds to nothing", views, "promise", unbound, RIVALS, BEGIN),
    ("committed without others", progress, "commit_index", alone, SMALL, BEGIN),
    ("committed by reports of another view", progress, "commit_index", everywhere, LATER, LEFT_OUT),
]
OWN: list[tuple[str, Rules, Bounds, State]] = [
    ("who has promised goes on", Rules(freezes=False), SMALL, BEGIN),
    ("outputs do not wait", Rules(waits=False), SMALL, BEGIN),
    ("a restart forgets the vote", Rules(forgets_vote=True), RIVALS, BEGIN),
    ("a restart forgets what was announced", Rules(forgets_said=True), SMALL, BEGIN),
    ("a store is taken in spite of a promise", Rules(refuses=False), LATER, LET_IN),
    ("an event in a round that is applied", Rules(again=True), replace(LATER, actors=(2,)), LET_IN),
]


@pytest.mark.parametrize(
    ("where", "name", "broken", "bounds", "start"), [row[1:] for row in SHARED], ids=[row[0] for row in SHARED]
)
def test_a_rule_of_the_runtime_that_is_broken_is_missed(
    monkeypatch: pytest.MonkeyPatch, where: object, name: str, broken: object, bounds: Bounds, start: State
) -> None:
    monkeypatch.setattr(where, name, broken)
    found = explore(Protocol(bounds), most=300_000, start=start)
    print(found)
    assert found.violation and found.course


@pytest.mark.parametrize(("rules", "bounds", "start"), [row[1:] for row in OWN], ids=[row[0] for row in OWN])
def test_a_rule_of_the_model_that_is_broken_is_missed(rules: Rules, bounds: Bounds, start: State) -> None:
    found = explore(Protocol(bounds, rules), most=300_000, start=start)
    print(found)
    assert found.violation and found.course


def test_who_keeps_its_incarnation_without_its_store_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views, "choose", whoever)
    monkeypatch.setattr(Rejoin, "incarnation", lambda self, view: view.members[self.pid])
    found = explore(Protocol(CHANGE), most=300_000)
    print(found)
    assert found.violation


def test_two_commits_that_count_are_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rounds, "arbitrate", lambda entries, round_, n_sys: (list(entries), []))
    found = explore(Protocol(ROUNDS))
    assert found.violation.startswith("P1")


@pytest.mark.parametrize(
    ("bounds", "rules", "stores"),
    [(SMALL, Rules(), 1), (replace(CHANGE, rounds=1), Rules(), 2)],
    ids=["small", "change"],
)
def test_from_every_state_they_come_together_and_go_on(bounds: Bounds, rules: Rules, stores: int) -> None:
    healing = Healing(rules, stride=6, stores=stores)
    holds(explore(Protocol(bounds, rules), judge=healing.judge))
    print(f"{healing.healed} healed, {healing.poor} too poor, at most {healing.changes} view changes")
    assert healing.healed > 500


@pytest.mark.parametrize(
    ("rules", "stores"),
    [
        (Rules(holders=False), 2), pytest.param(Rules(freezes=False), 2, marks=pytest.mark.slow),
        pytest.param(Rules(stays=False), 1, marks=pytest.mark.slow),
    ],
    ids=["holders", "freezes", "stays"],
)  # fmt: skip
def test_who_does_not_come_together_is_missed(rules: Rules, stores: int) -> None:
    healing = Healing(rules, stores=stores)
    assert explore(Protocol(SMALL, rules), judge=healing.judge).violation
