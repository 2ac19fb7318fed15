"""Shared memory through whole agents: next-round visibility, equal replicas, loss, partitions, late robots."""

from __future__ import annotations

import pytest

from koordgen.runtime.memory import WINDOW
from koordgen.runtime.network import Conditions
from tests.runtime.fleet import Fleet
from tests.runtime.reference import check_visibility, stores


def lossy(loss: float) -> Conditions:
    return Conditions(loss=loss, delay=0.001, jitter=0.02, duplication=0.1)


@pytest.mark.parametrize(("loss", "least"), [(0.0, 1.0), (0.1, 0.99), (0.3, 0.93)])
def test_events_see_the_store_of_their_round_and_nothing_else(loss: float, least: float) -> None:
    fleet = Fleet(seed=7, conditions=lossy(loss)).boot_all()
    fleet.run_rounds(150)
    assert check_visibility(fleet) >= least * 5 * 149
    ran = sum(r.event is not None for robot in fleet.robots.values() for r in robot.records)
    assert ran >= least * 3 * 149


def test_replicas_are_equal_and_the_highest_pid_wins() -> None:
    fleet = Fleet(conditions=lossy(0.2)).boot_all()
    fleet.run_rounds(60)
    writers = {pid for pid, robot in fleet.robots.items() for r in robot.records[:-1] if r.event}
    assert writers == {1, 2, 3}
    frames = {
        pid: {r.round: r.frame.shared for r in robot.records if r.frame is not None}
        for pid, robot in fleet.robots.items()
    }
    common = set.intersection(*(set(f) for f in frames.values()))
    assert len(common) > 40
    for round_ in common:
        assert all(frames[pid][round_] == frames[0][round_] for pid in frames)
    by_round = stores(fleet)
    for round_ in range(2, 60):
        wrote = [p for p in (1, 2, 3) if any(r.round == round_ - 1 and r.event for r in fleet.robots[p].records)]
        if wrote:
            assert by_round[round_]["last"] == max(wrote)


def test_one_datagram_per_peer_and_round_when_nothing_is_lost() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(10)
    fleet.run(0.05)
    before = fleet.network.sent
    fleet.run(20 * fleet.delta)
    assert fleet.network.sent - before == 20 * 5 * 4


def test_all_wait_for_the_last_init() -> None:
    fleet = Fleet(conditions=lossy(0.1))
    for pid in (0, 1, 2, 4):
        fleet.boot(pid)
    fleet.run(5.0)
    assert all(r.agent.round == 0 and r.agent.phase == "joining" and r.platform.held for r in fleet.robots.values())
    assert any("waiting for dora, not heard yet" in line for line in fleet.robots[1].lines)
    fleet.boot(3)
    fleet.run_rounds(3)
    assert all(r.records[0].round == 1 for r in fleet.robots.values())
    assert not any(r.platform.held for r in fleet.robots.values())
    check_visibility(fleet)


def test_a_robot_out_of_reach_makes_all_skip_and_hold_until_it_is_back() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(20)
    fleet.network.cut = lambda sender, receiver: 2 in (sender, receiver)
    fleet.run(10 * fleet.delta)
    for pid, robot in fleet.robots.items():
        assert robot.platform.held
        assert all(r.frame is None for r in robot.records[-7:])
        lacks = "alice, bert, dora, emil" if pid == 2 else "cleo"
        assert robot.records[-1].skipped == f"not current: lacks {lacks}"
        assert any("10 rounds in a row" in line for line in robot.lines) is False
    fleet.network.cut = lambda sender, receiver: False
    healed = fleet.robots[0].agent.round
    fleet.run(5 * fleet.delta)
    for robot in fleet.robots.values():
        assert all(r.frame is not None for r in robot.records if r.round > healed + 1)
        assert not robot.platform.held
    check_visibility(fleet)


def test_a_long_partition_costs_no_memory_and_heals_in_two_rounds() -> None:
    fleet = Fleet(conditions=lossy(0.1)).boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: (sender < 2) != (receiver < 2)
    fleet.run(400 * fleet.delta)
    for robot in fleet.robots.values():
        rounds = robot.agent._rounds
        assert rounds is not None
        assert sum(len(log.entries) + len(log.later) for log in rounds._memory._logs) < 60
    assert any("10 rounds in a row not current" in line for line in fleet.robots[0].lines)
    fleet.network.cut = lambda sender, receiver: False
    healed = fleet.robots[0].agent.round
    fleet.run(10 * fleet.delta)
    for robot in fleet.robots.values():
        assert all(r.frame is not None for r in robot.records if r.round > healed + 3)
    check_visibility(fleet)


