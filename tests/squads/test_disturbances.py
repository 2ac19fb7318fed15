"""Inner robots killed, cut off or frozen at random moments, at 20 % loss: no outer event is lost, none counts twice.

No former host sends anything once its successor has sent."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from tests.squads.disturbances import KILLS, OTHERS, disturbed
from tests.squads.test_hosts import COUNT


@pytest.mark.parametrize(("seed", "kinds"), [(1, KILLS), (5, OTHERS)], ids=["kills", "others"])
def test_no_outer_event_is_lost_and_none_counts_twice(seed: int, kinds: Sequence[str]) -> None:
    levels = disturbed(seed, 3, kinds, COUNT)
    assert levels.follow(levels.complete)["event"] > 20
    assert not levels.sent_by_former_hosts


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [KILLS, KILLS + OTHERS], ids=["kills", "all"])
@pytest.mark.parametrize("seed", range(10, 22))
def test_the_outer_fleet_survives_many_disturbances(seed: int, kinds: Sequence[str]) -> None:
    levels = disturbed(seed, 5, kinds, COUNT)
    assert levels.follow(levels.complete)["event"] > 60
    assert not levels.sent_by_former_hosts
