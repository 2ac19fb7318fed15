"""Who flies the vehicle: a pilot, a failsafe, a new agent, an autopilot that came up again."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, at, commands, sent, told
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready
from tests.mavlink.test_link import heartbeat


def test_a_pilot_who_takes_over_is_left_alone() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.enter(5, rig.now)  # LOITER, at the remote control
    with pytest.raises(Unready, match="LOITER: a pilot or a failsafe"):
        rig.run(3.0)
    rig.wire.up.clear()
    rig.quad.stop(rig.now)
    assert rig.run(2.0, lambda: rig.quad.stopped)
    assert not sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG) and rig.autopilot.copter.mode == 5


def test_a_failsafe_landing_is_waited_for() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.enter(9, rig.now)
    with pytest.raises(Unready, match="LAND: a pilot or a failsafe"):
        rig.run(3.0)
    rig.quad.stop(rig.now)
    assert rig.run(15.0, lambda: rig.quad.stopped)
    assert at(rig).z == 0.0 and not rig.autopilot.copter.armed


def test_a_disarming_in_flight_is_the_end() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.disarm(force=True)
    with pytest.raises(Unready, match="disarmed in flight"):
        rig.run(3.0)
    rig.quad.stop(rig.now)
    assert rig.run(5.0, lambda: rig.quad.stopped)


def test_a_new_agent_takes_over_in_flight() -> None:
    rig = Rig()
    rig.fly()
    rig.go(3.0, 0.0)
    rig.run(8.0)
    rig.wire.up.clear()
    rig.pass_time(3.0)  # the first agent died
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    assert rig.run(3.0, lambda: rig.quad.ready)
    assert distance(at(rig), Point(3.0, 0.0, 1.5)) < 0.2
    assert not commands(rig, mavlink.MAV_CMD_NAV_TAKEOFF)
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    rig.go(0.0, 0.0)
    assert rig.run(10.0, rig.reached)


def test_a_new_agent_that_is_ended_before_it_takes_over_lands_what_nobody_else_flies() -> None:
    for crowded in (False, True):
        rig = Rig()
        rig.fly()
        rig.quad = rig.agent()
        rig.wire.meddle = lambda data, down: None if down and told(data) == 33 else data  # no position: it waits
        rig.quad.start(rig.now)
        if crowded:
            rig.watch = lambda rig=rig: rig.wire.inject(heartbeat(system=2))  # type: ignore[misc]
        rig.run(3.0)
        assert not rig.quad.ready
        rig.quad.stop(rig.now)
        assert rig.run(20.0, lambda rig=rig: rig.quad.stopped)  # type: ignore[misc]
        assert (at(rig).z > 1.0) == crowded  # it may be another robot's


def test_a_new_agent_does_not_grab_a_vehicle_that_a_pilot_flies() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.enter(5, rig.now)
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="already flying in LOITER"):
        rig.run(5.0)
    rig.quad.stop(rig.now)
    assert rig.quad.stopped and rig.autopilot.copter.mode == 5


def restart(rig: Rig) -> None:
    """The autopilot's processor comes up again, its clock at 0."""
    other = Rig(boot=2.0)
    assert other.autopilot is not None
    other.autopilot._port, other.autopilot._body = rig.wire.autopilot_end, rig.body
    rig.body.motors(False)
    rig.autopilot = other.autopilot


def test_an_autopilot_that_restarts_in_its_climb_is_not_started_again() -> None:
    rig = Rig(flight_height=4.0)
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: rig.body.position[2] > 2.0)
    restart(rig)
    with pytest.raises(Unready, match="disarmed in flight"):
        rig.run(10.0)
    with pytest.raises(Unready):
        rig.run(10.0)
    rig.quad.stop(rig.now)
    assert rig.run(5.0, lambda: rig.quad.stopped)
    assert rig.autopilot is not None and not rig.autopilot.copter.armed


def test_an_autopilot_that_restarts_on_the_ground_is_prepared_anew() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.failing_check = "Hardware safety switch"
    rig.quad.start(rig.now)
    rig.run(8.0)
    restart(rig)
    assert rig.run(20.0, lambda: rig.quad.ready)
    assert any("restarted" in said for said in rig.progress)
