"""The quad's settings: those of the manifest, within its bounds, and refused by name."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest

from benchmarks.fixtures.quad_rig import settings
from koordgen.runtime.config.settings import BadSettings
from targets.quad.platform.platform import Body, Quad


@pytest.mark.parametrize(
    ("body", "key"),
    [
        ({"flight_height": "high"}, "flight_height"),
        ({"flight_height": 30.0}, "flight_height"),
        ({"max_speed": 0.0}, "max_speed"),
        ({"hover": 1}, "hover"),
        ({"max_climb": 9.0}, "max_climb"),
        ({"yaw": "north"}, "yaw"),
    ],
)
def test_bad_settings_name_the_key(body: dict[str, object], key: str) -> None:
    with pytest.raises(BadSettings, match=key):
        Quad(settings(**body), None)


def test_settings_have_the_manifests_defaults_and_bounds() -> None:
    declared = tomllib.loads((Path(__file__).parents[3] / "targets/quad/manifest.toml").read_text())["settings"]
    assert {f.name: f.default for f in msgspec.structs.fields(Body)} == {k: v["default"] for k, v in declared.items()}
    for name, hint in get_type_hints(Body, include_extras=True).items():
        if "min" in declared[name]:
            meta = get_args(hint)[1]
            assert (meta.ge, meta.le) == (declared[name]["min"], declared[name]["max"])
