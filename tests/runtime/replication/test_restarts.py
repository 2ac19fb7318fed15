"""Processes that die at any moment: the robot comes back into its mission, and what each robot holds for its own goes
with what all hold together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks.fixtures.fleet import NAMES, Fleet, Robot
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent.checkpoint import CheckpointFile, CheckpointStore
from koordgen.runtime.agent.records import KEPT, Acceptor, Locals, MemoryStore, Mission
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.clock import SimulatedClock
from tests.runtime.replication.agents import locals_of, snapshot_of
from tests.runtime.replication.reference import check_visibility
from tests.runtime.replication.test_transactions import COUNTER, OFTEN

SOON = Safety(peer_timeout=8)
ENDLESS = replace(COUNTER, events=(COUNTER.events[0], COUNTER.events[2]))  # goes on when all have counted


def counters(seed: int, loss: float, n: int = 5) -> Fleet:
    conditions = Conditions(loss=loss, delay=0.001, jitter=0.02, duplication=0.1)
    return Fleet(n=n, seed=seed, conditions=conditions, program=ENDLESS, safety=SOON).boot_all()


def kill(fleet: Fleet, pid: int) -> Robot:
    """As by SIGKILL: what it kept is there, all else is gone."""
    fleet.network._queues.pop(pid, None)
    return fleet.robots.pop(pid)


def total(robot: Robot) -> int | None:
    """Return the shared counter in this robot's store."""
    state = snapshot_of(robot)
    return None if state is None else int(state.shared["last"])


def own(robot: Robot) -> int:
    return int(locals_of(robot)["count"])


def finish(fleet: Fleet) -> None:
    """Until every robot that is there has counted as often as it shall; then all stores are alike."""

    def counted(robot: Robot) -> bool:
        return total(robot) is not None and own(robot) == OFTEN

    fleet.run(60, until=lambda: all(counted(r) for r in fleet.robots.values()))
    fleet.run(1.0)
    states = {pid: (own(r), total(r), r.agent.phase) for pid, r in fleet.robots.items()}
    assert all(counted(r) for r in fleet.robots.values()), states
    assert len({total(r) for r in fleet.robots.values()}) == 1, states


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(6))
def test_a_robot_that_dies_and_comes_back_has_counted_what_the_fleet_has(seed: int, loss: float) -> None:
    fleet, rng = counters(seed, loss), Random(seed)
    for _ in range(2):
        fleet.run(1.0 + rng.random() * 2)
        pid = rng.randrange(5)
        kill(fleet, pid)
        fleet.run(rng.random() * 2.5)
        fleet.boot(pid)
    finish(fleet)
    assert total(fleet.robots[0]) == 5 * OFTEN


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("seed", range(100, 140))
def test_a_robot_that_dies_often(seed: int, loss: float) -> None:
    fleet, rng = counters(seed, loss), Random(seed)
    for _ in range(4):
        fleet.run(rng.random() * 2)
        pid = rng.randrange(5)
        kill(fleet, pid)
        fleet.run(rng.random() * 2.5)
        fleet.boot(pid)
    finish(fleet)
    assert total(fleet.robots[0]) == 5 * OFTEN


@pytest.mark.parametrize("seed", range(4))
def test_what_a_robot_that_is_gone_had_counted_stays_counted(seed: int) -> None:
    fleet, rng = counters(seed, 0.1), Random(seed)
    fleet.run(1.5 + rng.random())
    gone = kill(fleet, rng.randrange(5))
    finish(fleet)
    told = sum(r.event == "Count" for r in gone.records)
    held = total(next(iter(fleet.robots.values())))
    assert held is not None and 4 * OFTEN + told <= held <= 4 * OFTEN + told + 2
    assert all("does not count" in "".join(r.lines) for r in fleet.robots.values())


@pytest.mark.parametrize("seed", range(4))
def test_a_partition_takes_no_count_from_anyone(seed: int) -> None:
    fleet, rng = counters(seed, 0.1), Random(seed)
    fleet.run(1.0 + rng.random() * 2)
    small = set(rng.sample(range(5), 2))
    fleet.network.cut = lambda s, r: (s in small) != (r in small)
    fleet.run(rng.random() * 4)
    fleet.network.cut = lambda s, r: False
    finish(fleet)
    assert total(fleet.robots[0]) == 5 * OFTEN


