"""One robot's estimate of the fleet's time, exchange by exchange."""

from __future__ import annotations

from math import inf, pi, sin
from random import Random

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from koordgen.runtime.net.fleet_clock import DRIFT, SLEW, WANDER, FleetClock
from koordgen.runtime.values.clock import SimulatedClock


def talk(
    clock: FleetClock, mine: SimulatedClock, base: SimulatedClock, there: float, back: float, peer: int = 0
) -> None:
    """Out to the base's own clock, 10 ms there, and back."""
    sent = mine.now()
    base.time += there
    received = base.now()
    base.time += 0.01
    answered = base.now()
    base.time += back
    assert clock.add(peer, sent, received, answered, mine.now(), 0.0)


def test_the_bound_grows_while_nothing_is_heard() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=3.0)
    clock = FleetClock(1)
    assert not clock.known and clock.bound(mine.now()) == inf
    talk(clock, mine, base, 0.001, 0.003)
    clock.read(mine.now())
    early = clock.bound(mine.now())
    assert 0.002 <= early < 0.002 + 1e-5
    assert clock.read(mine.now()) - base.now() == pytest.approx(-0.001, abs=1e-5)  # half of what the ways differ
    base.time += 100
    assert clock.bound(mine.now()) - early == pytest.approx(100 * DRIFT)


@pytest.mark.parametrize("step", [0.0005, 0.01, 0.05])
def test_a_locked_clock_slews_and_is_monotonic(step: float) -> None:
    """However often it is asked, for the time or for what others are told."""
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=-7.0)
    clock = FleetClock(1)
    talk(clock, mine, base, 0.2, 0.0)  # as lopsided as can be: 0.1 s wrong
    assert clock.read(mine.now()) - base.now() == pytest.approx(0.1, abs=1e-4)
    clock.lock()
    talk(clock, mine, base, 0.001, 0.001)
    last = clock.read(mine.now())
    start = base.now()
    asked = 0
    while base.now() < start + 3:
        base.time += step
        asked += 1
        if asked % 3:
            fleet = clock.read(mine.now())
        else:
            offset = clock.offset(mine.now())
            assert offset is not None
            fleet = mine.now() + offset
        assert step * (1 - SLEW) - 1e-9 <= fleet - last <= step * (1 + SLEW) + 1e-9
        last = fleet
    assert abs(last - base.now()) < 1e-3


def test_a_clock_beyond_the_stated_drift_is_still_followed() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, rate=1 + 400e-6)  # as `ntpd` may slew a clock
    clock = FleetClock(1)
    talk(clock, mine, base, 0.002, 0.002)
    clock.read(mine.now())
    clock.lock()
    for _ in range(1000):
        talk(clock, mine, base, 0.002, 0.002)
        base.time += 0.2
        assert abs(clock.read(mine.now()) - base.now()) < 0.005


def change_rate(clock: SimulatedClock, base: SimulatedClock, rate: float) -> None:
    clock._offset += (clock._rate - rate) * base.now()
    clock._rate = rate


@pytest.mark.parametrize("period", [60, 600, 3000])
def test_the_bound_holds_while_temperature_moves_the_rate(period: float) -> None:
    base, random = SimulatedClock(), Random(1)
    mine = SimulatedClock(base, rate=1 + 50e-6)
    clock = FleetClock(1)
    while base.now() < 3000:
        change_rate(mine, base, 1 + 50e-6 + WANDER / 2 * sin(2 * pi * base.now() / period))
        talk(clock, mine, base, random.expovariate(1e5), random.expovariate(1e5))
        base.time += 5.0
        assert abs(clock.read(mine.now()) - base.now()) <= clock.bound(mine.now())
    assert clock.breaks == 0
    assert clock.bound(mine.now()) < 0.0001


def test_a_rate_that_changes_at_once_is_learned_anew() -> None:
    base, random = SimulatedClock(), Random(1)
    mine = SimulatedClock(base, rate=1 + 90e-6)
    clock = FleetClock(1)
    for rate in (1 + 90e-6, 1 - 60e-6, 1 + 20e-6):
        change_rate(mine, base, rate)
        end = base.now() + 1200
        while base.now() < end:
            talk(clock, mine, base, 0.001 + random.expovariate(2000), 0.001 + random.expovariate(2000))
            base.time += 1.0
            fleet = clock.read(mine.now())
            assert abs(fleet - base.now()) < 0.003
            assert abs(fleet - base.now()) <= clock.bound(mine.now()) or base.now() < end - 600
        assert clock.drift == pytest.approx(1 / rate - 1, abs=5e-6)


@pytest.mark.parametrize("late", [0.0, 0.4e-6, 0.5e-6, 0.9e-6])
def test_rounded_stamps_contradict_nothing(late: float) -> None:
    """On a path without any delay they are all that there is of an error."""
    clock = FleetClock(1)
    for i in range(1000):
        now = 100.0 + 0.01 * i + 0.37e-6 * i
        sent, received, answered, back = [round(t, 6) for t in (now, now + late, now + late + 1e-3, now + 1e-3)]
        assert clock.add(0, sent, received, answered, back, 0.0)
        assert abs(clock.read(now) - now - late) <= clock.bound(now) < 1e-5
    assert clock.breaks == 0


def test_the_new_reference_goes_on_from_its_estimate_of_this_moment() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=3.0, rate=1 + 50e-6)
    clock = FleetClock(1)
    talk(clock, mine, base, 0.001, 0.001)
    clock.follow(1, mine.now())
    assert clock.read(mine.now()) == pytest.approx(base.now(), abs=1e-5) and clock.bound(mine.now()) == 0.0
    talk(clock, mine, base, 0.001, 0.001)
    base.time += 1000
    assert clock.read(mine.now()) == pytest.approx(base.now() + 0.05, abs=1e-4)  # at its own rate


