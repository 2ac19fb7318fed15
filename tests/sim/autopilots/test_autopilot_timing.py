"""Times and distances of a simulated autopilot: figures of a real ArduCopter, each with a bound."""

from __future__ import annotations

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, at, commands
from targets.sim.autopilots.mavlink_estimate import IMUS_SETTLE
from tests.sim.autopilots.bench import ARM, MODE, TAKEOFF, Bench

REAL = {"spool_up": 3.3}
OFF = 0.02  # metres above the ground: it has left it


def lifted(bench: Bench, height: float = 2.0) -> tuple[float, float]:
    """Take off: the seconds from the command until it leaves the ground, and the fastest climb (m/s)."""
    bench.wait(3.0)
    assert bench.command(MODE, 1, 4) == 0 and bench.command(ARM, 1) == 0
    began = bench.rig.now
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height) == 0
    left, fastest = math.inf, 0.0
    while bench.rig.now < began + 9.0:
        bench.wait(0.05)
        left = min(left, bench.rig.now - began) if bench.at[2] > OFF else left
        fastest = max(fastest, bench.rig.body.state().velocity[2])
    assert bench.at[2] == pytest.approx(height, abs=0.05)
    return left, fastest


def test_it_leaves_the_ground_3_3_s_after_the_command_and_climbs_at_1_2_m_s() -> None:
    left, fastest = lifted(Bench(harness=REAL))
    assert left == pytest.approx(3.3, abs=0.3) and fastest == pytest.approx(1.22, rel=0.1)


def test_it_is_on_the_ground_and_drops_setpoints_until_its_motors_have_spun_up() -> None:
    bench = Bench(harness=REAL)
    bench.wait(3.0)
    bench.command(MODE, 1, 4)
    bench.command(ARM, 1)
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0)
    bench.wait(2.0)
    bench.global_setpoint(0xDF8, 5, 4.0, 1.0, 491.0)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == 0  # asked again, which begins nothing anew
    bench.wait(0.8)
    assert bench.copter.landed and bench.copter.armed and bench.at == (1.0, -2.0, 0.0)
    bench.wait(5.0)
    assert math.dist(bench.at, (1.0, -2.0, 2.0)) < 0.1


@pytest.mark.parametrize("what", ["mode", "disarming"])
def test_a_take_off_ends_with_its_mode_and_its_arming(what: str) -> None:
    bench = Bench(harness=REAL)
    bench.wait(3.0)
    bench.command(MODE, 1, 4)
    bench.command(ARM, 1)
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0)
    bench.wait(1.0)
    if what == "mode":
        assert bench.command(MODE, 1, 5) == 0 and bench.command(MODE, 1, 4) == 0
    else:
        assert bench.command(ARM, 0) == 0 and bench.command(ARM, 1) == 0
    bench.wait(5.0)
    assert bench.copter.landed and bench.at[2] == 0.0


def test_an_agent_waits_for_the_motors() -> None:
    rig = Rig(harness=REAL)
    rig.fly()
    assert len(commands(rig, ARM)) == 1 and len(commands(rig, TAKEOFF)) <= 2
    assert at(rig).z == pytest.approx(1.5, abs=0.35)


def test_a_failsafe_descends_four_seconds_after_land() -> None:
    bench = Bench()
    bench.fly()
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.wait(5.1)
    assert bench.copter.mode == 9
    bench.wait(3.7)
    assert bench.at[2] == pytest.approx(2.0, abs=0.05) and bench.copter.armed
    bench.wait(1.3)
    assert bench.at[2] < 1.9
    bench.wait(8.0)
    assert bench.at[2] == 0.0 and not bench.copter.armed


def test_land_by_command_descends_at_once() -> None:
    bench = Bench()
    bench.fly()
    assert bench.command(MODE, 1, 9) == 0
    bench.wait(1.3)
    assert bench.at[2] < 1.9


def test_its_own_gps_is_given_up_after_7_9_s() -> None:
    bench = Bench()
    bench.fly()
    bench.rig.fault_state.positioning = type(bench.rig.fault_state.positioning)(dropout=1.0)
    lost = bench.rig.now
    while bench.copter.mode != 9 and bench.rig.now < lost + 10.0:
        bench.wait(0.05)
    assert bench.rig.now - lost == pytest.approx(7.9, abs=0.3)


