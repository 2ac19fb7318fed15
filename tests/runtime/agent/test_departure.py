"""What an agent does before a round's closing leaves, what it leaves for later, and what is there when it dies between
the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import KEY, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.agent.store import Acceptor, Locals
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.net.wire import Round, decode
from koordgen.runtime.program.program import Event
from koordgen.runtime.values.points import Point


def count(s: State) -> None:
    s.count.value += 1
    s.x.own = Point(float(s.count.value), 0.0, 0.0)


COUNTING = replace(PROGRAM, init=None, events=(Event("Count", 3, lambda s: True, count),))  # nothing leaves the robot
CALM = Conditions(delay=0.001)


def closed(datagram: bytes, pid: int) -> list[int]:
    """The rounds that a robot closes by a datagram."""
    message = decode(datagram, KEY)
    return [c.round for c in message.closings if c.author == pid] if isinstance(message, Round) else []


def listen(fleet: Fleet, pid: int) -> list[tuple[str, int]]:
    """What a robot does, in order: keeps its variables, keeps its word, sends a closing, tells of a round."""
    happened: list[tuple[str, int]] = []
    transport, kept = fleet.robots[pid].agent._transport, fleet.kept[pid]
    send, write, observe = transport.send, kept.write, fleet.robots[pid].agent._journal.observe

    def sends(to: Sequence[int], datagram: bytes) -> None:
        happened.extend(("left", round_) for round_ in closed(datagram, pid))
        send(to, datagram)

    def writes(record: Any) -> bool:
        match record:
            case Locals():
                happened.append(("kept", record.round))
            case Acceptor():
                happened.append(("said", record.applied))
        return write(record)

    def observes(record: Any, counters: Any) -> None:
        happened.append(("told", record.round))
        observe(record, counters)

    transport.send, kept.write = sends, writes  # type: ignore[method-assign]
    fleet.robots[pid].agent._journal.observe = observes  # type: ignore[method-assign]
    return happened


def test_a_life_is_kept_before_its_closing_leaves_and_all_else_comes_after() -> None:
    fleet = Fleet(n=3, program=COUNTING, conditions=CALM).boot_all()
    happened = listen(fleet, 1)
    fleet.run_rounds(40)
    first = happened.index(("left", 10))
    for round_ in range(11, 39):
        kept, left = happened.index(("kept", round_), first), happened.index(("left", round_), first)
        assert happened[kept + 1] == ("left", round_), "nothing is done between the two"
        assert kept > first and happened[kept - 1][0] == "told", "no record waits when the next round begins"
        before = happened[first:kept]
        assert ("told", round_ - 2) in before and ("told", round_) not in happened[:left]
        said = happened.index(("said", round_ - 2))
        assert said < happened.index(("told", round_ - 2)), "the own word that makes it certain is kept before"
        first = left
    told = [round_ for what, round_ in happened if what == "told"]
    assert told == list(range(told[0], told[-1] + 1)), "each once, in order"


@pytest.mark.parametrize("seed", range(4))
def test_what_an_event_commanded_is_there_before_the_next_event(seed: int) -> None:
    """Where words come late, outputs wait beyond their round."""
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


def test_the_own_closing_leaves_before_what_has_arrived_is_looked_at() -> None:
    """Then who finds that all others have closed the round, too, waits for the next one, not to ask for closings."""
    fleet = Fleet(n=3, program=COUNTING, conditions=CALM).boot_all()
    fleet.run_rounds(20)
    agent, rounds = fleet.robots[1].agent, fleet.robots[1].agent._rounds
    assert rounds is not None
    fleet.run(1.0, until=lambda: rounds.calm)
    robot = fleet.robots.pop(1)
    fleet.run(robot.clock.true(rounds._tick(1.0)) + 0.01 - fleet.time.time)  # it sleeps until all others have closed
    agent._next_body = agent._joining._next = 1e9
    before = rounds.round
    wake = agent.poll(robot.clock.now())
    memory = rounds._replica.memory
    assert rounds.round == before + 1 and memory is not None
    assert memory.held[1] == rounds.round and memory.applied == before, "nothing was looked at"
    assert wake <= rounds._tick(1.0)
    wake = agent.poll(robot.clock.now())
    assert memory.applied == rounds.round and wake == pytest.approx(rounds._tick(1.0))
