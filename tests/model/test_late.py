"""When a robot asks for what it lacks: at each slot, and seldom if it wakes late, as all others may do then."""

from __future__ import annotations

import pytest

from koordgen.runtime.wire import Need
from tests.model.lab import Fleet
from tests.model.test_found import rounds_of_all


@pytest.mark.parametrize(("late", "rounds"), [(0.01, [4, 5, 6, 7, 8]), (0.15, [4, 6, 8])])
def test_who_wakes_late_asks_in_every_other_round_and_once_in_it(late: float, rounds: list[int]) -> None:
    """Robot 0 hears nothing of the others from round 4 on; `late` is of a round, a fifth of which is a slot."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    fleet.flights.clear()
    asked: list[int] = []
    for tick in range(25):
        fleet.poll(0, 3.0 + tick / 5 + late)
        asked += [4 + tick // 5] * any(isinstance(f.message, Need) for f in fleet.take(lambda f: True))
    assert sorted(set(asked)) == rounds
    assert (len(asked) == len(rounds)) == (late > 0.1)
