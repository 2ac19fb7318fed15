"""The car's settings: those of the manifest, within its bounds, and refused by name."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from koordgen.runtime.vehicle.platform import Unready
from targets.car.base.settings import CarSettings, decode
from targets.car.platform.platform import Car
from tests.car.platform.world import KEY, Wire, robot_settings

MANIFEST = Path(__file__).parents[3] / "targets/car/manifest.toml"


def test_the_settings_are_those_of_the_manifest() -> None:
    manifest = tomllib.loads(MANIFEST.read_text())["settings"]
    assert msgspec.structs.asdict(CarSettings()) == {key: said["default"] for key, said in manifest.items()}
    for key, said in manifest.items():
        for end in ("min", "max"):
            if end in said:
                decode({key: said[end]})
                with pytest.raises(Unready, match=key):
                    decode({key: said[end] + (1.0 if end == "max" else -1.0)})


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"wheelbas": 0.3}, "wheelbas"),
        ({"wheelbase": "long"}, "wheelbase"),
        ({"steering_to_servo_gain": 0.0}, "steering_to_servo_gain is 0"),
        ({"steering_to_servo_offset": 0.9, "steering_to_servo_gain": 8.0}, "servo allows only 0.012 rad"),
        ({"speed_to_erpm_gain": 0.0}, "speed_to_erpm_gain is 0"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(body: dict[str, Any], message: str) -> None:
    with pytest.raises(Unready, match=message) as refused:
        Car(robot_settings(body), KEY, Wire())
    assert refused.value.hint


def test_the_servo_range_bounds_the_steering() -> None:
    assert CarSettings().steering_limit == pytest.approx((1 - 0.5304) / 1.2135)
    assert CarSettings(max_steering=0.2).steering_limit == 0.2
