"""Inner robots killed, cut off or frozen at random moments, at 20 % loss: no outer event is lost, none counts twice.

No outer robot speaks with two voices: a host is silent once another one has spoken."""

from __future__ import annotations

from random import Random

import pytest

from tests.squads.levels import LOSSY, Levels
from tests.squads.test_hosts import COUNT

KINDS = ["kill", "cut from its squad", "cut from all", "freeze"]


def disturbed(seed: int, times: int, kinds: list[str], text: str = COUNT) -> Levels:
    """Disturb random robots of two squads: at any moment, or a host while its outer robot has news.

    `text`: the outer program."""
    dice = Random(seed)
    levels = Levels(text, [3, 3, 0], seed, LOSSY)
    levels.run_rounds(4)
    for _ in range(times):
        levels.run(dice.uniform(0.0, 3.0))
        squad, kind = dice.randrange(2), dice.choice(kinds)
        place = dice.choice(levels.places(squad))
        if dice.random() < 0.5:
            place = after_an_event(levels, squad)
            levels.run(dice.uniform(0.0, 0.03))
        lasts = dice.uniform(0.5, 6.0)
        disturb(levels, kind, place, lasts)
        levels.run_rounds(max(levels.applied) + 3)
        assert levels.run(60, lambda place=place: levels.nodes[place].agent.state is not None)  # type: ignore[misc]
    return levels


def disturb(levels: Levels, kind: str, place: int, seconds: float) -> None:
    """Disturb a robot, and run until the disturbance is over."""
    if kind == "kill":
        levels.kill(place)
    elif kind == "freeze":
        levels.freeze(place, seconds)
    else:
        levels.cut(place, outside=kind == "cut from all")
    levels.run(seconds)
    levels.restore()
    if kind == "kill":
        levels.boot(place)


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


@pytest.mark.parametrize(("seed", "kinds"), [(1, KINDS[:1]), (5, KINDS[1:])], ids=["kills", "others"])
def test_no_outer_event_is_lost_and_none_counts_twice(seed: int, kinds: list[str]) -> None:
    levels = disturbed(seed, 3, kinds)
    assert levels.follow(levels.complete)["event"] > 20
    assert not levels.second_voices


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [KINDS[:1], KINDS], ids=["kills", "all"])
@pytest.mark.parametrize("seed", range(10, 22))
def test_the_outer_fleet_survives_many_disturbances(seed: int, kinds: list[str]) -> None:
    levels = disturbed(seed, 5, kinds)
    assert levels.follow(levels.complete)["event"] > 60
    assert not levels.second_voices