def test_a_deaf_robot_bounds_what_the_others_write() -> None:
    fleet = Fleet(delta=0.02, conditions=Conditions(delay=0.0005, jitter=0.001)).boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: receiver == 4
    fleet.run((WINDOW + 60) * fleet.delta)
    bert = fleet.robots[1]
    assert bert.records[WINDOW // 2].event is not None
    assert bert.records[-1].skipped == "not current: emil lags behind"
    rounds = bert.agent._rounds
    assert rounds is not None
    assert all(len(log.entries) <= WINDOW + 2 for log in rounds._memory._logs)
    fleet.network.cut = lambda sender, receiver: False
    fleet.run(60 * fleet.delta)
    assert all(r.records[-1].frame is not None for r in fleet.robots.values())
    check_visibility(fleet)


def test_a_robot_that_misses_the_start_joins_the_present_round() -> None:
    fleet = Fleet().boot_all()
    fleet.network.cut = lambda sender, receiver: receiver == 4 and fleet.robots[0].agent._joining.mission is not None
    fleet.run(1.0)
    assert fleet.robots[4].agent.phase == "joining"
    fleet.run(2.0)
    assert fleet.robots[4].agent.round == 0
    assert all(r.records and r.records[-1].frame is None for p, r in fleet.robots.items() if p != 4)
    fleet.network.cut = lambda sender, receiver: False
    fleet.run(2.0)
    emil = fleet.robots[4]
    assert emil.records[0].round > 5
    assert emil.agent.counters()["missed"] == emil.records[0].round - 1
    assert all(r.records[-1].frame is not None for r in fleet.robots.values())
    check_visibility(fleet)


def test_one_robot_alone_runs_and_keeps_nothing() -> None:
    fleet = Fleet(n=1).boot_all()
    fleet.run_rounds(300)
    rounds = fleet.robots[0].agent._rounds
    assert rounds is not None
    assert len(rounds._memory._logs[0].entries) <= 2
    check_visibility(fleet)


def test_a_robot_that_sleeps_goes_on_with_the_present_round() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(10)
    bert = fleet.robots[1]
    fleet.network.cut = lambda sender, receiver: receiver == 1
    fleet.run(0.01)
    bert.wake = fleet.time.time + 0.75
    fleet.run(0.76)
    fleet.network.cut = lambda sender, receiver: False
    fleet.run(0.5)
    rounds = [r.round for r in bert.records]
    assert bert.agent.counters()["missed"] >= 6
    assert rounds[-1] == fleet.robots[0].agent.round
    assert bert.records[-1].frame is not None
    check_visibility(fleet)


def test_a_robot_that_wakes_after_the_deadline_runs_no_event() -> None:
    fleet = Fleet(n=1).boot_all()
    fleet.run_rounds(5)
    robot = fleet.robots[0]
    robot.wake = fleet.time.time + 0.16  # within round 6, past its publish deadline
    fleet.run(0.17)
    assert robot.records[-1].round == 6 and robot.records[-1].skipped == "woke after the publish deadline"


def test_a_robot_that_wakes_late_again_and_again_says_so() -> None:
    fleet = Fleet(n=1).boot_all()
    fleet.run_rounds(5)
    robot = fleet.robots[0]
    fleet.run(0.065)
    for _ in range(12):
        robot.wake = fleet.time.time + 0.095
        fleet.run(0.1)
    assert len([line for line in robot.lines if "10 rounds in a row woke after the publish deadline" in line]) == 1
    assert robot.records[-1].fault is None


def test_the_same_seed_gives_the_same_traces() -> None:
    def traces() -> list[bytes]:
        fleet = Fleet(seed=3, conditions=lossy(0.2)).boot_all()
        fleet.run_rounds(30)
        return [r.file.getvalue() for r in fleet.robots.values()]

    assert traces() == traces()
