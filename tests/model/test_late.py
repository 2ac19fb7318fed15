"""When a robot asks for what it lacks: at each slot, and seldom if it wakes late, as all others may do then."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from koordgen.runtime.wire import Closing, Need, Round
from tests.model.lab import Fleet, Flight
from tests.model.test_found import rounds_of_all


@pytest.mark.parametrize(
    ("late", "lost", "rounds"),
    [
        (0.01, False, [4, 5, 6, 7, 8]),
        (0.01, True, [4, 5, 6, 7, 8]),
        (0.15, False, [5]),  # what is as late as itself comes by itself
        (0.15, True, [4, 6, 8]),
    ],
)
def test_who_wakes_late_asks_seldom_and_once_in_a_round(late: float, lost: bool, rounds: list[int]) -> None:
    """Robot 0 hears nothing of the others from round 4 on, but for what shows, if something is `lost`, that robot 1 has
    closed round 5; `late` is of a round, a fifth of which is a slot."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    fleet.poll(1, 3.0)
    (said,) = fleet.take(lambda f: f.to == 0 and isinstance(f.message, Round) and f.message.head.pid == 1)[-1:]
    fleet.flights.clear()
    if lost:
        fleet.deliver(Flight(0, replace(said.message, closings=(Closing(1, 0, 5, 5),))))
    asked: list[int] = []
    for tick in range(25):
        fleet.poll(0, 3.0 + tick / 5 + late)
        asked += [4 + tick // 5] * any(isinstance(f.message, Need) for f in fleet.take(lambda f: True))
    assert sorted(set(asked)) == rounds
    assert (len(asked) == len(rounds)) == (late > 0.1)
