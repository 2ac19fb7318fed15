"""Random disturbances of the robots of squads: killed, cut off or frozen, at 20 % loss."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

from tests.squads.levels import LOSSY, Levels

KILLS = ("kill",)
OTHERS = ("cut from its squad", "cut from all", "freeze")


def disturbed(seed: int, times: int, kinds: Sequence[str], text: str) -> Levels:
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
