"""What hinders the simulated autopilot from arming, and what brings it down, as observed on ArduPilot 4.7."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.sim.autopilots.bench import ARM, INTERVAL, MODE, TAKEOFF, Bench


def test_it_lands_five_seconds_after_the_last_heartbeat_of_its_ground_station() -> None:
    bench = Bench()
    bench.fly()
    bench.wait(20.0)
    assert bench.copter.mode == 4  # never heard one
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.wait(4.9)
    assert bench.copter.mode == 4
    bench.wait(0.3)
    assert bench.copter.mode == 9


def test_setpoints_do_not_hold_off_the_ground_station_failsafe() -> None:
    bench = Bench()
    bench.fly()
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    for _ in range(52):
        bench.global_setpoint(0xDF8, 5, 1.0, -2.0, 490.0)
        bench.wait(0.1)
    assert bench.copter.mode == 9


def test_heartbeats_of_another_system_than_the_ground_stations_do_not_count() -> None:
    bench = Bench()
    bench.copter.params["MAV_GCS_SYSID"] = 250.0
    bench.fly()
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))  # of system 255
    bench.wait(10.0)
    assert bench.copter.ground_station is None and bench.copter.mode == 4


def test_without_the_failsafe_nothing_happens() -> None:
    bench = Bench()
    bench.copter.params["FS_GCS_ENABLE"] = 0.0
    bench.fly()
    bench.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    bench.wait(20.0)
    assert bench.copter.mode == 4


def test_a_copter_that_wants_a_remote_control_does_not_arm_without() -> None:
    bench = Bench()
    bench.copter.params["FS_THR_ENABLE"] = 1.0
    bench.wait(3.0)
    assert bench.command(MODE, 1, 4) == 0
    assert bench.command(ARM, 1) == mavlink.MAV_RESULT_FAILED
    assert "PreArm: RC not found" in [m.text for m in bench.of(253)]


def test_a_remote_control_that_is_wanted_in_flight_brings_it_down() -> None:
    bench = Bench()
    bench.fly()
    bench.copter.params["FS_THR_ENABLE"] = 1.0
    bench.wait(0.1)
    assert bench.copter.mode == 9 and "Radio Failsafe" in [m.text for m in bench.of(253)]


def test_the_checks_are_run_on_request() -> None:
    bench = Bench()
    bench.wait(3.0)
    assert bench.command(401) == 0 and not bench.of(253)
    bench.copter.failing_check = "Compass not calibrated"
    assert bench.command(401) == 0
    assert [m.text for m in bench.of(253)] == ["PreArm: Compass not calibrated"]
    bench.copter.failing_check = ""
    bench.command(ARM, 1)
    assert bench.command(401) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def test_what_hinders_arming_is_told_every_thirty_seconds() -> None:
    bench = Bench()
    bench.copter.failing_check = "Compass not calibrated"
    told = [m.text for m in bench.wait(65.0) if m.get_msgId() == 253 and m.text.startswith("PreArm")]
    assert told == ["PreArm: Compass not calibrated"] * 3


@pytest.mark.parametrize("reposition", [0.0, 1.0])
def test_land_disarms_only_where_no_pilot_is_waited_for(reposition: float) -> None:
    bench = Bench()
    bench.copter.params["LAND_REPOSITION"] = reposition
    bench.fly()
    bench.command(MODE, 1, 9)
    bench.wait(60.0)
    assert bench.at[2] == 0.0 and bench.copter.landed
    assert bench.copter.armed == bool(reposition)


def test_land_is_no_mode_to_arm_in() -> None:
    bench = Bench()
    bench.wait(3.0)
    bench.command(MODE, 1, 9)
    assert bench.command(ARM, 1) == mavlink.MAV_RESULT_FAILED
    assert "Arm: LAND mode not armable" in [m.text for m in bench.of(253)]


def test_a_real_boot_takes_42_seconds() -> None:
    bench = Bench(boot="real")
    bench.wait(41.9)
    assert bench.command(MODE, 1, 4) == mavlink.MAV_RESULT_FAILED
    bench.wait(1.5)
    assert bench.command(MODE, 1, 4) == 0 and bench.copter.mode == 4


def test_the_battery_empties_in_the_air() -> None:
    bench = Bench()
    for message in (1, 147):
        assert bench.command(INTERVAL, message, 1_000_000) == 0
    bench.fly()
    bench.wait(1.1)
    status, battery = bench.of(1)[-1], bench.of(147)[-1]
    assert status.battery_remaining == battery.battery_remaining >= 98
    assert 12_000 < status.voltage_battery < 12_600 and battery.current_battery == 1500
    bench.wait(240.0)
    assert bench.of(147)[-1].battery_remaining == pytest.approx(79, abs=2)
    assert bench.of(1)[-1].voltage_battery < status.voltage_battery


def test_sys_status_says_whether_it_would_arm() -> None:
    bench = Bench()
    bench.command(INTERVAL, 1, 200_000)
    bench.wait(0.5)
    assert not bench.of(1)[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    bench.wait(2.0)
    assert bench.of(1)[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK


def test_a_take_off_must_lead_upwards() -> None:
    bench = Bench()
    bench.wait(3.0)
    bench.command(MODE, 1, 4)
    bench.command(ARM, 1)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 0.0) == mavlink.MAV_RESULT_FAILED
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, -1.0) == mavlink.MAV_RESULT_FAILED
