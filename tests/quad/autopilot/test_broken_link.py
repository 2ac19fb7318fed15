"""A link that is silent, lossy or cut, and positions that are not to be believed."""

from __future__ import annotations

import math
import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import SETPOINT, Rig, at, sent, told
from koordgen.runtime.values.points import distance
from koordgen.runtime.vehicle.platform import Unready


def test_silence_is_reported_and_ends_the_waiting() -> None:
    rig = Rig(autopilot=False)
    rig.quad.start(rig.now)
    rig.run(20.0)
    assert "waiting for a heartbeat on udpin:127.0.0.1:14550" in rig.quad.progress and not rig.quad.ready
    assert rig.quad.sense(rig.now).time is None
    with pytest.raises(Unready) as error:
        rig.run(20.0)
    assert "no autopilot answers on udpin:127.0.0.1:14550" in error.value.message and error.value.hint
    rig.quad.stop(rig.now)
    assert rig.quad.stopped


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
    assert distance(at(rig), here) < 3.5  # it runs on for 3 s, at 1 m/s
    rig.wire.cut = False
    assert rig.run(15.0, rig.reached)
    assert rig.quad.ready


def test_on_a_stale_position_the_motion_is_ended_and_then_nothing_is_sent() -> None:
    """By a position alone: with the last velocity the autopilot would run on for 3 s."""
    rig = Rig()
    rig.fly()
    rig.go(3.0, 3.0)
    rig.run(1.5)
    here = at(rig)
    rig.wire.meddle = lambda data, down: None if down and told(data) == 33 else data
    rig.run(0.6)
    rig.wire.up.clear()
    rig.run(3.0)
    assert 15 < len(sent(rig, SETPOINT)) <= 20 and {m.type_mask for m in sent(rig, SETPOINT)} == {0x9F8}
    assert not rig.quad.ready and distance(at(rig), here) < 1.6 and math.hypot(*rig.body.velocity) < 0.05
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


def test_a_link_cut_for_good_is_unready_and_the_autopilot_lands_by_itself() -> None:
    rig = Rig()
    rig.fly()
    rig.wire.cut = True
    with pytest.raises(Unready, match="fallen silent"):
        rig.run(40.0)
    assert rig.autopilot is not None and not rig.autopilot.copter.armed and at(rig).z == 0.0


def test_an_agent_that_rests_over_a_broken_link_lands_when_it_heals() -> None:
    rig = Rig(allow_no_failsafe=True)
    assert rig.autopilot is not None
    rig.autopilot.copter.params["FS_GCS_ENABLE"] = 0.0
    rig.fly()
    rig.wire.cut = True
    rig.quad.stop(rig.now)
    rig.run(5.0)
    assert not rig.quad.stopped
    rig.wire.cut = False
    assert rig.run(10.0, lambda: rig.quad.stopped)


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
    rig.quad.stop(rig.now)
    assert rig.run(15.0, lambda: rig.quad.stopped)