def test_exchanges_with_others_than_the_reference_move_nothing() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base, offset=3.0)
    clock = FleetClock(1)
    talk(clock, mine, base, 0.001, 0.001, peer=2)
    known = clock.known
    assert not known and clock.read(mine.now()) == mine.now()
    clock.follow(2, mine.now())  # but count when it becomes the reference
    assert clock.known and abs(clock.read(mine.now()) - base.now()) < 1e-5


def test_a_reference_may_have_slewed_before_it_was_one() -> None:
    """What it said before counts for as much as it may have moved since."""
    base = SimulatedClock()
    mine = SimulatedClock(base)
    clock = FleetClock(1)
    talk(clock, mine, base, 0.001, 0.001, peer=0)
    talk(clock, mine, base, 0.001, 0.001, peer=2)
    base.time += 1.0
    clock.follow(2, mine.now())
    assert 0.001 + SLEW <= clock.bound(mine.now()) < 0.003 + SLEW
    talk(clock, mine, base, 0.001, 0.001, peer=2)
    assert clock.bound(mine.now()) < 0.002


def test_an_overtaken_word_of_the_reference_does_not_count() -> None:
    clock = FleetClock(1)
    assert clock.add(0, 10.0, 10.001, 10.001, 10.002, 0.05)
    assert clock.add(0, 9.0, 9.001, 9.001, 10.003, 0.0)  # answered a second earlier, and late
    assert clock.read(10.003) == pytest.approx(10.053, abs=1e-4)


def test_stamps_of_no_honest_exchange_are_refused() -> None:
    clock = FleetClock(1)
    assert not clock.add(0, 10.0, 5.0, 5.1, 9.0, 0.0)  # sent in the future
    assert not clock.add(0, 8.0, 5.1, 5.0, 9.0, 0.0)  # answered before it was received
    assert not clock.add(0, 8.0, 5.0, 7.0, 9.0, 0.0)  # longer there than away from here
    assert not clock.add(0, 8.0, 5.0, float("nan"), 9.0, 0.0)
    assert not clock.add(1, 8.0, 5.0, 5.1, 9.0, 0.0)  # with itself
    assert not clock.known


def test_one_odd_exchange_moves_nothing_and_two_make_a_break() -> None:
    base = SimulatedClock()
    mine = SimulatedClock(base)
    clock = FleetClock(1)
    talk(clock, mine, base, 0.001, 0.001)
    clock.read(mine.now())
    clock.lock()

    def odd(fleet: float = 0.0, ahead: float = 0.0) -> float:
        base.time += 0.1
        now = mine.now()
        clock.add(0, now - 0.002, now + ahead - 0.001, now + ahead - 0.001, now, fleet)
        return clock.read(now) - now

    assert odd(ahead=2.0**33) == pytest.approx(0, abs=1e-4)
    assert odd(fleet=7.0) == pytest.approx(0, abs=1e-4)  # disagrees with the last odd one, too
    assert odd(ahead=5.0) == pytest.approx(0, abs=1e-4)
    assert odd() == pytest.approx(0, abs=1e-4)
    assert odd(ahead=5.0) == pytest.approx(0, abs=1e-4)  # the honest one between made it the first again
    assert clock.breaks == 0
    assert odd(ahead=5.0) == pytest.approx(5, abs=1e-3)
    assert clock.breaks == 1
    assert odd(fleet=7.0, ahead=5.0) + odd(fleet=7.0, ahead=5.0) == pytest.approx(5 + 12, abs=1e-3)
    assert clock.breaks == 2


TOP = 2**53 / 1e6
_stamp = st.integers(0, 2**53).map(lambda us: us / 1e6) | st.sampled_from([0.0, 1.0, TOP]) | st.floats(0, 100)
_fleet = st.none() | st.integers(-(2**53), 2**53).map(lambda us: us / 1e6) | st.floats(-1, 1)


@given(
    st.lists(
        st.tuples(st.integers(0, 2), _stamp, _stamp, _stamp, st.floats(0, 50), _fleet, st.none() | st.integers(0, 2)),
        max_size=40,
    )
)
@hypothesis_settings(max_examples=300, deadline=None)
def test_hostile_stamps_never_raise_nor_move_a_locked_clock_back(
    exchanges: list[tuple[int, float, float, float, float, float | None, int | None]],
) -> None:
    now = 10.0
    clock = FleetClock(1)
    assert clock.add(0, now - 0.002, now, now, now, 0.0)
    last = clock.read(now)
    clock.lock()
    for peer, sent, received, answered, elapsed, fleet, reference in exchanges:
        now += elapsed
        clock.add(peer, sent, received, answered, now, fleet)
        clock.add(peer, max(0.0, now - sent), received, received, now, fleet)  # an honest trip of a mad clock
        if reference is not None:
            clock.follow(reference, now)
        assert clock.bound(now) >= 0.0
        assert abs(clock.drift) <= 500e-6
        assert clock.read(now) >= last
        last = clock.read(now)
        offset = clock.offset(now)
        assert offset is not None and clock.local(last) == pytest.approx(now, abs=1e-4)


def test_the_reference_is_its_own_clock() -> None:
    clock = FleetClock(0)
    assert clock.known and clock.read(12.5) == 12.5 and clock.bound(12.5) == 0.0 and clock.local(3.0) == 3.0
    assert clock.offset(12.5) == 0.0 and clock.drift == 0.0
