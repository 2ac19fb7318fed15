"""Inner robots killed at random moments, at 20 % loss: no outer event is lost and none counts twice."""

from __future__ import annotations

from random import Random

import pytest

from tests.squads.levels import LOSSY, Levels
from tests.squads.test_hosts import COUNT


def killed(seed: int, kills: int, text: str = COUNT) -> Levels:
    """Kill and restart random robots of two squads: at any moment, or a host while its outer robot has news.

    `text`: the outer program."""
    dice = Random(seed)
    levels = Levels(text, [3, 3, 0], seed, LOSSY)
    levels.run_rounds(4)
    for _ in range(kills):
        levels.run(dice.uniform(0.0, 3.0))
        squad = dice.randrange(2)
        place = dice.choice(levels.places(squad))
        if dice.random() < 0.5:
            place = after_an_event(levels, squad)
            levels.run(dice.uniform(0.0, 0.03))
        levels.kill(place)
        levels.run(dice.uniform(0.5, 6.0))
        levels.boot(place)
        levels.run_rounds(max(levels.applied) + 3)
        assert levels.run(60, lambda place=place: levels.nodes[place].agent.state is not None)  # type: ignore[misc]
    return levels


def after_an_event(levels: Levels, squad: int) -> int:
    """Run until an outer robot has begun a new outer round. Return the place of its host."""

    def round_() -> int:
        outer = levels.outer(squad)
        return outer.round if outer is not None else 0

    assert levels.run(60, lambda: round_() > 0)
    before = round_()
    assert levels.run(60, lambda: round_() > before)
    host = levels.host(squad)
    assert host is not None
    return host.place


def test_no_outer_event_is_lost_and_none_counts_twice() -> None:
    levels = killed(1, 3)
    assert levels.follow(levels.complete)["event"] > 20


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 22))
def test_the_outer_fleet_survives_many_kills(seed: int) -> None:
    levels = killed(seed, 5)
    assert levels.follow(levels.complete)["event"] > 60
