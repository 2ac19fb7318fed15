"""The simulated autopilot behaves as was observed on ArduPilot 4.7, message by message."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import ORIGIN
from tests.sim.autopilots.bench import ARM, FRAME, INTERVAL, MODE, TAKEOFF, Bench


def test_nothing_streams_until_asked_but_the_heartbeat() -> None:
    bench = Bench()
    assert {m.get_msgId() for m in bench.wait(5.0)} == {0, mavlink.MAVLINK_MSG_ID_STATUSTEXT}
    assert 4 <= len(bench.of(0)) <= 6
    assert bench.command(INTERVAL, 33, 50_000) == 0
    bench.wait(2.0)
    assert 39 <= len(bench.of(33)) <= 41
    assert bench.command(INTERVAL, 33, -1) == 0
    assert not [m for m in bench.wait(2.0) if m.get_msgId() == 33]
    assert bench.command(INTERVAL, 12345, 50_000) == mavlink.MAV_RESULT_FAILED


def test_booting() -> None:
    bench = Bench(boot=3.0)
    bench.command(INTERVAL, 33, 100_000)
    bench.wait(1.0)
    assert all(m.lat == m.lon == 0 for m in bench.of(33))
    assert bench.command(MODE, 1, 4) == mavlink.MAV_RESULT_FAILED
    assert bench.command(ARM, 1) == mavlink.MAV_RESULT_FAILED
    assert [m.text for m in bench.of(253)] == ["PreArm: Need Position Estimate"]
    bench.wait(2.5)
    assert bench.of(33)[-1].lat == pytest.approx(ORIGIN[0] * 1e7, abs=1000)
    assert bench.command(MODE, 1, 4) == 0 and bench.copter.mode == 0  # acknowledged, and lost
    bench.wait(1.0)
    assert bench.command(MODE, 1, 4) == 0 and bench.copter.mode == 4


def test_it_disarms_ten_seconds_after_an_arming_without_take_off() -> None:
    bench = Bench()
    bench.wait(3.0)
    bench.command(MODE, 1, 4)
    assert bench.command(ARM, 1) == 0
    bench.wait(9.8)
    assert bench.copter.armed
    bench.wait(0.4)
    assert not bench.copter.armed


def test_only_a_take_off_leaves_the_ground() -> None:
    bench = Bench()
    bench.wait(3.0)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == mavlink.MAV_RESULT_FAILED
    bench.command(MODE, 1, 4)
    bench.command(ARM, 1)
    bench.global_setpoint(0xDF8, 5, 2.0, 2.0, 490.0)
    bench.wait(3.0)
    assert bench.at == (1.0, -2.0, 0.0)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == 0
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == mavlink.MAV_RESULT_FAILED


@pytest.mark.parametrize(("frame", "altitude"), [(5, 491.0), (0, 491.0), (6, 3.0), (3, 3.0)])
def test_global_positions_are_held_for_ever(frame: int, altitude: float) -> None:
    bench = Bench()
    bench.fly()
    bench.global_setpoint(0xDF8, frame, 3.0, 1.0, altitude)
    bench.wait(60.0)
    assert math.dist(bench.at, (3.0, 1.0, 3.0)) < 0.02


def test_local_positions_are_about_the_vehicles_own_origin() -> None:
    bench = Bench()
    bench.fly()
    bench.local_setpoint(0xDF8, 1, 1.0, 2.0, -2.0)  # north 1, east 2 of where it booted: (1, -2)
    bench.wait(20.0)
    assert math.dist(bench.at, (3.0, -1.0, 2.0)) < 0.02
    bench.local_setpoint(0xDF8, 7, 0.0, 1.0, 0.0)  # and 1 m further east
    bench.wait(20.0)
    assert math.dist(bench.at, (4.0, -1.0, 2.0)) < 0.02


def test_a_velocity_is_kept_for_three_seconds() -> None:
    bench = Bench()
    bench.fly()
    bench.heartbeats(2.9, 0.0, 1.0, 0.0)
    assert bench.rig.body.velocity[0] == pytest.approx(1.0, abs=0.05)
    bench.wait(4.0)
    assert abs(bench.rig.body.velocity[0]) < 0.02
    assert 3.0 < bench.at[0] < 5.0


def test_position_and_velocity_run_on_for_three_seconds() -> None:
    bench = Bench()
    bench.fly()
    bench.local_setpoint(0xDC0, 1, 0.0, 0.0, -2.0, 0.0, 1.0, 0.0)
    bench.wait(15.0)
    assert math.dist(bench.at, (1.0 + 3.0, -2.0, 2.0)) < 0.05


@pytest.mark.parametrize("mask", [0xDF9, 0xDDF, 0xE00 | 0x1F8, 0xC3F, 0xFFF])
def test_half_a_group_stops_the_vehicle(mask: int) -> None:
    bench = Bench()
    bench.fly()
    bench.heartbeats(1.0, 0.0, 1.0, 0.0)
    bench.local_setpoint(mask, 1, 5.0, 5.0, -2.0)
    bench.wait(6.0)
    assert math.hypot(*bench.rig.body.velocity) < 0.02 and bench.at[0] < 3.0


@pytest.mark.parametrize("frame", [2, 4, 11, 99])
def test_an_invalid_frame_stops_the_vehicle(frame: int) -> None:
    bench = Bench()
    bench.fly()
    bench.heartbeats(1.0, 0.0, 1.0, 0.0)
    bench.global_setpoint(0xDF8, frame, 5.0, 4.0, 490.0)
    bench.wait(6.0)
    assert math.hypot(*bench.rig.body.velocity) < 0.02 and bench.at[0] < 3.0


def test_a_position_that_is_no_number_kills_it() -> None:
    bench = Bench()
    bench.fly()
    bench.global_setpoint(0xDF8, 5, 3.0, 1.0, math.nan)
    bench.wait(2.0)
    assert not bench.heard and bench.at[2] == 0.0


def test_the_target_is_told_back() -> None:
    bench = Bench()
    bench.fly()
    bench.command(INTERVAL, 87, 200_000)
    bench.command(INTERVAL, 85, 200_000)
    assert not [m for m in bench.wait(1.0) if m.get_msgId() == 87]  # still in its take-off
    bench.global_setpoint(0xDF8, 6, 3.0, 1.0, 2.5)
    bench.wait(1.0)
    told, local = bench.of(87)[-1], bench.of(85)[-1]
    assert told.coordinate_frame == 0
    assert FRAME.enu(told.lat_int * 1e-7, told.lon_int * 1e-7, told.alt) == pytest.approx((3.0, 1.0, 2.5), abs=0.02)
    assert (local.x, local.y, local.z) == pytest.approx((3.0, 2.0, -2.5), abs=0.02)


def test_the_target_of_a_position_and_velocity_is_told_locally_only() -> None:
    bench = Bench()
    bench.fly()
    bench.command(INTERVAL, 87, 200_000)
    bench.command(INTERVAL, 85, 200_000)
    bench.local_setpoint(0xDC0, 1, 1.0, 0.0, -2.0, 0.0, 0.5, 0.0)
    bench.wait(0.5)
    bench.wait(0.3)
    told = bench.of(85)[-1]
    assert (told.x, told.z, told.vy) == pytest.approx((1.0, -2.0, 0.5), abs=0.01) and 0.2 < told.y < 0.5
    assert told.type_mask & 0x3F == 0 and not bench.of(87)
    bench.local_setpoint(0xDC7, 1, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    bench.wait(0.5)
    assert bench.of(85)[-1].type_mask & 0x3F == 7 and not bench.of(87)


def test_the_speed_is_limited_as_asked() -> None:
    bench = Bench()
    bench.fly()
    bench.global_setpoint(0xDF8, 5, -5.0, -2.0, 490.0)
    bench.wait(0.1)
    assert bench.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5, -1) == 0
    bench.wait(5.0)
    assert bench.rig.body.velocity[0] == pytest.approx(-0.5, abs=0.02)


def test_another_kind_of_setpoint_forgets_the_speed() -> None:
    bench = Bench()
    bench.fly()
    assert bench.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.5, -1) == 0
    bench.global_setpoint(0xDF8, 5, -5.0, -2.0, 490.0)
    bench.wait(3.0)
    assert bench.rig.body.velocity[0] < -1.0


def test_it_lands_and_disarms() -> None:
    bench = Bench()
    bench.fly()
    assert bench.command(MODE, 1, 9) == 0
    bench.wait(10.0)
    assert not bench.copter.armed and bench.at[2] == 0.0
    assert "Disarming motors" in [m.text for m in bench.of(253)]


def test_it_does_not_disarm_in_flight() -> None:
    bench = Bench()
    bench.fly()
    assert bench.command(ARM, 0) == mavlink.MAV_RESULT_FAILED and bench.copter.armed


def test_home_and_origin_are_its_own() -> None:
    bench = Bench()
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 49) == mavlink.MAV_RESULT_FAILED
    bench.wait(2.0)
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 49) == 0
    origin = bench.of(49)[0]
    assert FRAME.enu(origin.latitude * 1e-7, origin.longitude * 1e-7, origin.altitude * 1e-3) == pytest.approx(
        (1.0, -2.0, 0.0), abs=0.02
    )
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242) == 0


def test_garbage_never_raises() -> None:
    bench = Bench()
    bench.fly()
    dice = random.Random(1)
    for _ in range(300):
        bench.rig.wire.send(dice.randbytes(dice.randrange(1, 300)))
        bench.rig.wire.send(b"\xfd" + dice.randbytes(dice.randrange(1, 300)))
        bench.wait(1 / 240)
    assert bench.rig.autopilot is not None and bench.rig.autopilot.dropped > 300
    assert bench.copter.mode == 4


def test_hostile_numbers_never_raise() -> None:
    """Every command and setpoint with every kind of number that a float field can carry."""
    bench = Bench()
    bench.fly()
    for value in (math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-40):
        for command in (INTERVAL, MODE, TAKEOFF, 178, 512, 400, 31000):
            bench.command(command, value, value, value, value, value, value, value)
        bench.local_setpoint(0xDC7, 1, 0, 0, 0, value, value, value)
        bench.wait(0.1)
    assert bench.copter.armed


def test_the_estimate_wanders_as_told() -> None:
    bench = Bench(noise=0.05)
    bench.command(INTERVAL, 33, 100_000)
    bench.wait(2.0)
    bench.wait(200.0)
    east = [FRAME.enu(m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)[0] - 1.0 for m in bench.of(33)]
    deviation = math.sqrt(sum(e * e for e in east) / len(east))
    assert 0.03 < deviation < 0.07
    assert max(abs(b - a) for a, b in pairwise(east)) < 0.1  # it wanders, it does not jump


def reposition(bench: Bench, frame: int, altitude: float, flags: float = 1.0) -> int:
    latitude, longitude, _ = FRAME.geodetic(3.0, 1.0, 0.0)
    bench.send(
        mavlink.MAVLink_command_int_message(
            1, 1, frame, 192, 0, 0, -1, flags, 0, 0, round(latitude * 1e7), round(longitude * 1e7), altitude
        )
    )
    return int(next(m for m in bench.wait(0.02) if m.get_msgId() == 77).result)


@pytest.mark.parametrize(("frame", "altitude"), [(0, 490.5), (6, 2.5)])
def test_reposition_goes_there_and_stays(frame: int, altitude: float) -> None:
    bench = Bench()
    bench.fly()
    assert reposition(bench, frame, altitude) == 0
    bench.wait(15.0)
    assert math.dist(bench.at, (3.0, 1.0, 2.5)) < 0.05


def test_reposition_on_the_ground_or_to_nowhere_fails() -> None:
    bench = Bench()
    bench.wait(3.0)
    assert reposition(bench, 0, 490.0, flags=0.0) == mavlink.MAV_RESULT_DENIED
    assert reposition(bench, 0, 490.0) == mavlink.MAV_RESULT_FAILED
    for frame, altitude, flags in ((1, 490.0, 1.0), (0, math.nan, 1.0), (0, 490.0, math.inf)):
        assert reposition(bench, frame, altitude, flags) == mavlink.MAV_RESULT_DENIED
    bench.wait(1.0)
    assert bench.at == (1.0, -2.0, 0.0)
