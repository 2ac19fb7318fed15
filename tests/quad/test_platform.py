"""The quad platform's whole life against the simulated autopilot, and everything that goes wrong in it."""

from __future__ import annotations

import math
import random
import tomllib
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.platform import Platform, Unready
from koordgen.runtime.settings import BadSettings
from koordgen.runtime.values import Point, distance
from targets.quad.framing import Framer, Message
from targets.quad.platform import Body, Quad
from tests.quad.rig import FENCE, Rig, settings
from tests.quad.test_link import heartbeat

SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT


def sent(rig: Rig, number: int) -> list[Message]:
    return [m for m in Framer().stream(b"".join(rig.wire.up)) if m.get_msgId() == number]


def commands(rig: Rig, command: int) -> list[Message]:
    return [m for m in sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG) if m.command == command]


def at(rig: Rig) -> Point:
    return Point(*rig.body.position)


def test_a_whole_life() -> None:
    rig = Rig(noise=0.005)
    platform: Platform = rig.quad
    rig.fly()
    sensed = platform.sense(rig.now)
    assert sensed.values["Motion.reached"] is True and sensed.time is not None and rig.now - sensed.time < 0.1
    assert distance(sensed.values["Motion.position"], at(rig)) < 0.03
    assert 1.2 < at(rig).z < 1.6

    rig.go(4.0, 3.0)  # z = 0 is raised to the flight height
    speeds: list[float] = []
    rig.watch = lambda: speeds.append(math.hypot(*rig.body.velocity[:2]))
    assert not rig.reached()
    assert rig.run(12.0, rig.reached)
    assert distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.2 and max(speeds) < 1.15

    rig.go(-4.0, -3.0, 2.5)
    rig.run(3.0)
    rig.quad.hold(True, rig.now)
    here = at(rig)
    rig.run(6.0)
    assert distance(at(rig), here) < 0.1 and math.hypot(*rig.body.velocity) < 0.05 and not rig.reached()
    rig.quad.hold(True, rig.now)
    rig.quad.hold(False, rig.now)
    assert rig.run(15.0, rig.reached)
    assert distance(at(rig), Point(-4.0, -3.0, 2.5)) < 0.2

    rig.quad.rest(rig.now)
    rig.quad.rest(rig.now)
    assert rig.run(15.0, lambda: rig.quad.rested)
    assert rig.autopilot is not None and not rig.autopilot.copter.armed and at(rig).z == 0.0
    rig.quad.close()
    rig.quad.close()
    assert rig.wire.closed


@pytest.mark.parametrize(("speed", "overshoot"), [(1.0, 0.55), (2.0, 1.1)])
def test_a_hold_brakes_at_once(speed: float, overshoot: float) -> None:
    """Where the vehicle is, not where the setpoint that ran ahead of it can be walked back from."""
    rig = Rig(max_speed=speed)
    rig.fly()
    rig.go(-5.5, -2.0)
    assert rig.run(3.0, lambda: rig.body.velocity[0] < -0.95 * speed)
    here, far = at(rig), [0.0]
    rig.quad.hold(True, rig.now)
    rig.watch = lambda: far.append(distance(at(rig), here))
    rig.run(5.0)
    assert max(far) < overshoot and far[-1] < 0.1 * (1 + speed)


def test_what_is_sent_on_the_way() -> None:
    """Setpoints at 20 Hz, position only, GLOBAL_INT, none before the take-off's height; our heartbeat once a second."""
    rig = Rig()
    rig.fly()
    assert len(sent(rig, SETPOINT)) < 10
    rig.wire.up.clear()
    rig.go(3.0, 3.0)
    rig.run(10.0)
    setpoints = sent(rig, SETPOINT)
    assert 180 <= len(setpoints) <= 201
    assert {(m.type_mask, m.coordinate_frame) for m in setpoints} == {(0xDF8, 5)}
    assert 9 <= len(sent(rig, mavlink.MAVLINK_MSG_ID_HEARTBEAT)) <= 11
    assert not commands(rig, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)


def test_reached_is_kept_by_the_same_target_and_cleared_by_a_new_one() -> None:
    rig = Rig()
    rig.fly()
    rig.go(1.0, -2.0, 1.5)
    assert not rig.reached()
    rig.watch = lambda: rig.go(1.0, -2.0, 1.5)  # written anew in every round
    assert rig.run(5.0, rig.reached)
    rig.run(1.0)
    assert rig.reached()
    rig.watch = lambda: None
    rig.go(1.1, -2.0, 1.5)
    assert not rig.reached()


def test_reached_means_standing_still() -> None:
    rig = Rig(reached_dwell=0.0, reached_radius=0.5)
    rig.fly()
    rig.go(-4.0, -2.0)
    rig.run(2.5)
    assert rig.body.velocity[0] < -0.7
    rig.go(rig.body.position[0] - 0.3, -2.0)
    assert rig.run(5.0, rig.reached)
    assert math.hypot(*rig.body.velocity) < 0.26


