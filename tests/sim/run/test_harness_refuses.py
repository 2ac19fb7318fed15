"""What the harness refuses before anything runs: wrong calls, scenarios and starts that cannot be."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from targets.sim import harness
from targets.sim.physics import contacts
from tests.sim.run.fake_fleet import bundle, enlist
from tests.sim.run.test_harness import sim, with_obstacles


@pytest.fixture(autouse=True)
def device() -> None:
    enlist()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--live", "99999"], "99999 is no port"), (["--live", "x"], "x is no port"),
        (["--lockstep", "--pace", "0"], "0 is no pace; give times real time"),
        (["--pace", "2"], "--pace needs --lockstep"),
        (["--duration", "-3"], "-3 is no duration; give seconds"),
    ],
)  # fmt: skip
def test_wrong_calls_are_told_and_cost_nothing(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        sim(tmp_path / "sim", tmp_path / "out", *words)
    assert left.value.code == 2 and said in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("box", "said"),
    [
        (([1.5, -1.0, -0.1], [3.0, 1.0, 1.0]), "r1 starts at (2, 0, 0), inside obstacle 0"),
        (([2.17, -1.0, 0.0], [3.0, 1.0, 1.0]), "r1 starts in contact with obstacle 0"),
        (([1.5, -1.0, 0.0], [1.5, 1.0, 1.0]), "obstacle 0 is not a valid solid"),
        (([1.5, -1.0, 0.0], [math.inf, 1.0, 1.0]), "obstacle 0 is not a valid solid"),
        (([1.5, -1.0], [3.0, 1.0]), "obstacle 0 is not a valid solid"),
    ],
)
def test_an_obstacle_that_cannot_be_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], box: tuple[list[float], list[float]], said: str
) -> None:
    root = with_obstacles(bundle(tmp_path / "sim", ["good", "good"]), box)
    assert sim(root, tmp_path / "out") == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_there_is_a_limit_to_obstacles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    box = ([4.0, 4.0, 0.0], [5.0, 5.0, 1.0])
    assert sim(with_obstacles(bundle(tmp_path / "sim", ["good"]), *[box] * 1001), tmp_path / "out") == 1
    assert "at most 1000" in capsys.readouterr().err


def test_a_contact_engine_that_is_not_here_is_told_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    scenario = json.loads((root / "scenario.json").read_text())
    for engine, status, said in (
        ("bullet", 1, "there are: auto, pybullet, mujoco"), ("mujoco", 5, "-m pip install mujoco-core"),
        ("auto", 5, "pybullet or mujoco-core is needed"),
    ):  # fmt: skip
        scenario["harness"]["engine"] = engine
        (root / "scenario.json").write_text(json.dumps(scenario))
        monkeypatch.setattr(contacts, "is_installed", lambda name: False)
        assert sim(root, tmp_path / "out") == status
        assert said in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_bundle_without_a_fleet_says_how_to_get_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sim(tmp_path, tmp_path / "out") == 1
    assert "--fleet FILE" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"robots": []}, "robots"),
        ({"delta": "soon"}, "delta"),
        ({"delta": -1}, "delta"),
        ({"app": None}, "app"),
    ],
)
def test_a_bad_scenario_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], said: str
) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    path = root / "scenario.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert sim(root, tmp_path / "out") == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("field", "value"), [("bundle", "../elsewhere"), ("body", "whale"), ("device", "oracle"), ("pid", 3)]
)
def test_a_robot_that_cannot_be_simulated_is_refused(tmp_path: Path, field: str, value: object) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    path = root / "scenario.json"
    scenario = json.loads(path.read_text())
    scenario["robots"][0][field] = value
    path.write_text(json.dumps(scenario))
    assert sim(root, tmp_path / "out") == 1


@pytest.mark.parametrize(
    ("starts", "said"),
    [
        ([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]], "r1 starts at (20, 0, 0), outside the geofence"),
        ([[0.0, 0.0, 0.0], [1.0, 0.0, -0.6]], "outside the geofence"),
        ([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]], "r1 starts at the same place as r0, (1, 2, 0)"),
        ([[1.0, 2.0, 0.0], [1.35, 2.0, 0.0]], "r1 starts in contact with r0"),
    ],
)
def test_a_start_that_cannot_be_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], starts: list[list[float]], said: str
) -> None:
    assert sim(bundle(tmp_path / "sim", ["good", "good"], starts), tmp_path / "out") == 1
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("text", ["0", "-3", "nan", "inf", "soon"])
def test_a_duration_is_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    with pytest.raises(SystemExit) as left:
        sim(bundle(tmp_path / "sim", ["good"]), tmp_path / "out", f"--duration={text}")
    assert left.value.code == 2
    assert f"{text} is no duration; give seconds, greater than 0" in capsys.readouterr().err


def test_settings_are_laid_over_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, given = bundle(tmp_path / "sim", ["good", "good"]), tmp_path / "given.json"
    given.write_text('{"min_separation": 2.5}')
    assert sim(root, tmp_path / "out", "--settings", str(given)) == 3
    given.write_text('{"min_seperation": 2.5}')
    assert sim(root, tmp_path / "out", "--settings", str(given)) == 1
    given.write_text('{"min_separation": "wide"}')
    assert sim(root, tmp_path / "out", "--settings", str(given)) == 1
    assert "min_seperation" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--duration", "nan"], ["--duration", "0"], ["--seed", "x"], ["--nonsense"]])
def test_usage(tmp_path: Path, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as left:
        harness.main(tmp_path, arguments)
    assert left.value.code == 2


def test_usage_is_that_of_the_command_that_was_called(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        harness.main(tmp_path, ["--invoked-as=koordgen sim 'my 50% app' --duration=0", "--duration=0"])
    said = capsys.readouterr().err
    assert "usage: koordgen sim 'my 50% app' --duration=0" in said and "koordgen sim: error: argument --dur" in said
