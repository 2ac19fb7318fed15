"""Order of an agent's work around the departure of an entry: what comes before it, and what comes after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import KEY, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.agent.records import Acceptor, Locals
from koordgen.runtime.net.codec import decode
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.wire import RoundMessage
from koordgen.runtime.program.program import Event
from koordgen.runtime.values.points import Point
from tests.runtime.replication.agents import rounds_of, snapshot_of


def count(s: State) -> None:
    s.count.value += 1
    s.x.own = Point(float(s.count.value), 0.0, 0.0)


COUNTING = replace(PROGRAM, init=None, events=(Event("Count", 3, lambda s: True, count),))  # nothing leaves the robot
CALM = Conditions(delay=0.001)


def closed(datagram: bytes, pid: int) -> list[int]:
    """Return the rounds that a robot closes by a datagram."""
    message = decode(datagram, KEY)
    return [c.round for c in message.entries if c.author == pid] if isinstance(message, RoundMessage) else []


def listen(fleet: Fleet, pid: int) -> list[tuple[str, int]]:
    """Return what a robot does, in order: it persists its variables or a report, sends an entry, traces a round."""
    happened: list[tuple[str, int]] = []
    transport, kept = fleet.robots[pid].agent._transport, fleet.kept[pid]
    send, write, observe = transport.send, kept.write, fleet.robots[pid].agent._journal.observe

    def sends(to: Sequence[int], datagram: bytes) -> None:
        happened.extend(("left", round_) for round_ in closed(datagram, pid))
        send(to, datagram)

    def writes(record: Any) -> bool:
        match record:
            case Locals():
                happened.append(("persisted variables", record.round))
            case Acceptor():
                happened.append(("persisted report", record.applied))
        return write(record)

    def observes(record: Any, counters: Any) -> None:
        happened.append(("told", record.round))
        observe(record, counters)

    transport.send, kept.write = sends, writes  # type: ignore[method-assign]
    fleet.robots[pid].agent._journal.observe = observes  # type: ignore[method-assign]
    return happened


def test_a_life_is_persisted_before_its_entry_leaves_and_all_other_work_comes_later() -> None:
    fleet = Fleet(n=3, program=COUNTING, conditions=CALM).boot_all()
    happened = listen(fleet, 1)
    fleet.run_rounds(40)
    first = happened.index(("left", 10))
    for round_ in range(11, 39):
        kept, left = happened.index(("persisted variables", round_), first), happened.index(("left", round_), first)
        assert happened[kept + 1] == ("left", round_), "nothing is done between the two"
        assert kept > first and happened[kept - 1][0] == "told", "no record waits when the next round begins"
        before = happened[first:kept]
        assert ("told", round_ - 2) in before and ("told", round_) not in happened[:left]
        said = happened.index(("persisted report", round_ - 2))
        assert said < happened.index(("told", round_ - 2)), "the report that commits it is persisted before"
        first = left
    told = [round_ for what, round_ in happened if what == "told"]
    assert told == list(range(told[0], told[-1] + 1)), "each once, in order"


@pytest.mark.parametrize("seed", range(4))
def test_what_an_event_commanded_is_there_before_the_next_event(seed: int) -> None:
    """If reports arrive late, outputs wait beyond their round."""
    fleet = Fleet(n=5, seed=seed, conditions=Conditions(loss=0.2, delay=0.02, jitter=0.06)).boot_all()
    fleet.run_told(60)
    for pid in (1, 2, 3):
        robot = fleet.robots[pid]
        commanded = next(r.frame.actuators for r in robot.records if r.frame is not None)
        seen = 0
        for record in robot.records:
            if record.frame is not None:
                assert record.frame.actuators == commanded, (pid, record.round)
            if record.effects is not None:
                commanded = {**commanded, **record.effects.actuators}
                seen += 1
        assert seen > 20


def test_the_own_entry_leaves_before_messages_that_have_arrived_are_received() -> None:
    """A robot that then finds the entries of all others waits for the next round, and requests nothing."""
    fleet = Fleet(n=3, program=COUNTING, conditions=CALM).boot_all()
    fleet.run_rounds(20)
    rounds, state = rounds_of(fleet.robots[1]), snapshot_of(fleet.robots[1])
    assert rounds is not None and state is not None
    fleet.run(1.0, until=lambda: rounds.calm and state.applied == rounds.round)
    robot = fleet.robots.pop(1)
    due = rounds.poll(robot.clock.now(), robot.platform.sense, None)
    fleet.run(robot.clock.true(due) + 0.01 - fleet.time.time)  # it sleeps until all others have closed the next round
    before, asked = rounds.round, rounds.counters.asked
    robot.agent.poll(robot.clock.now())
    assert rounds.round == before + 1
    assert state.held[1] == rounds.round and state.applied == before, "nothing was received yet"
    robot.agent.poll(robot.clock.now())
    assert state.applied == rounds.round
    wake = rounds.poll(robot.clock.now(), robot.platform.sense, None)
    assert wake == pytest.approx(due + fleet.delta, abs=1e-4) and rounds.counters.asked == asked
