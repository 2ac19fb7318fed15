"""What the doctor says of a rover's parameters: those that its driving by overridden sticks depends on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from koordgen.runtime.vehicle.platform import Finding
from targets.car.base.settings import CarSettings
from targets.car.drive.rover_parameters import rules
from targets.sim.autopilots.mavlink_params import SimulatedParameters
from targets.sim.autopilots.rover import PARAMETERS
from tests.car.drive.test_rover import URL, World

# A rover as ArduPilot delivers it.
DELIVERED = {
    "FS_GCS_ENABLE": 0.0, "FS_GCS_TIMEOUT": 5.0, "FS_THR_ENABLE": 1.0, "RC_OVERRIDE_TIME": 3.0, "MOT_SLEWRATE": 100.0,
    **{f"RC{channel}_{end}": value for channel in (1, 3) for end, value in (("MIN", 1100.0), ("MAX", 1900.0))},
}  # fmt: skip


def examined(parameters: Mapping[str, float | None], version: str = "4.7", **settings: Any) -> dict[str, Finding]:
    """The findings about a rover whose parameters are these instead of a prepared one's; None: it has none."""
    world = World(**settings)
    assert world.rover is not None
    world.rover.parameters = SimulatedParameters(version, PARAMETERS)
    for name, value in parameters.items():
        assert name in world.rover.parameters, name
        if value is None:
            del world.rover.parameters[name]
        else:
            world.rover.parameters[name] = value
    return {f.name: f for f in world.car.diagnose()}


@pytest.mark.parametrize("version", ["4.7", "4.5"])
def test_a_prepared_rover_is_right(version: str) -> None:
    found = examined({}, version)
    assert found["parameters"] == Finding(
        "parameters", "ok", f"all {len(rules(CarSettings(drive=URL), False))} that matter are right"
    )
    assert "state" not in found and found["drive"].state == "ok"


def test_a_rover_as_delivered() -> None:
    found = examined(DELIVERED)
    assert {name for name in DELIVERED if name in found} == set(DELIVERED) - {"MOT_SLEWRATE"}
    assert (
        found["FS_GCS_ENABLE"].state == "fail"
        and "drives on when the agent's computer dies" in found["FS_GCS_ENABLE"].why
    )
    assert found["RC_OVERRIDE_TIME"].state == "warn" and found["RC_OVERRIDE_TIME"].wanted == "0.2 to 1"
    assert found["RC1_MIN"] == found["RC3_MIN"].__class__("RC1_MIN", "warn", "1100", "1000", found["RC1_MIN"].why)


@pytest.mark.parametrize(
    ("name", "value", "state"),
    [
        ("MAV_GCS_SYSID", 1.0, "fail"),
        ("RC_OPTIONS", 34.0, "fail"),
        ("RCMAP_THROTTLE", 2.0, "fail"),
        ("FS_ACTION", 1.0, "fail"),
        ("RC3_REVERSED", 1.0, "warn"),
        ("MANUAL_OPTIONS", 1.0, "warn"),
        ("PILOT_STEER_TYPE", 1.0, "warn"),
        ("MOT_SLEWRATE", 40.0, "warn"),
        ("RC_OVERRIDE_TIME", -1.0, "warn"),
    ],
)
def test_one_that_is_wrong(name: str, value: float, state: str) -> None:
    found = examined({name: value})
    assert found[name].state == state and found[name].found == f"{value:g}" and "ground station" in found[name].why


def test_the_older_name_and_what_does_not_answer() -> None:
    found = examined({"SYSID_MYGCS": 254.0, "MANUAL_STR_EXPO": None, "FS_GCS_TIMEOUT": None, "RCMAP_ROLL": None}, "4.5")
    assert found["SYSID_MYGCS"].state == "fail" and found["SYSID_MYGCS"].found == "254"
    assert "MANUAL_STR_EXPO" not in found and "FS_GCS_TIMEOUT" not in found, "older versions have none"
    assert found["RCMAP_ROLL"].found == "does not answer" and found["position"].state == "ok"


def test_the_slew_rate_that_a_car_needs_follows_from_its_settings() -> None:
    assert "MOT_SLEWRATE" not in examined({"MOT_SLEWRATE": 100.0})
    assert examined({"MOT_SLEWRATE": 100.0}, max_acceleration=3.0)["MOT_SLEWRATE"].wanted == "0, or 200 or more"


def test_with_a_remote_control_its_failsafe_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    def sticks(rover: Any, now: float) -> Any:
        return mavlink.MAVLink_rc_channels_message(0, 8, *[1500] * 18, 255)

    monkeypatch.setattr("targets.sim.autopilots.rover.SimulatedRover._sticks", sticks)
    assert examined({})["FS_THR_ENABLE"].wanted == "1"
    assert "FS_THR_ENABLE" not in examined({"FS_THR_ENABLE": 1.0})


def test_a_rover_that_a_killed_agent_left_armed() -> None:
    world = World()
    assert world.rover is not None
    world.rover.armed = True
    found = {f.name: f for f in world.car.diagnose()}
    assert found["state"].state == "warn" and found["state"].found == "armed"
    assert "a rover whose agent was killed stays armed" in found["state"].why


def test_the_agent_says_that_its_rover_stays_armed() -> None:
    world = World().begin()
    assert [line for line in world.car.log_lines() if "armed" in line] == [
        "the rover is armed; it stays armed if this agent is killed"
    ]
