"""The fleet's clock: the true offset lies within the bound it holds, and fleet time never runs backward."""

from __future__ import annotations

from random import Random

import pytest

from koordgen.runtime.clock import DRIFT, SLEW, FleetClock, SimulatedClock


def exchange(
    clock: FleetClock, base: SimulatedClock, mine: SimulatedClock, theirs: SimulatedClock, there: float, back: float
) -> None:
    """Out, 10 ms at the reference, and back."""
    sent = mine.now()
    base.time += there
    received = theirs.now()
    base.time += 0.01
    answered = theirs.now()
    base.time += back
    assert clock.take(sent, received, answered, mine.now())


@pytest.mark.parametrize("offset", [-5000.0, 0.0, 1e6])
@pytest.mark.parametrize("ppm", [-100, 0, 100])
@pytest.mark.parametrize("asymmetry", [0.5, 3.0])
def test_the_error_stays_within_the_bound(offset: float, ppm: float, asymmetry: float) -> None:
    random = Random(1)
    base = SimulatedClock()
    theirs, mine = SimulatedClock(base), SimulatedClock(base, offset=offset, rate=1 + ppm * 1e-6)
    clock = FleetClock(reference=False)
    assert not clock.known and clock.bound(mine.now()) == float("inf")
    worst = 0.0
    for i in range(300):
        there = 0.0005 + random.expovariate(1 / 0.004)
        exchange(clock, base, mine, theirs, there, asymmetry * (0.0005 + random.expovariate(1 / 0.004)))
        base.time += 0.2
        if i == 20:
            clock.lock()
        error = abs(clock.read(mine.now()) - theirs.now())
        assert error <= clock.bound(mine.now()) + 1e-9
        worst = max(worst, error if i > 100 else 0.0)
    assert worst < 0.004  # a window of 64 has short round trips, though the mean one is 9 to 18 ms
    assert clock.bound(mine.now()) < 0.006


def test_the_bound_grows_while_nothing_is_heard() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=3.0)
    clock = FleetClock(reference=False)
    exchange(clock, base, mine, base, 0.001, 0.001)
    early = clock.bound(mine.now())
    base.time += 100
    assert clock.bound(mine.now()) - early == pytest.approx(100 * DRIFT)


def test_a_locked_clock_slews_and_is_monotonic() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=-7.0)
    clock = FleetClock(reference=False)
    exchange(clock, base, mine, base, 0.2, 0.0)  # as lopsided as can be: 0.1 s wrong
    assert clock.read(mine.now()) - base.now() == pytest.approx(0.1)
    clock.lock()
    exchange(clock, base, mine, base, 0.001, 0.001)
    last = clock.read(mine.now())
    start = base.now()
    while base.now() < start + 3:
        base.time += 0.01
        fleet = clock.read(mine.now())
        assert 0.01 * (1 - SLEW) - 1e-9 <= fleet - last <= 0.01 * (1 + SLEW) + 1e-9
        last = fleet
    assert abs(last - base.now()) < 1e-6


def test_stamps_of_no_honest_exchange_are_refused() -> None:
    clock = FleetClock(reference=False)
    assert not clock.take(10.0, 5.0, 5.1, 9.0)  # sent in the future
    assert not clock.take(8.0, 5.1, 5.0, 9.0)  # answered before it was received
    assert not clock.take(8.0, 5.0, 7.0, 9.0)  # longer there than away from here
    assert not clock.known
    assert not FleetClock(reference=True).take(8.0, 5.0, 5.1, 9.0)


def test_the_reference_is_its_own_clock() -> None:
    clock = FleetClock(reference=True)
    assert clock.known and clock.read(12.5) == 12.5 and clock.bound(12.5) == 0.0 and clock.local(3.0) == 3.0
