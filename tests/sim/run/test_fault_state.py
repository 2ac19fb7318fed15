"""Devices of a robot that is upset: positions, batteries, motors."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random

import pytest

from koordgen.runtime.vehicle.feed import Feed
from targets.car.base.settings import CarSettings
from targets.car.drive import vesc
from targets.sim.autopilots.drive import Controller
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.degraded_actuators import DegradedActuators
from targets.sim.base.fault_state import FaultState, PositioningFault
from targets.sim.sensing.own_gps import OwnGps
from targets.sim.sensing.station import BaseStation
from tests.sim.autopilots.bench import Bench
from tests.sim.sensing.test_station import KEY, Moving, context, run

STEP = 1 / 240


def told(wrong: PositioningFault, seconds: float = 10.0) -> list[tuple[float, Vector]]:
    """What a base station tells of a body at (t, 2, 1.5): when, and how far off the truth of then."""
    body, feed = Moving(), Feed("bert", KEY)
    found = []
    station = BaseStation(body, replace(context(), fault_state=FaultState(wrong)))
    for now, datagram in run(seconds, body, station):
        assert feed.receive(datagram, now) and feed.pose is not None
        p = feed.pose.position
        found.append((now, (p.x - now, p.y - 2.0, p.z - 1.5)))
    return found


def test_a_feed_is_biased_and_noisy() -> None:
    errors = [error for _, error in told(PositioningFault(noise=0.05, bias=(0.5, 0.0, -0.2)), 40.0)]
    mean = [sum(e[k] for e in errors) / len(errors) for k in range(3)]
    assert mean == pytest.approx([0.5, 0.0, -0.2], abs=0.01)
    assert math.sqrt(sum(e[1] ** 2 for e in errors) / len(errors)) == pytest.approx(0.05, rel=0.1)


def test_a_feed_is_late() -> None:
    errors = told(PositioningFault(delay=0.3))
    assert errors[0][0] >= 0.3
    assert all(error[0] == pytest.approx(-0.3, abs=0.03) for _, error in errors)


def test_a_feed_drops_out() -> None:
    assert told(PositioningFault(dropout=1.0)) == []
    assert 150 < len(told(PositioningFault(dropout=0.6))) < 250


def test_what_is_known_late_is_how_it_was() -> None:
    fault_state = FaultState()
    assert fault_state.late(0.0, "a") == "a"
    fault_state.positioning = PositioningFault(delay=0.25)
    known = [fault_state.late(k / 10, k) for k in range(1, 9)]
    assert known == [1, 1, 1, 1, 2, 3, 4, 5]
    fault_state.positioning = PositioningFault()
    assert fault_state.late(1.0, 9) == 9


def gps_error(
    fault_state: FaultState, seconds: float, gps: OwnGps | None = None, begin: float = 0.0
) -> tuple[OwnGps, Vector]:
    gps = gps or OwnGps(0.0, fault_state, Random(1))
    error: Vector = (0.0, 0.0, 0.0)
    for k in range(round(seconds / STEP)):
        now = begin + k * STEP
        truth = BodyState((now, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, 0.0)
        error = gps.error(truth, now, STEP, (0.04, 0.0, 0.0))
    return gps, error


def test_an_own_gps_that_is_well_errs_by_its_noise_only() -> None:
    assert gps_error(FaultState(), 5.0)[1] == (0.0, 0.0, 0.0)


def test_the_estimate_is_drawn_to_wrong_fixes_and_back() -> None:
    fault_state = FaultState(PositioningFault(bias=(0.0, 1.0, 0.0)))
    gps, error = gps_error(fault_state, 0.5)
    assert 0.2 < error[1] < 0.6
    gps, error = gps_error(fault_state, 6.0, gps, 0.5)
    assert error[1] == pytest.approx(1.0, abs=0.01)
    fault_state.positioning = PositioningFault()
    assert gps_error(fault_state, 6.0, gps, 6.5)[1][1] == pytest.approx(0.0, abs=0.01)


def test_late_fixes_lag_behind() -> None:
    assert gps_error(FaultState(PositioningFault(delay=0.4)), 8.0)[1][0] == pytest.approx(-0.4, abs=0.02)


def test_without_fixes_it_drifts() -> None:
    fault_state = FaultState()
    gps, _ = gps_error(fault_state, 1.0)
    fault_state.positioning = PositioningFault(dropout=1.0)
    gps, error = gps_error(fault_state, 5.0, gps, 1.0)
    assert error[0] == pytest.approx(0.04 / 2 * 5.0**2, rel=0.15)
    assert gps.fixed == pytest.approx(1.0, abs=0.3)


def test_a_copter_without_fixes_lands() -> None:
    bench = Bench()
    bench.fly()
    bench.rig.fault_state.positioning = PositioningFault(dropout=1.0)
    bench.wait(5.0)
    ready = [bench.copter.estimator.ready]
    bench.wait(4.0)
    assert [*ready, bench.copter.estimator.ready] == [True, False]
    assert bench.copter.landing


def test_a_copter_with_an_empty_battery_says_so_and_lands() -> None:
    bench = Bench()
    bench.fly()
    bench.rig.fault_state.battery = 0.05
    bench.wait(2.0)
    assert bench.rig.autopilot is not None and not bench.copter.landing
    assert bench.rig.autopilot._reports.battery == 0.05
    bench.wait(10.0)
    assert bench.copter.landing


class Wheels:
    """A car's body that remembers what was asked of it."""

    wheelbase = 0.33

    def __init__(self) -> None:
        self.asked = (0.0, 0.0)
        self.braking = 0.0

    def state(self) -> BodyState:
        return BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)

    def drive(self, speed: float, steering: float) -> None:
        self.asked, self.braking = (speed, steering), 0.0

    def brake(self, deceleration: float) -> None:
        self.braking = deceleration


@pytest.mark.parametrize(("level", "volts", "fault"), [(1.0, 11.1, 0), (0.5, 10.05, 0), (0.0, 9.0, 2)])
def test_a_vesc_tells_its_supply_and_gives_up_when_it_is_empty(level: float, volts: float, fault: int) -> None:
    body, decoder = Wheels(), vesc.Decoder()
    controller = Controller(body, CarSettings(), FaultState(battery=level))
    answer = controller.step(vesc.encode(vesc.SetErpm(4614)) + vesc.encode(vesc.AskValues()), 1.0)
    (values,) = decoder.feed(answer)
    assert isinstance(values, vesc.Values)
    assert values.voltage == pytest.approx(volts, abs=0.06) and values.fault == fault
    assert (body.braking > 0.0) == bool(fault)


def test_slowed_motors_follow_with_a_lag() -> None:
    body, fault_state, now = Wheels(), FaultState(lag=0.5), [0.0]
    slowed = DegradedActuators(body, fault_state, lambda: now[0])
    assert slowed.wheelbase == 0.33
    slowed.drive(0.0, 0.0)
    for k in range(1, 121):
        now[0] = k * STEP
        slowed.drive(1.0, 0.2)
    assert body.asked == pytest.approx((1 - math.exp(-1), 0.2 * (1 - math.exp(-1))))
    fault_state.lag = 0.0
    slowed.drive(1.0, 0.2)
    assert body.asked == (1.0, 0.2)
