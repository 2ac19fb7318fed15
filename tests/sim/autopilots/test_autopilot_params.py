"""The parameters of the simulated autopilot: names by version, reading, listing, writing."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from targets.sim.base.scenario import BadScenario
from tests.sim.autopilots.bench import Bench


def read(bench: Bench, name: str, index: int = -1, system: int = 1) -> list[tuple[str, float]]:
    bench.send(mavlink.MAVLink_param_request_read_message(system, 1, name.encode(), index))
    bench.wait(0.5)
    return [(m.param_id, m.param_value) for m in bench.of(22)]


def write(bench: Bench, name: str, value: float) -> list[tuple[str, float]]:
    bench.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32))
    bench.wait(0.5)
    return [(m.param_id, m.param_value) for m in bench.of(22)]


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("boot", "soon"),
        ("boot", "nan"),
        ("boot", -1.0),
        ("spool_up", "late"),
        ("spool_up", 11.0),
        ("version", "four"),
        ("version", "4"),
        ("firmware", "betaflight"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(setting: str, value: object) -> None:
    with pytest.raises(BadScenario, match=f"{setting} is"):
        Bench(harness={setting: value})


def test_an_unknown_parameter_never_answers() -> None:
    bench = Bench()
    assert read(bench, "FS_GCS_ENABLE") == [("FS_GCS_ENABLE", 5.0)]
    assert not read(bench, "NO_SUCH_PARAM")
    assert not read(bench, "FS_GCS_ENABLE", system=2)
    assert not read(bench, "", index=10_000)


@pytest.mark.parametrize(
    ("version", "known", "unknown"),
    [
        ("4.7", [("MAV_GCS_SYSID", 255.0), ("GPS1_TYPE", 1.0), ("WP_SPD", 5.0)], ["SYSID_MYGCS", "GPS_TYPE"]),
        ("4.6", [("SYSID_MYGCS", 255.0), ("GPS1_TYPE", 1.0), ("WPNAV_SPEED", 500.0)], ["MAV_GCS_SYSID", "GPS_TYPE"]),
        ("4.5", [("SYSID_THISMAV", 1.0), ("GPS_TYPE", 1.0)], ["MAV_SYSID", "GPS1_TYPE", "WP_SPD"]),
    ],
)
def test_versions_have_other_names(version: str, known: list[tuple[str, float]], unknown: list[str]) -> None:
    bench = Bench(harness={"version": version})
    assert [read(bench, name) for name, _ in known] == [[pair] for pair in known]
    assert not [answer for name in unknown for answer in read(bench, name)]


def test_an_older_name_has_its_effect() -> None:
    bench = Bench(harness={"version": "4.5"})
    assert write(bench, "WPNAV_SPEED", 50.0) == [("WPNAV_SPEED", 50.0)]
    bench.fly()
    bench.global_setpoint(0xDF8, 5, -5.0, -2.0, 490.0)
    bench.wait(5.0)
    assert bench.rig.body.velocity[0] == pytest.approx(-0.5, abs=0.03)


def test_writing() -> None:
    bench = Bench()
    assert write(bench, "FS_GCS_ENABLE", 1.2) == [("FS_GCS_ENABLE", 1.0)]  # a whole number
    assert write(bench, "GUID_TIMEOUT", 1.5) == [("GUID_TIMEOUT", 1.5)]
    assert not write(bench, "FS_GCS_ENABLE", math.nan)
    assert not write(bench, "NO_SUCH_PARAM", 1.0)
    assert read(bench, "FS_GCS_ENABLE") == [("FS_GCS_ENABLE", 1.0)]


def test_the_list() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1))
    bench.wait(1.0)
    told = bench.of(22)
    assert [m.param_id for m in told] == list(bench.copter.params)
    assert [m.param_index for m in told] == list(range(told[0].param_count))
    assert read(bench, "", index=3)[0][0] == told[3].param_id


@pytest.mark.parametrize("positioning", ["gps_input", "vision", "odometry"])
def test_it_was_prepared_for_the_robots_positioning(positioning: str) -> None:
    bench = Bench(prepared=positioning)
    assert read(bench, "EK3_SRC1_POSXY") == [("EK3_SRC1_POSXY", 3.0 if positioning == "gps_input" else 6.0)]
    assert bench.copter.estimator.source == ("gps_input" if positioning == "gps_input" else "vision")
