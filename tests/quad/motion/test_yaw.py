"""The yaw is watched: a vehicle that turns by itself lands, and its log says why; one that is told to turn flies on."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import Rig, at, told
from koordgen.runtime.vehicle.platform import Unready
from targets.mavlink.framing import Framer
from targets.sim.base.bodies import Vector

SPINNING = {"version": "4.7-dev"}  # a build that takes a missing receiver's yaw stick for one at its end


def turned(rig: Rig, seconds: float) -> float:
    """Run until the agent gives up, or for so long. Return by how much the vehicle has turned in all, radians."""
    total, before = 0.0, rig.body.yaw

    def watch() -> None:
        nonlocal total, before
        total += abs(math.remainder(rig.body.yaw - before, math.tau))
        before = rig.body.yaw

    rig.watch = watch
    try:
        rig.run(seconds)
    finally:
        rig.watch = lambda: None
    return total


def turn_always(rig: Rig, rate: float) -> None:
    """The body turns at this rate (rad/s), whatever its autopilot asks for."""
    accelerate = rig.body.accelerate

    def turning(acceleration: Vector, yaw_rate: float) -> None:
        accelerate(acceleration, rate)

    rig.body.accelerate = turning  # type: ignore[method-assign]


def without_heading(data: bytes, down: bool) -> bytes:
    """A link whose autopilot does not know its heading."""
    if not down or told(data) != mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
        return data
    (message,) = Framer().datagram(data)
    message.hdg = 65535
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))


def test_a_quad_that_spins_in_its_take_off_lands_within_a_turn() -> None:
    rig = Rig(harness=SPINNING)
    rig.quad.start(rig.now)
    turns: list[float] = []
    rig.watch = lambda: turns.append(abs(rig.body.yaw))
    with pytest.raises(Unready, match="turns by itself") as refused:
        rig.run(40.0)
    assert max(turns) < 2.2 and at(rig).z < 1.5
    assert "GUID_OPTIONS 4" in refused.value.hint
    rig.quad.stop(rig.now)
    assert rig.run(20.0, lambda: rig.quad.stopped) and at(rig).z == 0.0


def test_the_log_names_the_parameter_before_the_take_off() -> None:
    rig = Rig(harness=SPINNING)
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: "GUID_OPTIONS is 0, wanted 4" in rig.quad.progress)
    assert at(rig).z == 0.0


def test_the_parameter_that_the_hint_names_helps() -> None:
    rig = Rig(harness=SPINNING)
    assert rig.autopilot is not None
    rig.autopilot.copter.params["GUID_OPTIONS"] = 4.0
    rig.fly()
    rig.go(-3.0, 1.0)
    assert turned(rig, 10.0) < 0.1 and rig.reached()


@pytest.mark.parametrize("policy", ["keep", "forward", "0.0"])
def test_a_quad_that_begins_to_spin_in_flight_lands_within_a_turn(policy: str) -> None:
    rig = Rig(harness=SPINNING, yaw=policy)
    assert rig.autopilot is not None
    rig.autopilot.copter.params["GUID_OPTIONS"] = 4.0
    rig.fly()
    rig.autopilot.copter.params["GUID_OPTIONS"] = 0.0
    began = rig.now
    with pytest.raises(Unready, match="turns by itself"):
        turned(rig, 10.0)
    assert rig.now - began < 2.0


@pytest.mark.parametrize("rate", [0.2, -0.5, 0.9, -3.0, 6.0])
def test_slow_and_fast_spins_are_noticed(rate: float) -> None:
    rig = Rig()
    rig.fly()
    turn_always(rig, rate)
    began = rig.now
    with pytest.raises(Unready, match=r"yaw is|turns by itself"):
        turned(rig, 10.0)
    assert rig.now - began < 2.6 + 0.6 / abs(rate)


def test_a_yaw_that_sticks_is_noticed() -> None:
    """The motors have no strength left to turn the vehicle: it is to look east, and looks west."""
    rig = Rig(yaw="0.0")
    rig.body.yaw = math.pi
    turn_always(rig, 0.0)
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match=r"yaw is \d\.\d rad from what is commanded") as refused:
        rig.run(40.0)
    assert "receiver" not in refused.value.hint


def test_a_yaw_that_is_no_longer_reported_is_noticed() -> None:
    rig = Rig()
    rig.fly()
    rig.wire.meddle = without_heading
    with pytest.raises(Unready, match="yaw is not reported"):
        rig.run(10.0)


def test_no_take_off_without_a_yaw() -> None:
    rig = Rig()
    rig.wire.meddle = without_heading
    rig.quad.start(rig.now)
    assert not rig.run(10.0, lambda: rig.quad.ready)
    assert rig.quad.progress.endswith("waiting for its position estimate")
    rig.wire.meddle = lambda data, down: data
    assert rig.run(20.0, lambda: rig.quad.ready)


@pytest.mark.parametrize("policy", ["3.1", "-1.6", "forward"])
def test_a_quad_that_is_told_to_turn_flies_on(policy: str) -> None:
    """To and fro, so that `forward` turns about at each end, sooner than it can."""
    rig = Rig(yaw=policy)
    rig.fly()
    for turn in range(12):
        rig.go((-3.0, 3.0)[turn % 2], -2.0)
        rig.run(2.0)
    rig.run(8.0)
    if policy != "forward":
        assert math.remainder(rig.body.yaw - float(policy), math.tau) == pytest.approx(0.0, abs=0.05)


def test_keep_is_the_heading_at_the_take_off() -> None:
    rig = Rig()
    rig.body.yaw = 1.2
    rig.fly()
    rig.go(-3.0, 1.0)
    assert turned(rig, 10.0) < 0.1
    assert rig.body.yaw == pytest.approx(1.2, abs=0.02)


def test_a_quad_that_was_turned_by_hand_before_its_take_off_keeps_its_new_heading() -> None:
    """Armed, disarmed, turned, armed again."""
    rig = Rig()
    assert rig.autopilot is not None
    copter = rig.autopilot.copter
    rig.quad.start(rig.now)
    assert rig.run(20.0, lambda: copter.armed)
    copter.armed = False
    copter.failing_check = "Compass not calibrated"
    rig.now += 6.0  # nobody thinks of a person who disarmed it
    rig.run(1.0)
    rig.body.yaw = 2.5
    rig.run(1.0)
    copter.failing_check = ""
    assert rig.run(20.0, lambda: rig.quad.ready)
    assert rig.body.yaw == pytest.approx(2.5, abs=0.02)


def test_an_agent_that_takes_over_keeps_the_heading_that_there_is() -> None:
    rig = Rig(yaw="1.0")
    rig.fly()
    rig.run(5.0)
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    assert rig.run(10.0, lambda: rig.quad.ready)
    assert turned(rig, 5.0) < 0.05 and rig.body.yaw == pytest.approx(1.0, abs=0.05)
