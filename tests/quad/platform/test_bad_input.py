"""What a wrong link, vehicle or moment comes to: what the agent does, and what it says."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, at, commands, sent
from koordgen.runtime.vehicle.platform import Unready
from tests.mavlink.test_link import heartbeat
from tests.quad.autopilot.test_hands import restart

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def test_a_link_of_garbage_is_told_from_a_silent_one() -> None:
    dice = random.Random(5)
    rig = Rig(autopilot=False)
    rig.quad.start(rig.now)
    rig.watch = lambda: rig.wire.inject(dice.randbytes(60))
    with pytest.raises(Unready, match="no autopilot answers on udpin") as error:
        rig.run(40.0)
    assert "bytes arrived that are no MAVLink: check the baud rate" in error.value.hint
    rig.quad.stop(rig.now)
    assert rig.quad.stopped and not commands(rig, ARM)


def test_another_vehicle_than_the_one_asked_for_is_left_alone() -> None:
    rig = Rig(autopilot=False, system=3)
    rig.quad.start(rig.now)
    rig.watch = lambda: rig.wire.inject(heartbeat(system=7))
    with pytest.raises(Unready, match="no autopilot of system 3 answers") as error:
        rig.run(40.0)
    assert error.value.hint == "MAVLink system 7 answers: check the robot's setting `system`"
    assert not sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)
    found, *_ = rig.agent(system=3).diagnose()
    assert found.state == "fail" and found.found.startswith("no autopilot of system 3 answers")


def test_of_several_vehicles_on_a_link_the_one_asked_for_flies() -> None:
    rig = Rig(system=1)
    rig.watch = lambda: rig.wire.inject(heartbeat(system=2) + heartbeat(system=7))
    rig.wire.inject(heartbeat(system=2))
    rig.fly()
    messages = sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)
    assert {m.target_system for m in messages} == {1}
    rig = Rig(system=1)
    rig.wire.meddle = lambda data, down: data + heartbeat(system=2) if down else data
    assert rig.quad.diagnose()[0].found.endswith("system 1; also heard: 2")


def test_without_a_choice_the_setting_is_named() -> None:
    rig = Rig()
    rig.quad.start(rig.now)
    rig.watch = lambda: rig.wire.inject(heartbeat(system=2))
    rig.run(5.0)
    assert "another autopilot (system 2) sends to" in rig.quad.progress and "`system`" in rig.quad.progress
    assert not commands(rig, ARM)


def test_a_link_that_is_lost_in_flight_is_told_of_at_once_and_taken_up_again() -> None:
    rig = Rig()
    rig.fly()
    rig.go(3.0, 0.0)
    rig.run(1.0)
    rig.wire.cut = True
    rig.run(0.6)
    assert rig.quad.progress == "nothing comes on udpin:127.0.0.1:14550; was flying" and not rig.quad.ready
    rig.run(2.0)
    assert rig.quad.progress == "no heartbeat on udpin:127.0.0.1:14550; was flying"
    rig.wire.cut = False
    assert rig.run(12.0, rig.reached) and rig.quad.progress == "flying"


def test_an_autopilot_that_restarts_in_flight_is_lost() -> None:
    rig = Rig()
    rig.fly()
    restart(rig)
    with pytest.raises(Unready, match=r"the autopilot (restarted|disarmed) in flight"):
        rig.run(10.0)
    rig.wire.up.clear()
    rig.quad.stop(rig.now)
    assert rig.run(5.0, lambda: rig.quad.stopped) and at(rig).z == 0.0
    assert not [m for m in commands(rig, ARM) if m.param1 == 1]


def test_another_ground_station_under_our_number_is_told_of() -> None:
    """Its heartbeats hold off the failsafe that lands the vehicle of a dead agent."""
    rig = Rig()
    station = heartbeat(system=255, component=1, autopilot=mavlink.MAV_AUTOPILOT_INVALID, kind=mavlink.MAV_TYPE_GCS)
    other = heartbeat(system=254, autopilot=mavlink.MAV_AUTOPILOT_INVALID, kind=mavlink.MAV_TYPE_GCS)
    rig.watch = lambda: rig.wire.inject(other)
    rig.fly()
    assert not any("ground station" in said for said in rig.progress)
    rig = Rig()
    rig.watch = lambda: rig.wire.inject(station)
    rig.fly()
    assert sum("another ground station sends heartbeats as system 255" in said for said in rig.progress) == 1
    rig = Rig()
    rig.wire.meddle = lambda data, down: data + station if down else data
    (found,) = (f for f in rig.quad.diagnose() if f.name == "failsafe")
    assert found.state == "warn" and "does not land when this agent dies" in found.found
