"""Shared memory through whole agents: next-round visibility, equal replicas, loss, partitions, late robots."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.agent import rounds
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.program import Event
from tests.runtime.replication.reference import check_visibility, stores


def silent(s: State) -> None:
    s.x.own = s.position
    s.last.value = s.pid


SILENT = replace(PROGRAM, events=(Event("Silent", 3, lambda s: True, silent),))  # nothing leaves the robot


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
    """If no output waits for it, a round is acknowledged by the next round's datagram."""
    fleet = Fleet(program=SILENT).boot_all()
    fleet.run_rounds(10)
    fleet.run(0.05)
    before = fleet.network.sent
    fleet.run(20 * fleet.delta)
    assert all(r.records[-2].event == "Silent" for r in fleet.robots.values())
    assert fleet.network.sent - before == 20 * 5 * 4


def test_an_event_with_outputs_costs_one_more_datagram_from_each_other_robot() -> None:
    """LineForm: three robots command their bodies in each round, and the others acknowledge it to them at once."""
    fleet = Fleet().boot_all()
    fleet.run_rounds(10)
    fleet.run(0.05)
    before = fleet.network.sent
    fleet.run(20 * fleet.delta)
    assert fleet.network.sent - before == 20 * (5 * 4 + 3 * 4)


def test_outputs_take_effect_in_their_own_round_when_nothing_is_lost() -> None:
    fleet = Fleet().boot_all()
    fleet.run_told(20)
    bert = fleet.robots[1]
    assert [r.event for r in bert.records[:20]] == ["TargetUpdate"] * 20
    for (time, _), record in zip(bert.platform.commands, bert.records, strict=False):
        assert 0 < time - record.time < 0.5 * fleet.delta


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


def test_a_robot_out_of_reach_is_left_out_and_rejoins_by_itself() -> None:
    fleet = Fleet(safety=Safety(peer_timeout=10)).boot_all()
    fleet.run_rounds(20)
    left = fleet.robots[0].agent.round
    fleet.network.cut = lambda sender, receiver: 2 in (sender, receiver)
    fleet.run(8 * fleet.delta)
    for robot in fleet.robots.values():
        assert robot.platform.held
        assert all(r.frame is None for r in robot.records if r.round > left + 2)
    fleet.run(22 * fleet.delta)
    cleo = fleet.robots[2]
    for pid, robot in fleet.robots.items():
        if pid != 2:
            assert robot.records[-1].frame is not None and not robot.platform.held
            assert len([x for x in robot.lines if "cleo does not count (view 1)" in x]) == 1
    assert cleo.platform.held and cleo.records[-1].round <= left + 1
    commanded = len(cleo.platform.commands)
    fleet.network.cut = lambda sender, receiver: False
    healed = fleet.robots[0].agent.round
    fleet.run(30 * fleet.delta)
    for robot in fleet.robots.values():
        assert all(r.frame is not None for r in robot.records if r.round > healed + 15)
        assert not robot.platform.held
        assert any("all robots count; cleo is back (view 2)" in x for x in robot.lines)
    assert len(cleo.platform.commands) > commanded
    check_visibility(fleet)


def test_a_robot_that_misses_the_start_is_admitted_later() -> None:
    fleet = Fleet().boot_all()
    fleet.network.cut = lambda sender, receiver: receiver == 4 and fleet.robots[0].agent._joining.mission is not None
    fleet.run(1.0)
    assert fleet.robots[4].agent.phase == "joining"
    fleet.run(2.0)
    assert fleet.robots[4].agent.round == 0
    fleet.run(3.0)
    assert all("emil does not count (view 1)" in "".join(r.lines) for p, r in fleet.robots.items() if p != 4)
    fleet.network.cut = lambda sender, receiver: False
    fleet.run(4.0)
    emil = fleet.robots[4]
    assert emil.records[0].round > 5
    assert emil.agent.counters()["missed"] > 0
    assert all(r.records[-1].frame is not None for r in fleet.robots.values())
    assert all("emil is back (view 2)" in "".join(r.lines) for p, r in fleet.robots.items() if p != 4)
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


def test_a_robot_that_waits_for_a_majority_says_so_and_rests_if_the_fleet_file_wants_that() -> None:
    """Though the records of these rounds wait for the others: so must no action of safety."""
    fleet = Fleet(safety=Safety(missed_rounds=12, missed_action="stop")).boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: 1 in (sender, receiver)
    fleet.run(15 * fleet.delta)
    bert = fleet.robots[1]
    assert len([line for line in bert.lines if "12 rounds in a row not current: lacks alice" in line]) == 1
    assert bert.agent.phase in ("stopping", "stopped")


def test_the_trace_of_a_robot_that_does_not_count_goes_on() -> None:
    fleet = Fleet(safety=Safety(peer_timeout=5)).boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: receiver == 0  # it does nothing, so nothing of it waits
    fleet.run(20 * fleet.delta)
    fleet.network.cut = lambda sender, receiver: sender == 0
    fleet.run(20 * fleet.delta)
    alice = fleet.robots[0]
    assert alice.records[-1].skipped == "not current: removed from the fleet, asks to rejoin"
    assert [r.round for r in alice.records] == list(range(1, alice.records[-1].round + 1))
    assert alice.records[-1].round >= alice.agent.round - 1


@pytest.mark.parametrize(("delta", "delay"), [(0.1, 0.001), (0.002, 0.00002)])
def test_a_robot_expects_the_entries_that_its_closed_round_lacks(delta: float, delay: float) -> None:
    fleet = Fleet(n=3, delta=delta, conditions=Conditions(delay=delay, jitter=4 * delay)).boot_all()
    agent = fleet.robots[0].agent
    seen = {agent.expects}

    def note() -> bool:
        seen.add(agent.expects)
        return agent.round == 20

    fleet.run(60, until=note)
    assert seen == {(1, 0.0), *((n, min(n * rounds.GATHER, rounds.MOST_GATHER * delta)) for n in (1, 2))}
