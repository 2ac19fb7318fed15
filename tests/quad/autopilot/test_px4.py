"""The quad's agent and a PX4: OFFBOARD by a stream of setpoints, a take-off by setpoints that rise, AUTO's landing."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.fixtures.quad_rig import SETPOINT, Rig, at, commands, sent, told
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready
from targets.quad.autopilot.px4 import LAND, OFFBOARD, PX4, custom_mode
from targets.sim.autopilots.mavlink_copter import Copter
from tests.quad.platform.fed import FedRig

HOLD = custom_mode(4, 3)


def px4(**how: Any) -> tuple[Rig, Copter]:
    rig = Rig(harness={"firmware": "px4"}, **how)
    assert rig.autopilot is not None
    return rig, rig.autopilot.copter


def modes(rig: Rig) -> list[int]:
    """Those that were asked for."""
    return [custom_mode(int(m.param2), int(m.param3)) for m in commands(rig, mavlink.MAV_CMD_DO_SET_MODE)]


def test_a_whole_life() -> None:
    rig, copter = px4(noise=0.005)
    times: list[float] = []
    send = rig.wire.send

    def record(data: bytes) -> bool:
        if told(data) == SETPOINT:
            times.append(rig.now)
        return send(data)

    rig.wire.send = record  # type: ignore[method-assign]
    climbs: list[float] = []
    rig.watch = lambda: climbs.append(rig.body.velocity[2])
    rig.fly()
    assert copter.mode == OFFBOARD and 1.1 < at(rig).z < 1.6
    assert max(climbs) < 0.8, "a climb, not a jump"
    rig.go(4.0, 3.0)
    assert rig.run(12.0, rig.reached) and distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.2
    rig.quad.hold(True, rig.now)
    rig.run(3.0)
    assert rig.quad.ready
    gaps = [b - a for a, b in pairwise(times)]
    assert max(gaps) < 0.3, "OFFBOARD needs setpoints faster than 2 Hz, from before the switch on"
    rig.quad.stop(rig.now)
    assert rig.run(15.0, lambda: rig.quad.stopped)
    assert set(modes(rig)) == {OFFBOARD, LAND} and not copter.armed and at(rig).z == 0.0
    assert not commands(rig, mavlink.MAV_CMD_NAV_TAKEOFF)


def test_a_refused_arming_shows_its_words_and_setpoints_flow_on() -> None:
    rig, copter = px4()
    copter.failing_check = "Compass not calibrated"
    rig.quad.start(rig.now)
    rig.run(15.0)
    assert rig.quad.progress == "arming: rejected for now: Preflight Fail: Compass not calibrated"
    assert copter.mode == OFFBOARD and rig.body.position[2] == 0.0
    copter.failing_check = ""
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_it_lands_by_itself_soon_after_the_last_setpoint() -> None:
    rig, copter = px4()
    rig.fly()
    rig.pass_time(1.2)  # the agent died
    assert copter.mode == LAND
    rig.wire.up.clear()
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    rig.run(1.5)
    assert "already flying in LAND" in rig.quad.progress
    rig.quad.stop(rig.now)
    assert rig.run(1.0, lambda: rig.quad.stopped) and not modes(rig)


def test_a_pilot_keeps_the_mode() -> None:
    rig, copter = px4()
    rig.fly()
    copter.enter(HOLD, rig.now)
    with pytest.raises(Unready, match="HOLD: a pilot or a failsafe"):
        rig.run(3.0)
    rig.quad.stop(rig.now)
    assert rig.run(2.0, lambda: rig.quad.stopped) and copter.mode == HOLD


def test_a_cut_link_ends_in_a_landing() -> None:
    rig, copter = px4()
    rig.fly()
    rig.wire.cut = True
    rig.run(2.5)
    assert copter.mode == LAND and not rig.quad.ready
    rig.quad.stop(rig.now)  # what the agent does after 2 s without a position
    rig.wire.cut = False
    assert rig.run(15.0, lambda: rig.quad.stopped) and at(rig).z == 0.0


def test_no_take_off_with_one_that_would_not_land_when_the_agent_dies() -> None:
    rig, copter = px4()
    copter.params["COM_OBL_RC_ACT"] = 0.0
    rig.quad.start(rig.now)
    rig.run(10.0)
    said = "not taking off: COM_OBL_RC_ACT is 0, wanted 4: else the vehicle does not land when the agent dies (correct"
    assert rig.quad.progress.startswith(said)
    assert not sent(rig, SETPOINT)
    copter.params["COM_OBL_RC_ACT"] = 4.0
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_what_is_found_of_a_px4() -> None:
    rig, copter = px4()
    found = {f.name: f for f in rig.quad.diagnose()}
    assert not [f for f in found.values() if f.state == "fail"]
    assert found["firmware"].found.startswith("PX4 quadrotor 1.15.4") and found["parameters"].state == "ok"
    assert "(1.00, -2.00, 0.00) m" in found["place"].found
    assert not sent(rig, SETPOINT) and not modes(rig) and copter.mode == HOLD


def test_modes_have_names() -> None:
    assert PX4.mode(LAND) == "LAND" and PX4.mode(custom_mode(3)) == "POSITION" and PX4.mode(99) == "mode 99"
    assert PX4.ask_mode(LAND) == (1, 4, 6) and PX4.ask_mode(OFFBOARD) == (1, 6, 0)


def test_it_flies_by_vision_and_takes_no_fixes() -> None:
    rig = FedRig("vision", harness={"firmware": "px4"})
    rig.fly()
    assert sent(rig, mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE)
    rig = FedRig("gps_input", harness={"firmware": "px4"})
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="PX4 does not support positioning 'gps_input'") as told:
        rig.run(5.0)
    assert "vision" in told.value.hint