def test_a_refused_arming_shows_the_autopilots_words() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.failing_check = "Compass not calibrated"
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: "failed: Arm: Compass not calibrated" in rig.quad.progress)
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


def test_silence_is_reported_and_ends_the_waiting() -> None:
    rig = Rig(autopilot=False)
    rig.quad.start(rig.now)
    rig.run(20.0)
    assert "waiting for a heartbeat on udpin:127.0.0.1:14550" in rig.quad.progress and not rig.quad.ready
    assert rig.quad.sense(rig.now).time is None
    with pytest.raises(Unready) as error:
        rig.run(20.0)
    assert "no autopilot answers on udpin:127.0.0.1:14550" in error.value.message and error.value.hint
    rig.quad.rest(rig.now)
    assert rig.quad.rested


def test_a_link_lost_in_flight_shows_and_heals() -> None:
    rig = Rig()
    rig.fly()
    rig.go(4.0, 3.0)
    rig.run(2.0)
    rig.wire.cut = True
    cut = rig.now
    here = at(rig)
    rig.run(3.0)
    sensed = rig.quad.sense(rig.now)
    assert sensed.time is not None and sensed.time <= cut and not rig.quad.ready
    assert "no heartbeat" in rig.quad.progress
    assert distance(at(rig), here) < 2.1  # it holds the last setpoint, a leash away at most
    rig.wire.cut = False
    assert rig.run(15.0, rig.reached)
    assert rig.quad.ready


def told(data: bytes) -> int:
    """The number of a MAVLink 2 frame's message."""
    return int.from_bytes(data[7:10], "little")


def test_nothing_is_sent_on_a_stale_position() -> None:
    rig = Rig()
    rig.fly()
    rig.wire.meddle = lambda data, down: None if down and told(data) == 33 else data
    rig.go(3.0, 3.0)
    rig.run(0.6)
    rig.wire.up.clear()
    rig.run(3.0)
    assert not sent(rig, SETPOINT) and not rig.quad.ready
    rig.wire.meddle = lambda data, down: data
    assert rig.run(10.0, rig.reached)


def test_an_estimate_that_broke_down_is_not_a_position() -> None:
    """The autopilot goes on sending positions when its EKF has lost them; the agent must see them grow stale."""
    rig = Rig()
    rig.fly()
    lost = mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_ATTITUDE | mavlink.EKF_POS_HORIZ_ABS
                                                     | mavlink.EKF_CONST_POS_MODE, 0, 0, 0, 0, 0)  # fmt: skip
    frame = bytes(lost.pack(mavlink.MAVLink(None, 1, 1)))
    rig.wire.meddle = lambda data, down: frame if down and told(data) == 193 else data
    rig.run(0.3)
    broken = rig.now
    rig.run(1.0)
    time = rig.quad.sense(rig.now).time
    assert time is not None and time <= broken


def test_a_position_that_no_estimate_vouches_for_any_more_grows_stale() -> None:
    rig = Rig()
    rig.fly()
    rig.wire.meddle = lambda data, down: None if down and told(data) == 193 else data
    silent = rig.now
    rig.run(4.0)
    time = rig.quad.sense(rig.now).time
    assert time is not None and time <= silent + 2.5
    rig.wire.meddle = lambda data, down: data
    assert rig.run(3.0, lambda: rig.quad.ready)


def test_repeated_and_overtaken_positions_are_not_fresh() -> None:
    rig = Rig()
    rig.fly()
    kept: list[bytes] = []

    def freeze(data: bytes, down: bool) -> bytes | None:
        if down and told(data) == 33:
            kept.append(data)
            return kept[(len(kept) - 1) % 2]  # the first two, again and again
        return data

    rig.run(0.2)
    rig.wire.meddle = freeze
    rig.run(0.2)
    frozen = rig.now
    rig.run(1.0)
    time = rig.quad.sense(rig.now).time
    assert time is not None and time <= frozen


def test_a_message_from_long_ago_is_no_restart() -> None:
    rig = Rig()
    kept: list[bytes] = []

    def record(data: bytes, down: bool) -> bytes:
        if down and told(data) == 33:
            kept.append(data)
        return data

    rig.wire.meddle = record
    rig.fly()
    rig.run(3.0)
    for old in kept[:20]:
        rig.wire.inject(old)
        rig.run(0.05)
    assert rig.quad.ready


def test_velocity_is_sensed_in_the_fleets_frame() -> None:
    rig = Rig()
    rig.fly()
    rig.go(4.0, 1.0, 3.0)
    rig.run(3.0)
    sensed, true = rig.quad.sense(rig.now).values["Motion.velocity"], Point(*rig.body.velocity)
    assert true.x > 0.4 and true.y > 0.4 and true.z > 0.1
    assert distance(sensed, true) < 0.03


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


