"""Inner robots killed at random moments, at 20 % loss: no outer event is lost and none counts twice."""

from __future__ import annotations

from random import Random

import pytest

from koordgen.runtime.net.network import Conditions
from tests.squads.levels import Levels
from tests.squads.test_hosts import COUNT

LOSSY = Conditions(loss=0.2, delay=0.001, jitter=0.01, duplication=0.05)


def killed(seed: int, kills: int) -> tuple[Levels, int]:
    """Kill and restart random robots of two squads. Return the fleet, and the number of hosts among the killed ones."""
    dice = Random(seed)
    levels, hosts = Levels(COUNT, [3, 3, 0], seed, LOSSY), 0
    levels.run_rounds(4)
    for _ in range(kills):
        levels.run(dice.uniform(0.0, 3.0))
        squad = dice.randrange(2)
        place = dice.choice(levels.places(squad))
        hosts += levels.nodes[place].outer is not None
        levels.kill(place)
        levels.run(dice.uniform(0.5, 6.0))
        levels.boot(place)
        levels.run_rounds(max(levels.applied) + 3)
        assert levels.run(60, lambda place=place: levels.nodes[place].agent.state is not None)  # type: ignore[misc]
    return levels, hosts


def test_no_outer_event_is_lost_and_none_counts_twice() -> None:
    levels, _ = killed(1, 2)
    assert levels.follow(levels.complete)["event"] > 20


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 20))
def test_the_outer_fleet_survives_many_kills(seed: int) -> None:
    levels, _ = killed(seed, 5)
    assert levels.follow(levels.complete)["event"] > 100
