"""The ledger of a robot takes what is heard for the present round, on any network."""

from __future__ import annotations

import pytest

from benchmarks.fixtures.fleet import Fleet, Robot
from koordgen.runtime.net.ledger import LAST, TICK
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.replication.memory import AHEAD
from koordgen.runtime.replication.replica import SLOTS

LOSSES = pytest.mark.parametrize("loss", [0.0, 0.3])


def fleet(loss: float) -> Fleet:
    return Fleet(conditions=Conditions(loss, delay=0.001, jitter=0.03)).boot_all()


@LOSSES
def test_what_is_heard_counts_for_the_present_round(loss: float) -> None:
    """Also for a robot that lacked something of the last round when this one began: else the gate would soon refuse as
    too far ahead what the others close."""
    made, checked = fleet(loss), [0]

    def watch(robot: Robot) -> None:
        poll = robot.agent.poll

        def polls(now: float) -> float:
            wake, replica, round_ = poll(now), robot.agent._replica, robot.agent.round
            if round_ and replica is not None and replica.memory is not None:
                number, first = replica.memory.ledger.number, (round_ - 1) * SLOTS
                assert number[LAST] == round_ + AHEAD and first <= number[TICK] < first + SLOTS
                checked[0] += 1
            return wake

        robot.agent.poll = polls  # type: ignore[method-assign]

    for robot in made.robots.values():
        watch(robot)
    made.run_rounds(60)
    assert checked[0] > 60 * made.n
