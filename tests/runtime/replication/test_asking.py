"""Whom a robot asks for what it lacks, and who answers."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from msgspec.structs import replace

from benchmarks.fixtures.fleet import KEY, Fleet
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.wire import Need, Round, decode
from koordgen.runtime.replication.memory import Memory
from koordgen.runtime.replication.patience import FEW
from koordgen.runtime.replication.replica import Replica

Asked = dict[float, set[int]]  # by time: whom


def listen(fleet: Fleet, pid: int, kind: type[Need] | type[Round]) -> Asked:
    """To whom a robot sends such messages from now on."""
    transport, sent = fleet.robots[pid].agent._transport, Asked()
    send = transport.send

    def sends(to: Sequence[int], datagram: bytes) -> None:
        if isinstance(decode(datagram, KEY), kind):
            sent.setdefault(fleet.time.time, set()).update(to)
        send(to, datagram)

    transport.send = sends  # type: ignore[method-assign]
    return sent


def deaf(n: int, others: int, until: int = 22) -> Asked:
    """Whom robot 0 asks that does not hear so many in the rounds from 21 on, and whom nobody hears."""
    fleet = Fleet(n=n, conditions=Conditions(delay=0.001)).boot_all()
    fleet.run_rounds(20)
    asked = listen(fleet, 0, Need)
    fleet.network.cut = lambda sender, receiver: sender == 0 or (receiver == 0 and sender <= others)
    fleet.run_rounds(until)
    return asked


def test_few_that_lack_are_all_asked() -> None:
    assert set(map(frozenset, deaf(FEW + 1, FEW).values())) == {frozenset(range(1, FEW + 1))}


def test_of_many_that_lack_one_is_asked_another_each_time() -> None:
    asked = deaf(2 * FEW + 3, FEW + 1, until=28)  # it is its turn in round 26
    authors = [to & set(range(FEW + 2)) for to in asked.values()]  # beside each one who may hold it
    assert len(authors) > 2 and {len(to) for to in authors} == {1}
    assert len(set().union(*authors)) == len(authors), "one after the other"


def test_who_lacks_most_asks_seldom_and_for_all_that_was_lost_at_once_when_more_comes() -> None:
    """It is late with the others, as far as it can tell, until what they say next shows that something was lost."""
    fleet = Fleet(n=FEW + 4, conditions=Conditions(delay=0.001)).boot_all()
    fleet.run_rounds(20)
    asked = listen(fleet, 0, Need)
    fleet.network.cut = lambda sender, receiver: receiver == 0
    fleet.run_rounds(23)
    assert len(asked) <= 2
    fleet.network.cut = lambda sender, receiver: False
    fleet.run_rounds(26)
    memory = fleet.robots[0].agent._replica.memory if fleet.robots[0].agent._replica else None
    assert memory is not None and memory.applied >= 24


def under_way(n: int) -> tuple[Fleet, Replica, Memory]:
    """A fleet in its 20th round, and robot 1's memory."""
    fleet = Fleet(n=n, conditions=Conditions(delay=0.001)).boot_all()
    fleet.run_rounds(20)
    replica = fleet.robots[1].agent._replica
    assert replica is not None and replica.memory is not None
    return fleet, replica, replica.memory


@pytest.mark.parametrize("ahead", [0, 1])
def test_who_has_not_closed_yet_does_not_answer(ahead: int) -> None:
    """Its closing goes to all."""
    fleet, replica, memory = under_way(3)
    answers = listen(fleet, 1, Round)
    asking = replace(replica._speech._head([0]), pid=0)
    closed = memory.held[1]
    replica.take(Need(asking, 0, closed + ahead, memory.applied, memory.held, ()), closed + 1)
    assert [*answers.values()] == ([] if ahead else [{0}])


@pytest.mark.parametrize("strained", [False, True])
def test_what_another_lacks_is_repeated_unasked_unless_time_is_short(strained: bool) -> None:
    fleet, replica, memory = under_way(3)
    said, through = listen(fleet, 1, Round), memory.held[1]
    lacks = tuple(held - 2 for held in memory.held)
    replica.take(
        Round(replace(replica._speech._head([0]), pid=0), 0, through + 1, through - 2, 0, False, lacks, ()), through
    )
    assert memory.unanswered() == [0]
    memory.close(through + 1, {}, stopped=False)
    replica.publish(through + 1, through + 1, strained)
    assert said == {fleet.time.time: {0, 2}}
    assert memory.unanswered() == ([0] if strained else []), "and it is not forgotten"


def test_of_many_that_lack_something_one_is_sent_it_another_each_round() -> None:
    n = FEW + 3
    _, replica, memory = under_way(n)
    others = {p for p in range(n) if p != 1}
    through = memory.held[1]
    lacks = tuple(held - 2 for held in memory.held)
    for pid in others:
        head = replace(replica._speech._head([pid]), pid=pid)
        replica.take(Round(head, 0, through + 1, through - 2, 0, False, lacks, ()), through)
    answered = []
    for round_ in (through + 1, through + 2):
        before = set(memory.unanswered())
        memory.close(round_, {}, stopped=False)
        replica.publish(round_, round_, strained=False)
        answered.append(before - set(memory.unanswered()))
    assert [len(pids) for pids in answered] == [1, 1] and answered[0] != answered[1]