@pytest.mark.parametrize("seed", range(3))
def test_outputs_and_what_is_seen_go_on_where_they_were(seed: int) -> None:
    fleet = Fleet(seed=seed, safety=SOON).boot_all()
    fleet.run_rounds(15)
    old = kill(fleet, 2)
    done = [r.effects.locals["count"] for r in old.records if r.effects is not None]
    fleet.run(0.4)
    new = fleet.boot(2, old.platform)
    fleet.run(4.0)
    again = [r.effects.locals["count"] for r in new.records if r.effects is not None]
    assert done == list(range(1, len(done) + 1))
    assert again and again == list(range(again[0], again[0] + len(again)))
    assert again[0] in (done[-1] + 1, done[-1] + 2), "at most one that counted was not told before it died"
    assert new.agent.phase == "running" and not new.platform.held


@pytest.mark.parametrize(
    ("seed", "pid", "jump"), [(9, 1, 90.0), (13, 1, 90.0), (54, 1, 90.0), (1, 0, 90.0), (1, 0, -90.0)]
)
def test_a_robot_whose_computer_was_restarted_comes_back_with_another_clock(seed: int, pid: int, jump: float) -> None:
    conditions = Conditions(loss=0.4, delay=0.001, jitter=0.02)
    fleet = Fleet(n=3, seed=seed, conditions=conditions, program=ENDLESS, safety=SOON).boot_all()
    fleet.run_rounds(20)
    kill(fleet, pid)
    fleet._clocks[pid] = SimulatedClock(fleet.time, offset=100.0 * (pid + 1) + jump)
    fleet.boot(pid)
    fleet.run(10.0)
    rounds = [robot.agent.round for robot in fleet.robots.values()]
    assert max(rounds) - min(rounds) <= 1 and total(fleet.robots[pid]) is not None, rounds


def test_when_all_die_at_once_a_new_mission_begins() -> None:
    fleet = Fleet(n=3, safety=SOON).boot_all()
    fleet.run_rounds(10)
    before = fleet.robots[0].agent._link.epoch
    for pid in range(3):
        kill(fleet, pid)
    fleet.boot_all()
    fleet.run(8.0)
    assert all(r.agent.phase == "running" for r in fleet.robots.values())
    assert fleet.robots[0].agent._link.epoch not in (before, b"")
    assert any("a new mission begins" in line for line in fleet.robots[0].lines)
    check_visibility(fleet)


def test_one_robot_alone_begins_anew() -> None:
    fleet = Fleet(n=1).boot_all()
    fleet.run_rounds(10)
    kill(fleet, 0)
    fleet.boot(0)
    fleet.run(5.0)
    assert fleet.robots[0].agent.round > 0 and fleet.robots[0].agent.phase == "running"


def keepers(folder: Path) -> list[CheckpointStore]:
    return [
        MemoryStore(),
        CheckpointFile.open(folder / "state", PROGRAM, NAMES[0], 0, 5, lambda text: pytest.fail(text)),
    ]


def test_the_tests_stand_in_keeps_what_the_file_keeps(tmp_path: Path) -> None:
    fake, real = keepers(tmp_path)
    rng = Random(5)
    for step in range(3000):
        record: Any
        match rng.randrange(20):
            case 0:
                record = Mission(rng.randbytes(8), rng.randrange(10**9), b"init")
            case 1 | 2:
                record = Acceptor(b"view", step, rng.randrange(9), 3, 2, b"")
            case 3 if rng.random() < 0.1:
                fake.clear()
                real.clear()
                continue
            case _:
                back = 3 if rng.random() < 0.2 else 0  # a robot that comes back may have to go back
                record = Locals(max(0, step // 2 - back), rng.randrange(3), b"%d" % step, b"", False)
        assert fake.write(record) and real.write(record)
        if step % 7 == 0:
            assert fake.load() == real.load(), step
    assert 1 < len(real.load().locals) <= KEPT
