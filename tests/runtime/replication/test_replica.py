"""Replica as a state machine: what one robot sends and votes for in answer to messages, and which it refuses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from koordgen.runtime.net.wire import (
    Accept,
    Accepted,
    Decided,
    Entry,
    Nack,
    Prepare,
    Promise,
    ReplicaMessage,
    RoundMessage,
    View,
)
from koordgen.runtime.replication.messages import Applied, HardState, Ready, Vote
from koordgen.runtime.replication.replica import TICKS, Replica
from koordgen.runtime.replication.state_machine import AHEAD, StateMachine
from tests.runtime.replication.states import acted, head, layout, silent, view, write

N, NOW = 3, 10


def alice(n: int = N, applied: int = NOW - 1) -> Replica:
    """Return robot 0's replica in round NOW, with all rounds before it applied."""
    state = StateMachine(layout(n), 0, view(n), layout(n).initial(), applied)
    replica = Replica(0, layout(n), state, HardState(view(n), applied, Vote()), 2, 1000)
    replica.tick((NOW - 1) * TICKS)
    replica.ready()
    return replica


def report(sender: int, round_: int, applied: int, *entries: Entry, held: Sequence[int] = (), settled: int = 0,
           number: int = 0) -> RoundMessage:  # fmt: skip
    return RoundMessage(head(sender), number, round_, applied, settled, False, tuple(held), entries)


def step(replica: Replica, *messages: ReplicaMessage) -> Ready:
    """Return what the replica wants done after these messages."""
    for message in messages:
        replica.step(message)
    replica.apply_rounds()
    return replica.ready()


def entries(ready: Ready, to: int) -> list[Entry]:
    """Return the entries that are sent to a robot."""
    return [entry for send in ready.send if send.kind is RoundMessage and to in send.to for entry in send.fields[-1]]


def test_a_round_is_applied_once_all_entries_are_here_and_committed_once_a_majority_reports_it() -> None:
    replica = alice()
    replica.propose(NOW, {"x": 5}, stopped=False, acted=True)
    assert entries(step(replica), to=1) == [acted(0, NOW, write(0, 5))]
    ready = step(replica, report(1, NOW, NOW - 1, silent(1, NOW, NOW)))
    assert ready.apply == Applied(NOW - 1, NOW - 1)
    ready = step(replica, report(2, NOW, NOW - 1, acted(2, NOW, write(1, 7))))
    assert ready.apply == Applied(NOW, NOW - 1)
    assert ready.persist is not None and ready.persist.applied == NOW
    ready = step(replica, report(1, NOW, NOW))
    assert ready.apply == Applied(NOW, NOW)
    assert replica.state is not None and replica.state.shared == {"x": (5, 0, 0), "last": 7}


def test_a_report_by_an_earlier_view_commits_nothing_and_its_sender_is_told_of_the_view() -> None:
    replica = alice()
    later = View(1, NOW, (0, 0, 0))
    step(replica, Decided(head(1), later))
    replica.propose(NOW, {}, stopped=False)
    entries_ = [silent(pid, NOW, NOW) for pid in (1, 2)]
    ready = step(replica, report(1, NOW, NOW, *entries_, number=0))
    assert ready.apply == Applied(NOW, NOW - 1)
    assert [(send.kind, send.fields) for send in ready.send if 1 in send.to and send.kind is Decided] == [
        (Decided, (later,))
    ]


def test_missing_entries_are_sent_to_a_robot_that_asks_for_them() -> None:
    """Its own first, then those of others that this robot holds."""
    replica = alice()
    replica.propose(NOW, {"x": 5}, stopped=False, acted=True)
    theirs = acted(2, NOW, write(0, 1))
    step(replica, report(2, NOW, NOW - 1, theirs))
    ready = step(replica, Nack(head(1), 0, NOW, NOW - 1, (NOW - 1,) * N, ()))
    assert entries(ready, to=1) == [acted(0, NOW, write(0, 5)), theirs] and entries(ready, to=2) == []
    again = step(replica, Nack(head(1), 0, NOW, NOW - 1, (NOW - 1,) * N, ()))
    assert entries(again, to=1) == entries(ready, to=1), "the answer may be lost"


def test_an_entry_that_a_robot_holds_is_not_sent_again() -> None:
    replica = alice()
    replica.propose(NOW, {"x": 5}, stopped=False, acted=True)
    theirs = acted(2, NOW, write(0, 1))
    step(replica, report(2, NOW, NOW - 1, theirs))
    ready = step(replica, Nack(head(1), 0, NOW, NOW - 1, (NOW, NOW - 1, NOW - 1), ()))
    assert entries(ready, to=1) == [theirs]


