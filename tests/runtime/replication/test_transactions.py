"""Transactions on robots: of all that contend, one counts for each lock and round; no update is lost, whatever the
network does."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.program import Event, Program, Stopped
from koordgen.runtime.replication.apply import winner
from tests.runtime.replication.agents import has_stopped, locals_of

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
def test_of_all_who_try_one_wins_and_everyone_has_a_turn(n_sys: int) -> None:
    everyone = list(range(n_sys))
    for lock in range(3):
        assert {winner(everyone, lock, r, n_sys) for r in range(7, 7 + n_sys)} == set(everyone)
        for only in everyone:
            assert winner([only], lock, 9, n_sys) == only, "who tries alone waits for no turn"
        for round_ in range(n_sys):
            assert winner(everyone[1:] or [0], lock, round_, n_sys) in (everyone[1:] or [0])


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
    fleet.run(120, until=lambda: all(map(has_stopped, fleet.robots.values())))
    fleet.run(2.0)  # the last round of the robot that stopped last must be committed
    for robot in fleet.robots.values():
        assert locals_of(robot) == {"count": OFTEN} and has_stopped(robot)
    committed = [rec for r in fleet.robots.values() for rec in r.records if rec.event == "Count" and rec.effects]
    assert len({rec.round for rec in committed}) == len(committed) == 5 * OFTEN
    assert sorted(rec.effects.shared["last"] for rec in committed if rec.effects) == list(range(1, 5 * OFTEN + 1))


def test_as_plain_events_the_same_counter_loses_updates() -> None:
    """What the test above would see."""
    fleet = Fleet(n=5, program=plain(COUNTER)).boot_all()
    fleet.run_rounds(30)
    frame = fleet.robots[0].records[-1].frame
    assert frame is not None and frame.shared["last"] == OFTEN


def test_who_gives_way_skips_and_does_not_fall_through() -> None:
    fleet = Fleet(n=3, program=COUNTER).boot_all()
    fleet.run_told(6)
    for pid, robot in fleet.robots.items():
        for record in robot.records[:6]:
            if winner(range(3), 0, record.round, 3) == pid:
                assert (record.event, record.skipped) == ("Count", None)
            else:
                assert record.event is None and record.effects is None and record.frame is None
                assert record.skipped == "lost contention: Count, to another robot's transaction"
        traced = robot.trace("round")[:6]
        assert [t["skipped"] for t in traced] == [r.skipped for r in robot.records[:6]]
        told = sum("lost contention" in (r.skipped or "") for r in robot.records)
        assert robot.agent.counters()["lost_contention"] - told in (0, 1)  # the last loss may not be counted yet
        assert not robot.held()


def test_transactions_of_different_locks_do_not_give_way_to_each_other() -> None:
    def other(s: State) -> None:
        s.count.value += 1

    events = (
        Event("Count", 3, lambda s: s.pid == 0, counts, 0),
        Event("Other", 5, lambda s: s.pid == 1, other, 1),
    )
    fleet = Fleet(n=2, program=replace(COUNTER, events=events, locks=(("last",), ("x",)))).boot_all()
    fleet.run_told(8)
    for pid, name in enumerate(("Count", "Other")):
        assert [r.event for r in fleet.robots[pid].records[:8]] == [name] * 8


def test_streams_are_told_and_traced() -> None:
    def speaks(s: State) -> None:
        s.emit("Log.stdout", "round of ", str(s.pid))

    program = replace(PROGRAM, events=(Event("Speak", 3, lambda s: s.pid == 1, speaks),))
    fleet = Fleet(n=2, program=program).boot_all()
    fleet.run_told(3)
    bert = fleet.robots[1]
    streamed = [json.loads(line) for line in bert.file.getvalue().splitlines() if b'"stream"' in line]
    assert [(t["round"], t["port"], t["text"]) for t in streamed] == [
        (r, "Log.stdout", "round of 1") for r in (1, 2, 3)
    ]
    assert len([line for line in bert.lines if line.endswith("Log.stdout: round of 1")]) == 3
    assert not fleet.robots[0].trace("stream")


def test_the_first_place_goes_round_from_robot_to_robot() -> None:
    """As docs/explanation/shared-memory.md says: the least (pid - round - lock) mod N_SYS."""
    assert [winner((0, 1, 2, 3), 0, round_, 4) for round_ in range(1, 6)] == [1, 2, 3, 0, 1]
    assert [winner((0, 1), 0, round_, 4) for round_ in range(1, 6)] == [1, 0, 0, 0, 1]
    assert winner((0, 1, 2, 3), 2, 1, 4) == 3
