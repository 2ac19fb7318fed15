"""The stand-in for PX4: OFFBOARD and its stream of setpoints, AUTO's modes, arming, parameters; and the agent on it."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, at
from koordgen.runtime.values.points import Point, distance
from targets.sim.autopilots.mavlink_px4 import HOLD, LAND, OFFBOARD, TAKEOFF
from tests.sim.autopilots.bench import ARM, INTERVAL, MODE, Bench
from tests.sim.autopilots.bench import TAKEOFF as TAKE_OFF

REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
PX4 = {"firmware": "px4"}


class Px4Bench(Bench):
    def __init__(self) -> None:
        super().__init__(harness=PX4)
        self.wait(1.5)

    def mode(self, main: int, sub: int = 0) -> int:
        return self.command(MODE, 1, main, sub)

    def stream(self, seconds: float, rate: float, height: float = 2.0) -> None:
        for _ in range(round(seconds * rate)):
            self.global_setpoint(0xDF8, 5, 1.0, -2.0, 488.0 + height)
            self.wait(1 / rate)

    def offboard(self) -> None:
        """In the air, in OFFBOARD."""
        self.stream(1.2, 10)
        assert self.mode(6) == 0 and self.command(ARM, 1) == 0
        self.stream(8.0, 10)
        assert self.at[2] == pytest.approx(2.0, abs=0.1)


def test_its_heartbeat_says_what_it_is() -> None:
    bench = Px4Bench()
    bench.wait(1.1)
    beat = bench.of(0)[-1]
    assert (beat.autopilot, beat.type, beat.custom_mode) == (mavlink.MAV_AUTOPILOT_PX4, 2, HOLD)
    assert {m.get_msgId() for m in bench.heard} >= {0, 33, 32, 245, 230}, "it streams unasked"


def test_offboard_is_refused_without_setpoints_faster_than_2_hz() -> None:
    bench = Px4Bench()
    assert bench.mode(6) == REJECTED
    bench.stream(3.0, 1.8)
    assert bench.mode(6) == REJECTED
    bench.stream(0.5, 10)
    assert bench.mode(6) == REJECTED, "not for long enough"
    bench.stream(0.7, 10)
    assert bench.mode(6) == 0 and bench.copter.mode == OFFBOARD


def test_offboard_takes_off_towards_a_setpoint_and_lands_when_they_cease() -> None:
    bench = Px4Bench()
    bench.offboard()
    bench.wait(0.9)
    assert bench.copter.mode == OFFBOARD
    bench.wait(0.3)
    assert bench.copter.mode == LAND
    bench.wait(10.0)
    assert not bench.copter.armed and bench.at[2] == 0.0


def test_a_stream_that_is_too_slow_ends_offboard() -> None:
    bench = Px4Bench()
    bench.offboard()
    bench.copter.params["COM_OF_LOSS_T"] = 0.4
    bench.stream(1.0, 2.0)
    assert bench.copter.mode == LAND


@pytest.mark.parametrize(("action", "mode"), [(4.0, LAND), (5.0, HOLD)])
def test_what_the_end_of_setpoints_does_is_a_parameter(action: float, mode: int) -> None:
    bench = Px4Bench()
    bench.copter.params["COM_OBL_RC_ACT"] = action
    bench.offboard()
    bench.wait(1.5)
    assert bench.copter.mode == mode


def test_without_the_exception_a_missing_remote_control_ends_offboard() -> None:
    bench = Px4Bench()
    bench.copter.params["COM_RCL_EXCEPT"] = 0.0
    bench.stream(1.2, 10)
    bench.mode(6)
    bench.command(ARM, 1)
    bench.stream(1.0, 10)
    assert bench.copter.mode == LAND


def test_the_modes_of_auto() -> None:
    bench = Px4Bench()
    assert bench.mode(4, 2) == 0 and bench.copter.mode == TAKEOFF
    assert bench.command(ARM, 1) == 0
    bench.wait(8.0)
    assert bench.copter.mode == HOLD and bench.at[2] == pytest.approx(2.5, abs=0.1)
    assert bench.command(ARM, 0) == REJECTED
    assert bench.mode(4, 6) == 0
    bench.wait(12.0)
    assert not bench.copter.armed and bench.at[2] == 0.0
    assert bench.mode(9, 9) == mavlink.MAV_RESULT_DENIED


def test_take_off_by_command_is_to_a_height_above_the_sea() -> None:
    bench = Px4Bench()
    assert bench.command(ARM, 1) == 0
    assert bench.command(TAKE_OFF, 0, 0, 0, math.nan, math.nan, math.nan, 488.0 + 3.0) == 0
    bench.wait(8.0)
    assert bench.at[2] == pytest.approx(3.0, abs=0.1)


def test_it_does_not_arm_without_a_position() -> None:
    bench = Bench(harness=PX4, boot=5.0)
    bench.wait(1.0)
    assert bench.command(ARM, 1) == REJECTED
    assert "Preflight Fail: no valid position estimate" in [m.text for m in bench.of(253)]


def test_it_disarms_by_itself_on_the_ground() -> None:
    bench = Px4Bench()
    bench.command(ARM, 1)
    bench.wait(9.8)
    assert bench.copter.armed
    bench.wait(0.4)
    assert not bench.copter.armed


def test_integers_travel_as_bytes() -> None:
    bench = Px4Bench()
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, b"FS_GCS_ENABLE", -1))
    bench.wait(0.2)
    (told,) = bench.of(22)
    assert told.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", told.param_value)) == (4,)
    five = struct.unpack("<f", struct.pack("<i", 5))[0]
    bench.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", five, mavlink.MAV_PARAM_TYPE_INT32))
    bench.wait(0.2)
    assert bench.copter.params["COM_OBL_RC_ACT"] == 5.0


def test_setpoints_that_make_no_sense_are_dropped() -> None:
    bench = Px4Bench()
    bench.offboard()
    for _ in range(10):
        bench.global_setpoint(0xDF8, 5, 1.0, -2.0, math.nan)
        bench.global_setpoint(0xDF8, 99, 5.0, -2.0, 490.0)
        bench.wait(0.1)
    assert bench.copter.mode == OFFBOARD and math.dist(bench.at, (1.0, -2.0, 2.0)) < 0.1


def test_hostile_numbers_never_raise() -> None:
    bench = Px4Bench()
    bench.command(INTERVAL, 33, -1)
    for value in (math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-40):
        for command in (INTERVAL, MODE, TAKE_OFF, 178, 512, 21, 400, 31000):
            bench.command(command, *[value] * 7)
        bench.local_setpoint(0xDC7, 1, 0, 0, 0, value, value, value)
        bench.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", value, mavlink.MAV_PARAM_TYPE_INT32))
        bench.wait(0.1)


def test_the_agent_flies_it() -> None:
    rig = Rig(harness=PX4)
    rig.fly()
    assert rig.autopilot is not None and rig.autopilot.copter.mode == OFFBOARD and 1.1 < at(rig).z < 1.7
    rig.go(4.0, 3.0)
    assert rig.run(15.0, rig.reached) and distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.2
    rig.quad.stop(rig.now)
    assert rig.run(15.0, lambda: rig.quad.stopped)
    assert not rig.autopilot.copter.armed and at(rig).z == 0.0
