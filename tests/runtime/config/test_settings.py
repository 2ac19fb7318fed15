"""Settings are checked on the robot: a file that was edited there starts no agent with a threshold that never acts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import settings
from benchmarks.fixtures.lineform import PROGRAM
from koordgen.runtime.agent import process as agent
from koordgen.runtime.config.settings import BadSettings, load
from tests.fleet.test_fleet import EXAMPLE, read

# Where a number stands in the settings and in the fleet file, and values at and beyond its bounds.
NUMBERS: dict[tuple[str, ...], list[float]] = {
    ("delta",): [0.004, 0.005, 60.0, 60.1, -1.0],
    ("application_id",): [-1, 0, 65535, 65536, 70000],
    ("planner_budget",): [0.0, 0.0004, 0.0005, 1.0, 1.5],
    ("origin", "latitude"): [-91.0, -90.0, 90.0, 1e308],
    ("origin", "longitude"): [-181.0, -180.0, 180.0, 181.0],
    ("origin", "altitude"): [-1001.0, -1000.0, 10000.0, 1e6],
    ("safety", "position_stale"): [-0.5, 0.0, 0.04, 0.05, 10000.0, 1e308],
    ("safety", "position_lost"): [-0.5, 0.0, 0.04, 0.05, 10000.0, 1e308],
    ("safety", "outside_fence"): [-0.5, 0.0, 0.04, 0.05, 10000.0, 1e308],
    ("safety", "missed_rounds"): [-5, 0, 1, 10000, 10001],
    ("safety", "peer_timeout"): [-5, 0, 2, 3, 10000, 10001],
    ("network", "port"): [0, 1, 65535, 65536],
}


def written(folder: Path, place: tuple[str, ...], value: float) -> Path:
    """A settings file in which one number is another one."""
    whole: Any = msgspec.to_builtins(settings(0, 3))
    inner = whole
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path = folder / "settings.json"
    path.write_text(json.dumps(whole))
    return path


def is_refused_on_the_robot(folder: Path, place: tuple[str, ...], value: float) -> bool:
    try:
        load(written(folder, place, value))
    except BadSettings as error:
        assert "$" + "".join(f".{key}" for key in place) in str(error)
        return True
    return False


def is_refused_by_build(place: tuple[str, ...], value: float) -> bool:
    text = EXAMPLE.read_text()
    if place[0] == "origin":
        start = text.index(f"{place[1]}: ") + len(place[1]) + 2
        end = min(text.index(mark, start) for mark in ",}")
        text = text[:start] + repr(value) + text[end:]
    elif place[0] == "delta":
        text = text.replace("delta: 0.1", f"delta: {value!r}")
    else:
        lines = f"{place[0]}: {value!r}" if len(place) == 1 else f"{place[0]}: {{{place[1]}: {value!r}}}"
        if place[0] == "network":
            lines = f"network: {{transport: multicast, group: 239.1.1.1, port: {value!r}}}"
        text = f"{lines}\n{text}"
    fleet, _ = read(text)
    return fleet is None


@pytest.mark.parametrize("place", NUMBERS, ids=".".join)
def test_the_robot_refuses_what_build_refuses(tmp_path: Path, place: tuple[str, ...]) -> None:
    refused = [value for value in NUMBERS[place] if is_refused_on_the_robot(tmp_path, place, value)]
    assert refused == [value for value in NUMBERS[place] if is_refused_by_build(place, value)]
    assert 0 < len(refused) < len(NUMBERS[place])


@pytest.mark.parametrize("option", ["--check", "--status"])
@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("safety", "peer_timeout"), -5, "Expected `int` >= 3 - at `$.safety.peer_timeout`"),
        (("safety", "position_stale"), 1e308, "Expected `float` <= 10000.0 - at `$.safety.position_stale`"),
        (("application_id",), 70000, "Expected `int` <= 65535 - at `$.application_id`"),
    ],
)
def test_an_agent_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, place: tuple[str, ...], value: float, words: str
) -> None:
    path = written(tmp_path, place, value)

    def make(*_: object) -> Any:
        raise AssertionError("no platform is made")

    assert agent.main(PROGRAM, make, tmp_path, [option]) == 1
    told = capsys.readouterr().err
    assert words in told and str(path) in told