def test_a_link_cut_for_good_is_unready_and_the_autopilot_lands_by_itself() -> None:
    rig = Rig()
    rig.fly()
    rig.wire.cut = True
    with pytest.raises(Unready, match="fallen silent"):
        rig.run(40.0)
    assert rig.autopilot is not None and not rig.autopilot.copter.armed and at(rig).z == 0.0


def test_an_agent_that_rests_over_a_broken_link_lands_when_it_heals() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    rig.autopilot.copter.params["FS_GCS_ENABLE"] = 0.0
    rig.fly()
    rig.wire.cut = True
    rig.quad.rest(rig.now)
    rig.run(5.0)
    assert not rig.quad.rested
    rig.wire.cut = False
    assert rig.run(10.0, lambda: rig.quad.rested)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_garbage_and_loss_do_no_harm(seed: int) -> None:
    """A fifth of all datagrams lost, another fifth damaged, noise in between."""
    rig = Rig()
    dice = random.Random(seed)

    def meddle(data: bytes, down: bool) -> bytes | None:
        luck = dice.random()
        if luck < 0.2:
            return None
        if luck < 0.4:
            damaged = bytearray(data)
            damaged[dice.randrange(len(damaged))] ^= 1 << dice.randrange(8)
            return bytes(damaged)
        if down and luck < 0.5:
            rig.wire.inject(dice.randbytes(dice.randrange(300)))
        return data

    rig.wire.meddle = meddle
    rig.fly()
    rig.go(-3.0, 2.0)
    assert rig.run(15.0, rig.reached)
    rig.quad.rest(rig.now)
    assert rig.run(15.0, lambda: rig.quad.rested)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_target_that_is_not_finite_is_never_sent(bad: float) -> None:
    rig = Rig()
    rig.fly()
    rig.go(2.0, 2.0)
    rig.run(10.0)
    for target in (Point(bad, 0, 2), Point(0, bad, 2), Point(0, 0, bad)):
        rig.quad.command({"Motion.target": target}, rig.now)
        rig.run(1.0)
    assert all(math.isfinite(m.alt) for m in sent(rig, SETPOINT))
    assert distance(at(rig), Point(2.0, 2.0, 1.5)) < 0.15 and "3 targets were not finite" in rig.quad.progress


def test_a_target_outside_the_fence_is_clamped() -> None:
    rig = Rig()
    rig.fly()
    rig.go(50.0, -50.0, 50.0)
    assert rig.run(20.0, rig.reached)
    assert distance(at(rig), FENCE.hi) > 5 and distance(at(rig), Point(6.0, -5.0, 4.0)) < 0.2


@pytest.mark.parametrize(("autopilot", "kind", "name"), [(3, 10, "MAV_TYPE 10"), (12, 2, "PX4"), (3, 1, "MAV_TYPE 1")])
def test_what_is_not_an_ardupilot_copter_is_refused_and_left_alone(autopilot: int, kind: int, name: str) -> None:
    rig = Rig(autopilot=False)
    rig.quad.start(rig.now)
    rig.wire.inject(heartbeat(autopilot=autopilot, kind=kind))
    with pytest.raises(Unready, match=name):
        rig.run(1.0)
    rig.quad.rest(rig.now)
    assert rig.quad.rested
    assert not sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)


def test_a_pilot_who_takes_over_is_left_alone() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter._enter(5, rig.body.state().position, rig.now)  # LOITER, at the remote control
    with pytest.raises(Unready, match="LOITER: a pilot or a failsafe"):
        rig.run(3.0)
    rig.wire.up.clear()
    rig.quad.rest(rig.now)
    assert rig.run(2.0, lambda: rig.quad.rested)
    assert not sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG) and rig.autopilot.copter.mode == 5


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
    rig.quad.rest(rig.now)
    rig.watch = lambda: None if not copter.armed else pytest.fail("armed again")
    assert rig.run(5.0, lambda: rig.quad.rested)


def test_a_pilot_who_takes_over_before_take_off_is_left_alone() -> None:
    rig = Rig()
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    rig.wire.meddle = lambda data, down: None if not down and told(data) == 76 and copter.armed else data
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: copter.armed)
    rig.run(1.0)
    copter._enter(0, rig.body.state().position, rig.now)  # STABILIZE, at the remote control
    rig.wire.meddle = lambda data, down: data
    with pytest.raises(Unready, match="STABILIZE: a pilot or a failsafe"):
        rig.run(2.0)
    rig.quad.rest(rig.now)
    assert rig.run(2.0, lambda: rig.quad.rested) and copter.mode == 0 and at(rig).z < 0.01