@pytest.mark.parametrize("boot", [4.0, "real"])
def test_imus_refuse_an_arming_for_a_while_after_there_is_a_position(boot: float | str) -> None:
    waits: list[float] = []
    for _ in range(4 if boot == 4.0 else 1):
        bench = Bench(boot=boot, seed=len(waits))
        seconds = 42.0 if boot == "real" else 4.0
        bench.wait(seconds + 1.05)
        assert bench.command(MODE, 1, 4) == 0
        while bench.command(ARM, 1) != 0:
            assert [m.text for m in bench.of(253)] == ["PreArm: Accels inconsistent"]
            bench.wait(0.05)
        waits.append(bench.rig.now - 1000.0 - seconds)
        assert waits[-1] <= IMUS_SETTLE * seconds + 1.2
    assert round(IMUS_SETTLE * 42.0, 9) == 25.0
    assert boot == "real" or max(waits) > 1.5


def test_a_quad_that_is_to_hold_runs_on_by_0_7_m() -> None:
    """At 1 m/s; a real one ran 0.7 m past where it was told, and 0.43 m back."""
    rig = Rig(max_speed=1.0, position=(-4.0, -2.0, 0.0))
    rig.fly()
    rig.go(5.0, -2.0)
    assert rig.run(10.0, lambda: at(rig).x > 0.0)
    began = at(rig).x
    way: list[float] = []
    rig.quad.hold(True, rig.now)
    rig.watch = lambda: way.append(at(rig).x)
    rig.run(2.0)
    assert 0.4 < max(way) - began < 0.75
    assert max(way) - way[-1] < 0.43


def test_a_quad_whose_own_agent_was_frozen_goes_on_from_where_it_has_come_to() -> None:
    """It runs on with its last velocity, and does not fly back to where its reference waited."""
    rig = Rig(max_speed=1.0, position=(-5.0, -2.0, 0.0))
    rig.fly()
    rig.go(5.5, -2.0)
    assert rig.run(15.0, lambda: at(rig).x > -1.5)
    began = at(rig).x
    rig.pass_time(2.0)
    assert 1.8 < at(rig).x - began < 2.1
    way: list[float] = []
    rig.watch = lambda: way.append(at(rig).x)
    rig.run(6.0)
    assert all(b > a - 0.03 for a, b in itertools.pairwise(way)) and way[-1] - began > 4.0


def test_a_leg_at_1_m_s_is_flown_faster_by_a_tenth_where_setpoints_lead() -> None:
    """As ours did: velocities by 0.6 s, positions by 0.05 s. A real one flew 1.09 to 1.12 m/s then."""

    def speed(t: float) -> float:
        return max(0.0, min(1.0, t, 9.0 - t))

    bench = Bench(position=(-4.0, -2.0, 0.0))
    bench.fly()
    way, fastest = 0.0, 0.0
    for tick in range(200):
        t = tick * 0.05
        lead = min(1.0, speed(t + 0.05) + 0.6 * (speed(t + 0.4) - speed(t + 0.05)) / 0.35)
        bench.local_setpoint(0xDC0, 1, 0.0, way + 0.05 * speed(t), -2.0, 0.0, lead, 0.0)
        bench.wait(0.05)
        way += speed(t) * 0.05
        fastest = max(fastest, bench.rig.body.state().velocity[0])
    assert 1.05 < fastest < 1.15


def test_climb_and_descent_are_limited_as_asked() -> None:
    bench = Bench()
    bench.copter.params["WP_SPD_UP"] = 0.5
    _, fastest = lifted(bench)
    assert fastest == pytest.approx(0.5, abs=0.07)
    bench.global_setpoint(0xDF8, 5, 1.0, -2.0, 493.0)
    bench.wait(0.1)
    assert bench.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 2, 0.8, -1) == 0
    bench.wait(2.0)
    assert bench.rig.body.state().velocity[2] == pytest.approx(0.8, abs=0.05)
    bench.wait(4.0)
    assert bench.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 3, 0.4, -1) == 0
    bench.global_setpoint(0xDF8, 5, 1.0, -2.0, 489.0)
    bench.wait(2.5)
    assert bench.rig.body.state().velocity[2] == pytest.approx(-0.4, abs=0.05)
