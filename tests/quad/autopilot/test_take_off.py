"""From nothing to the flight's height, and all that must keep a quad on the ground."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import SETPOINT, Rig, at, commands, sent, told
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.framing import Framer
from tests.mavlink.test_link import heartbeat


def test_a_refused_arming_shows_the_autopilots_words() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.failing_check = "Compass not calibrated"
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: "failed: PreArm: Compass not calibrated" in rig.quad.progress)
    assert not rig.run(30.0, lambda: rig.quad.ready)
    assert "Compass not calibrated" in rig.quad.progress
    rig.autopilot.copter.failing_check = ""
    assert rig.run(15.0, lambda: rig.quad.ready)


def test_no_take_off_while_two_autopilots_answer() -> None:
    """Which of them is this robot's? To fly the wrong one is worse than not to fly."""
    rig = Rig()
    rig.quad.start(rig.now)
    rig.watch = lambda: rig.wire.inject(heartbeat(system=2))
    rig.run(10.0)
    assert "another autopilot" in rig.quad.progress
    assert rig.autopilot is not None and not rig.autopilot.copter.armed
    rig.watch = lambda: None
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_a_mode_that_is_lost_after_boot_is_asked_again() -> None:
    rig = Rig(boot=0.0)
    rig.quad.start(rig.now)
    assert rig.run(15.0, lambda: rig.quad.ready)
    assert len(commands(rig, mavlink.MAV_CMD_DO_SET_MODE)) >= 2


def test_an_arming_that_ran_out_is_repeated() -> None:
    """The first take-offs are lost on the way: the autopilot disarms after 10 s."""
    rig = Rig()
    started = rig.now

    def no_takeoff(data: bytes, down: bool) -> bytes | None:
        messages = Framer().datagram(data)
        takeoff = any(m.get_msgId() == 76 and m.command == mavlink.MAV_CMD_NAV_TAKEOFF for m in messages)
        return None if takeoff and rig.now < started + 16.0 else data

    rig.wire.meddle = no_takeoff
    rig.quad.start(rig.now)
    assert rig.run(40.0, lambda: rig.quad.ready)
    assert any("disarmed before take-off" in said for said in rig.progress)


def test_a_mode_that_falls_back_before_take_off_is_set_again() -> None:
    rig = Rig()
    rig.quad.start(rig.now)
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    copter.failing_check = "Compass not calibrated"
    assert rig.run(10.0, lambda: "arming" in rig.quad.progress)
    copter.mode = 0
    copter.failing_check = ""
    assert rig.run(15.0, lambda: rig.quad.ready)
    assert any("fell back to STABILIZE" in said for said in rig.progress)


@pytest.mark.parametrize(("autopilot", "kind", "name"), [(3, 10, "MAV_TYPE 10"), (4, 2, "autopilot 4"), (12, 1, "PX4")])
def test_what_is_no_copter_of_a_known_firmware_is_refused_and_left_alone(autopilot: int, kind: int, name: str) -> None:
    rig = Rig(autopilot=False)
    rig.quad.start(rig.now)
    rig.wire.inject(heartbeat(autopilot=autopilot, kind=kind))
    with pytest.raises(Unready, match=name):
        rig.run(1.0)
    rig.quad.stop(rig.now)
    assert rig.quad.stopped
    assert not sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)


def test_a_person_who_disarms_before_take_off_is_not_overruled() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    rig.wire.meddle = lambda data, down: None if not down and told(data) == 76 and copter.armed else data  # no take-off
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: copter.armed)
    rig.run(2.0)
    copter.disarm(force=False)
    with pytest.raises(Unready, match="disarmed before take-off"):
        rig.run(2.0)
    rig.wire.meddle = lambda data, down: data
    rig.quad.stop(rig.now)
    rig.watch = lambda: None if not copter.armed else pytest.fail("armed again")
    assert rig.run(5.0, lambda: rig.quad.stopped)


def test_a_pilot_who_takes_over_before_take_off_is_left_alone() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    rig.wire.meddle = lambda data, down: None if not down and told(data) == 76 and copter.armed else data
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: copter.armed)
    rig.run(1.0)
    copter.enter(0, rig.now)  # STABILIZE, at the remote control
    rig.wire.meddle = lambda data, down: data
    with pytest.raises(Unready, match="STABILIZE: a pilot or a failsafe"):
        rig.run(2.0)
    rig.quad.stop(rig.now)
    assert rig.run(2.0, lambda: rig.quad.stopped) and copter.mode == 0 and at(rig).z < 0.01


def test_a_climb_without_a_position_ends_in_a_landing() -> None:
    rig = Rig(flight_height=3.0)
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: at(rig).z > 0.3)
    rig.wire.meddle = lambda data, down: None if down and told(data) == 33 else data
    with pytest.raises(Unready, match="no position for"):
        rig.run(6.0)
    rig.quad.stop(rig.now)
    assert rig.run(20.0, lambda: rig.quad.stopped) and at(rig).z == 0.0


def test_no_take_off_while_held() -> None:
    """The agent holds its body until the whole fleet was heard."""
    rig = Rig()
    assert rig.autopilot is not None
    rig.quad.hold(True, rig.now)
    rig.quad.start(rig.now)
    rig.run(10.0)
    assert rig.quad.progress == "ready to take off, waiting for the fleet"
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM) and rig.autopilot.copter.mode == 0
    rig.quad.hold(False, rig.now)
    assert rig.run(15.0, lambda: rig.quad.ready)
    rig.quad.hold(True, rig.now)  # in the air it is a pause
    rig.run(2.0)
    assert rig.quad.ready


def test_rest_before_take_off_disarms() -> None:
    rig = Rig()
    rig.quad.start(rig.now)
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    assert rig.run(10.0, lambda: copter.armed)
    rig.quad.stop(rig.now)
    assert rig.run(12.0, lambda: rig.quad.stopped)
    assert not copter.armed and at(rig).z < 0.01


def test_no_take_off_from_where_the_fleet_is_not() -> None:
    rig = Rig(position=(60.0, 0.0, 0.0))
    rig.quad.start(rig.now)
    rig.run(10.0)
    assert "(60.00, " in rig.quad.progress and "outside the geofence" in rig.quad.progress
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)


def test_an_autopilot_that_does_not_follow_is_not_silently_accepted() -> None:
    rig = Rig()
    rig.wire.meddle = lambda data, down: None if not down and data[7] == SETPOINT else data
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="does not follow"):
        rig.run(30.0)
    assert not rig.quad.ready


@pytest.mark.parametrize("height", [0.5, 1.1, 3.0])
def test_it_is_ready_when_it_stands_at_its_height(height: float) -> None:
    """The program's first event must not see a vehicle that still climbs."""
    rig = Rig(flight_height=height)
    rig.fly()
    assert at(rig).z == pytest.approx(height, abs=0.1) and abs(rig.body.velocity[2]) < 0.3