def test_a_robot_that_lacks_entries_gets_them_with_the_next_round() -> None:
    replica = alice()
    replica.propose(NOW, {"x": 5}, stopped=False, acted=True)
    step(replica, report(1, NOW, NOW - 1, silent(1, NOW, NOW)), report(2, NOW, NOW - 1, silent(2, NOW, NOW)))
    replica.tick(NOW * TICKS)
    lagging = (NOW - 1, NOW, NOW - 1)
    step(replica, report(1, NOW + 1, NOW - 1, silent(1, NOW + 1, NOW + 1), held=lagging))
    replica.propose(NOW + 1, {}, stopped=False)
    ready = step(replica)
    assert {(e.author, e.round) for e in entries(ready, to=1)} >= {(0, NOW), (0, NOW + 1), (2, NOW)}
    assert [(e.author, e.round) for e in entries(ready, to=2)] == [(0, NOW + 1)]


def test_a_tick_says_whether_there_is_something_to_send() -> None:
    replica = alice()
    assert not replica.tick((NOW - 1) * TICKS) and not replica.ready().send
    replica.declare_emergency()
    replica.ready()
    assert replica.tick((NOW - 1) * TICKS), "all robots must hear of an emergency in each round"
    assert [(list(send.to), send.kind) for send in replica.ready().send] == [([1, 2], RoundMessage)]


LAST = NOW + AHEAD


@pytest.mark.parametrize(
    ("message", "fits"),
    [
        (lambda: report(1, LAST + 1, LAST), True),
        (lambda: report(1, LAST + 2, 0), False),
        (lambda: report(1, NOW, LAST + 1), False),
        (lambda: report(1, NOW, 0, settled=LAST), True),
        (lambda: report(1, NOW, 0, settled=LAST + 1), False),
        (lambda: report(1, NOW, 0, held=(0, 0)), False),
        (lambda: report(1, NOW, 0, held=(0,) * (N + 1)), False),
        (lambda: report(1, NOW, 0, held=(0, 0, LAST)), True),
        (lambda: report(1, NOW, 0, held=(0, 0, LAST + 1)), False),
        (lambda: Nack(head(1), 0, LAST + 1, 0, (0,) * N, ()), False),
        (lambda: Nack(head(1), 0, 0, LAST + 1, (0,) * N, ()), False),
        (lambda: Nack(head(1), 0, 0, 0, (0,) * (N - 1), ()), False),
    ],
)
def test_impossible_reports_are_refused_and_change_nothing(message: Callable[[], ReplicaMessage], fits: bool) -> None:
    replica = alice()
    before = str(replica.peers[1].wanted), replica.peers[1].applied, replica.state and replica.state.settled
    ready = step(replica, message())
    assert ready.rejected == ([] if fits else ["report does not fit"])
    if not fits:
        after = str(replica.peers[1].wanted), replica.peers[1].applied, replica.state and replica.state.settled
        assert after == before and ready.send == [] and ready.persist is None


def test_refused_entries_are_counted_by_their_reason() -> None:
    ready = step(alice(), report(1, NOW, 0, acted(2, NOW, write(1, "text")), silent(1, 1, LAST + 1)))
    assert ready.rejected == ["entry does not fit", "entry too far ahead"]


def test_an_emergency_reaches_robots_without_a_store_too() -> None:
    replica = Replica(0, layout(N), None, HardState(view(N), 5, Vote()), 2, 1000)
    replica.step(RoundMessage(head(1), 0, NOW, 0, 0, True, (), ()))
    assert replica.emergency


def votes(ready: Ready) -> list[Any]:
    return [send.fields for send in ready.send if send.kind is Accepted]


def test_a_robot_votes_for_a_view_only_when_it_holds_all_entries_before_it() -> None:
    """An entry that was refused is not held."""
    replica = alice()
    replica.propose(NOW, {"x": 5}, stopped=False, acted=True)
    value = View(1, NOW + 1, (0, 0, 0))
    step(replica, report(1, NOW, NOW - 1, silent(1, NOW, NOW)))
    bad, good = acted(2, NOW, write(0, "text")), acted(2, NOW, write(0, 2))
    step(replica, report(2, NOW, NOW - 1, bad))
    assert votes(step(replica, Accept(head(1), 129, value))) == []
    step(replica, report(2, NOW, NOW - 1, good))
    ready = step(replica, Accept(head(1), 129, value))
    assert votes(ready) == [(1, 129)]
    assert ready.persist is not None and ready.persist.vote == Vote(1, 129, 129, value)


def test_a_robot_that_has_promised_applies_no_round_until_the_view_is_decided() -> None:
    replica = alice()
    replica.propose(NOW, {}, stopped=False)
    step(replica)
    vote = Vote(1, 129)
    ready = step(replica, Prepare(head(1), 129, view(N)))
    assert [send.kind for send in ready.send] == [Promise]
    assert ready.persist is not None and ready.persist.vote == vote
    ready = step(replica, report(1, NOW, NOW, silent(1, NOW, NOW), silent(2, NOW, NOW)))
    assert ready.apply is None or ready.apply.applied == NOW - 1
    ready = step(replica, Decided(head(1), View(1, NOW, (0, 0, 0))))
    assert ready.apply is not None and ready.apply.applied == NOW
