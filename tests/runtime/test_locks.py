"""Transactions on robots: one commit a lock and round, in turns; no update is lost, whatever the network does."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from koordgen.runtime.memory import winner
from koordgen.runtime.network import Conditions
from koordgen.runtime.program import Event, Program, Stopped
from tests.runtime.fleet import Fleet
from tests.runtime.lineform import PROGRAM, State

OFTEN = 12  # times that each robot counts


def counts(s: State) -> None:
    s.last.value = s.last.value + 1
    s.count.value = s.count.value + 1


def stays(s: State) -> None:
    s.x.own = s.position


def stop(s: State) -> None:
    raise Stopped


def start(s: State) -> None:
    s.last.value = 0


COUNTER = replace(
    PROGRAM,
    init=start,
    events=(
        Event("Count", 3, lambda s: s.count.value < OFTEN, counts, 0),
        Event("Finish", 7, lambda s: s.last.value == s.n_sys * OFTEN, stop),
        Event("Stay", 5, lambda s: True, stays),
    ),
    locks=(("last",),),
)


def plain(program: Program) -> Program:
    return replace(program, events=tuple(replace(e, lock=None) for e in program.events))


@pytest.mark.parametrize("n_sys", [1, 2, 5])
def test_each_lock_has_one_holder_a_round_and_everyone_has_a_turn(n_sys: int) -> None:
    for lock in range(3):
        assert {holder(lock, r, n_sys) for r in range(7, 7 + n_sys)} == set(range(n_sys))
        assert all(0 <= holder(lock, r, n_sys) < n_sys for r in range(50))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "conditions",
    [
        Conditions(delay=0.001, jitter=0.004),
        Conditions(loss=0.3, duplication=0.2, delay=0.001, jitter=0.03),
    ],
)
def test_an_atomic_counter_loses_no_update(conditions: Conditions, seed: int) -> None:
    fleet = Fleet(n=5, seed=seed, conditions=conditions, program=COUNTER).boot_all()
    fleet.run(
        120, until=lambda: all(r.agent._rounds is not None and r.agent._rounds.stopped for r in fleet.robots.values())
    )
    for robot in fleet.robots.values():
        assert robot.agent._runner.locals == {"count": OFTEN}
        assert robot.agent._rounds is not None and robot.agent._rounds.stopped
    committed = [rec for r in fleet.robots.values() for rec in r.records if rec.event == "Count" and rec.effects]
    assert len({rec.round for rec in committed}) == len(committed) == 5 * OFTEN
    assert sorted(rec.effects.shared["last"] for rec in committed if rec.effects) == list(range(1, 5 * OFTEN + 1))


def test_without_the_right_the_same_counter_loses_updates() -> None:
    """What the test above would see."""
    fleet = Fleet(n=5, program=plain(COUNTER)).boot_all()
    fleet.run_rounds(30)
    frame = fleet.robots[0].records[-1].frame
    assert frame is not None and frame.shared["last"] == OFTEN


def test_a_robot_without_the_right_skips_and_does_not_fall_through() -> None:
    fleet = Fleet(n=3, program=COUNTER).boot_all()
    fleet.run_rounds(6)
    for pid, robot in fleet.robots.items():
        for record in robot.records[:6]:
            if holder(0, record.round, 3) == pid:
                assert (record.event, record.skipped) == ("Count", None)
            else:
                assert record.event is None and record.effects is None
                assert record.skipped == "Count waits for its turn to change last"
        traced = robot.trace("round")[:6]
        assert [t["skipped"] for t in traced] == [r.skipped for r in robot.records[:6]]
        assert robot.agent.counters()["waited"] == 4
        assert not robot.held()


def test_a_commit_goes_before_the_plain_writes_of_its_round() -> None:
    """A plain write of the lowest pid wins over a commit of the highest."""

    def plainly(s: State) -> None:
        s.last.value = 100

    program = replace(
        COUNTER,
        events=(
            Event("Count", 3, lambda s: s.pid == 2, counts, 0),
            Event("Plain", 5, lambda s: s.pid == 0, plainly),
        ),
    )
    fleet = Fleet(n=3, program=program).boot_all()
    fleet.run_rounds(9)
    committed = [r.round for r in fleet.robots[2].records if r.event == "Count"]
    assert committed == [r for r in range(1, 10) if holder(0, r, 3) == 2]
    seen = {r.round: r.frame.shared["last"] for r in fleet.robots[0].records if r.frame is not None}
    assert all(seen[r] == 100 for r in range(2, 10))


def test_streams_are_told_and_traced() -> None:
    def speaks(s: State) -> None:
        s.emit("Log.stdout", "round of ", str(s.pid))

    program = replace(PROGRAM, events=(Event("Speak", 3, lambda s: s.pid == 1, speaks),))
    fleet = Fleet(n=2, program=program).boot_all()
    fleet.run_rounds(3)
    bert = fleet.robots[1]
    streamed = [json.loads(line) for line in bert.file.getvalue().splitlines() if b'"stream"' in line]
    assert [(t["round"], t["port"], t["text"]) for t in streamed] == [
        (r, "Log.stdout", "round of 1") for r in (1, 2, 3)
    ]
    assert len([line for line in bert.lines if line.endswith("Log.stdout: round of 1")]) == 3
    assert not fleet.robots[0].trace("stream")