def test_a_climb_without_a_position_ends_in_a_landing() -> None:
    rig = Rig(flight_height=3.0)
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: at(rig).z > 0.3)
    rig.wire.meddle = lambda data, down: None if down and told(data) == 33 else data
    with pytest.raises(Unready, match="no position for"):
        rig.run(6.0)
    rig.quad.rest(rig.now)
    assert rig.run(20.0, lambda: rig.quad.rested) and at(rig).z == 0.0


def test_a_failsafe_landing_is_waited_for() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter._enter(9, (*rig.body.state().position[:2], 0.0), rig.now)
    with pytest.raises(Unready, match="LAND: a pilot or a failsafe"):
        rig.run(3.0)
    rig.quad.rest(rig.now)
    assert rig.run(15.0, lambda: rig.quad.rested)
    assert at(rig).z == 0.0 and not rig.autopilot.copter.armed


def test_a_disarming_in_flight_is_the_end() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.disarm(force=True)
    with pytest.raises(Unready, match="disarmed in flight"):
        rig.run(3.0)
    rig.quad.rest(rig.now)
    assert rig.run(5.0, lambda: rig.quad.rested)


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
        rig.quad.rest(rig.now)
        assert rig.run(20.0, lambda rig=rig: rig.quad.rested)  # type: ignore[misc]
        assert (at(rig).z > 1.0) == crowded  # it may be another robot's


def test_a_new_agent_does_not_grab_a_vehicle_that_a_pilot_flies() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter._enter(5, rig.body.state().position, rig.now)
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="already flying in LOITER"):
        rig.run(5.0)
    rig.quad.rest(rig.now)
    assert rig.quad.rested and rig.autopilot.copter.mode == 5


def test_rest_before_take_off_disarms() -> None:
    rig = Rig()
    rig.quad.start(rig.now)
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    assert rig.run(10.0, lambda: copter.armed)
    rig.quad.rest(rig.now)
    assert rig.run(12.0, lambda: rig.quad.rested)
    assert not copter.armed and at(rig).z < 0.01


def test_a_landing_that_never_disarms_is_ended_on_the_ground() -> None:
    rig = Rig()
    rig.fly()
    assert rig.autopilot is not None
    rig.autopilot.copter.params["LAND_REPOSITION"] = 1.0
    disarmed_at: list[float] = []
    copter = rig.autopilot.copter
    rig.watch = lambda: None if copter.armed else disarmed_at.append(rig.body.position[2])
    rig.quad.rest(rig.now)
    assert rig.run(25.0, lambda: rig.quad.rested)
    assert disarmed_at[0] == 0.0 and any("still armed" in said for said in rig.progress)


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
    rig.quad.rest(rig.now)
    assert rig.run(5.0, lambda: rig.quad.rested)
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


def test_check_reports_and_moves_nothing() -> None:
    rig = Rig()
    began = rig.now
    lines = rig.quad.check()
    assert rig.now - began < 10.0 and rig.wire.closed
    assert "ArduPilot quadrotor 4.7.0" in lines[0] and "(1.00, -2.00, 0.00)" in lines[1]
    asked = {m.command for m in sent(rig, mavlink.MAVLINK_MSG_ID_COMMAND_LONG)}
    assert asked <= {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}


def test_check_of_a_silent_link_and_of_one_without_estimate() -> None:
    silent = Rig(autopilot=False)
    with pytest.raises(Unready, match="no autopilot answers"):
        silent.quad.check()
    assert silent.now - 1000.0 <= 10.0
    with pytest.raises(Unready, match="no position estimate yet"):
        Rig(boot=42.0).quad.check()


@pytest.mark.parametrize(
    ("body", "key"),
    [
        ({"flight_height": "high"}, "flight_height"),
        ({"flight_height": 30.0}, "flight_height"),
        ({"max_speed": 0.0}, "max_speed"),
        ({"hover": 1}, "hover"),
    ],
)
def test_bad_settings_name_the_key(body: dict[str, object], key: str) -> None:
    with pytest.raises(BadSettings, match=key):
        Quad(settings(**body), None)


def test_settings_have_the_manifests_defaults_and_bounds() -> None:
    declared = tomllib.loads((Path(__file__).parents[2] / "targets/quad/manifest.toml").read_text())["settings"]
    assert {f.name: f.default for f in msgspec.structs.fields(Body)} == {k: v["default"] for k, v in declared.items()}
    for name, hint in get_type_hints(Body, include_extras=True).items():
        if "min" in declared[name]:
            meta = get_args(hint)[1]
            assert (meta.ge, meta.le) == (declared[name]["min"], declared[name]["max"])


def test_the_same_seed_gives_the_same_flight() -> None:
    def flight() -> list[bytes]:
        rig = Rig(noise=0.02)
        rig.fly()
        rig.go(2.0, 1.0)
        rig.run(3.0)
        return rig.wire.up

    assert flight() == flight()
