"""An emergency stop that one robot has heard reaches all of them, by whatever words get through."""

from __future__ import annotations

import pytest

from benchmarks.fixtures.fleet import Fleet, Robot
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net.network import Conditions


def stopping(robot: Robot) -> bool:
    return robot.agent.phase in ("stopping", "stopped")


def test_all_come_to_rest_within_a_round_of_one_that_is_told() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(10)
    fleet.run(0.03)
    fleet.robots[2].agent.stop_all("emergency stop")
    assert stopping(fleet.robots[2])
    fleet.run(0.03)
    for pid, robot in fleet.robots.items():
        assert stopping(robot) and robot.platform.stopping is not None
        if pid != 2:
            assert len([x for x in robot.lines if "emergency stop, received from another robot" in x]) == 1
    fleet.run(5.0)
    assert all(r.done() and r.agent.status == 0 for r in fleet.robots.values())


@pytest.mark.parametrize("seed", range(5))
def test_it_gets_through_a_network_that_loses_most(seed: int) -> None:
    fleet = Fleet(seed=seed).boot_all()
    fleet.run_rounds(10)
    fleet.network.conditions = Conditions(loss=0.8, delay=0.001, jitter=0.02)
    fleet.robots[seed].agent.stop_all("emergency stop")
    fleet.run(3.0)
    assert all(stopping(r) for r in fleet.robots.values())


def test_it_goes_on_from_robot_to_robot() -> None:
    """Each hears only its neighbour."""
    fleet = Fleet().boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: abs(sender - receiver) > 1
    fleet.robots[0].agent.stop_all("emergency stop")
    fleet.run(0.2)
    assert all(stopping(r) for r in fleet.robots.values())


def test_a_robot_that_does_not_count_hears_it_too_and_spreads_it() -> None:
    fleet = Fleet(safety=Safety(peer_timeout=5)).boot_all()
    fleet.run_rounds(10)
    fleet.network.cut = lambda sender, receiver: sender == 4 or receiver == 4
    fleet.run(2.0)
    fleet.network.cut = lambda sender, receiver: (sender == 4) != (receiver == 4) and 3 not in (sender, receiver)
    emil = fleet.robots[4]
    emil.agent.stop_all("emergency stop")
    fleet.run(0.5)
    assert all(stopping(r) for r in fleet.robots.values())


def test_without_an_emergency_nobody_rests() -> None:
    fleet = Fleet(conditions=Conditions(loss=0.3, delay=0.001, jitter=0.02)).boot_all()
    fleet.run_rounds(30)
    assert not any(stopping(r) for r in fleet.robots.values())
