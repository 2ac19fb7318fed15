"""The quad's agent and a PX4: OFFBOARD by a stream of setpoints, a take-off by setpoints that rise, AUTO's landing."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.platform import Unready
from koordgen.runtime.values import Point, distance
from targets.quad.px4 import PX4
from tests.quad.fed import FedRig
from tests.quad.rig import SETPOINT, Rig, at, commands, sent, told
from tests.quad.scripted_px4 import LAND, OFFBOARD, POSITION, ScriptedPx4


def px4(**body: Any) -> tuple[Rig, ScriptedPx4]:
    rig = Rig(autopilot=False, **body)
    scripted = ScriptedPx4(rig.body, rig.wire.autopilot_end)
    rig.autopilot = scripted  # type: ignore[assignment]
    return rig, scripted


def test_a_whole_life() -> None:
    rig, autopilot = px4()
    times: list[float] = []
    send = rig.wire.send

    def record(data: bytes) -> bool:
        if told(data) == SETPOINT:
            times.append(rig.now)
        return send(data)

    rig.wire.send = record  # type: ignore[method-assign]
    fastest: list[float] = []
    rig.watch = lambda: fastest.append(rig.body.velocity[2])
    rig.fly()
    assert autopilot.modes == [OFFBOARD] and 1.1 < at(rig).z < 1.6
    assert max(fastest) < 0.8, "a climb, not a jump"
    rig.go(4.0, 3.0)
    assert rig.run(12.0, rig.reached) and distance(at(rig), Point(4.0, 3.0, 1.5)) < 0.2
    rig.quad.hold(True, rig.now)
    rig.run(3.0)
    assert rig.quad.ready
    gaps = [b - a for a, b in pairwise(times)]
    assert max(gaps) < 0.3, "OFFBOARD needs setpoints faster than 2 Hz, from before the switch on"
    rig.quad.rest(rig.now)
    assert rig.run(15.0, lambda: rig.quad.rested)
    assert autopilot.modes == [OFFBOARD, LAND] and not autopilot.armed and at(rig).z == 0.0
    assert not commands(rig, mavlink.MAV_CMD_NAV_TAKEOFF)


def test_a_refused_arming_shows_its_words_and_setpoints_flow_on() -> None:
    rig, autopilot = px4()
    autopilot.refused = "Arming denied: no valid global position"
    rig.quad.start(rig.now)
    rig.run(15.0)
    assert rig.quad.progress == f"arming: rejected for now: {autopilot.refused}"
    assert autopilot.mode == OFFBOARD and rig.body.position[2] == 0.0
    autopilot.refused = ""
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_it_lands_by_itself_soon_after_the_last_setpoint() -> None:
    rig, autopilot = px4()
    rig.fly()
    rig.pass_time(1.2)  # the agent died
    assert autopilot.mode == LAND
    rig.quad = rig.agent()
    rig.quad.start(rig.now)
    rig.run(0.5)
    assert "already flying in LAND" in rig.quad.progress
    rig.quad.rest(rig.now)
    assert rig.run(1.0, lambda: rig.quad.rested)
    assert len(commands(rig, mavlink.MAV_CMD_DO_SET_MODE)) == 1


def test_a_pilot_keeps_the_mode() -> None:
    rig, autopilot = px4()
    rig.fly()
    autopilot.enter(POSITION)
    with pytest.raises(Unready, match="POSITION: a pilot or a failsafe"):
        rig.run(3.0)
    rig.quad.rest(rig.now)
    assert rig.run(2.0, lambda: rig.quad.rested) and autopilot.mode == POSITION


def test_no_take_off_with_one_that_would_not_land_when_the_agent_dies() -> None:
    rig, autopilot = px4()
    autopilot.params["COM_OBL_RC_ACT"] = 0
    rig.quad.start(rig.now)
    rig.run(10.0)
    assert rig.quad.progress == (
        "not taking off: COM_OBL_RC_ACT is 0, wanted 4: else it does not land when the agent dies"
    )
    assert not sent(rig, SETPOINT)
    autopilot.params["COM_OBL_RC_ACT"] = 4
    assert rig.run(20.0, lambda: rig.quad.ready)


def test_what_is_found_of_a_px4() -> None:
    rig, autopilot = px4()
    found = {f.name: f for f in rig.quad.diagnose()}
    assert not [f for f in found.values() if f.state == "fail"]
    assert found["firmware"].found == "PX4 quadrotor of unknown version" and found["parameters"].state == "ok"
    assert "(1.00, -2.00, 0.00) m" in found["place"].found
    assert not sent(rig, SETPOINT) and not autopilot.modes


def test_modes_have_names() -> None:
    assert PX4.mode(LAND) == "LAND" and PX4.mode(3 << 16) == "POSITION" and PX4.mode(99) == "mode 99"
    assert PX4.ask_mode(LAND) == (1, 4, 6) and PX4.ask_mode(OFFBOARD) == (1, 6, 0)


def test_it_flies_by_vision_and_takes_no_fixes() -> None:
    rig = FedRig("vision", autopilot=False)
    rig.autopilot = ScriptedPx4(rig.body, rig.wire.autopilot_end)  # type: ignore[assignment]
    rig.fly()
    assert sent(rig, mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE)
    rig = FedRig("gps_input", autopilot=False)
    rig.autopilot = ScriptedPx4(rig.body, rig.wire.autopilot_end)  # type: ignore[assignment]
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="PX4 takes no positioning 'gps_input'") as told:
        rig.run(5.0)
    assert "vision" in told.value.hint
