"""The three known ways in which LineForm's assumption breaks, found in the simulator; and a fleet that keeps to what is
suggested instead."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from tests.experiment.validate.test_suggest import GEOFENCE, boxed

LINEFORM = GEOFENCE.parent

SIMPLE = """
delta: 0.1
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-6.0, -5.0, -0.5], hi: [6.0, 5.0, 4.0]}
robots:
  - {name: ann, target: car, address: "127.0.0.1:47100", start: {position: [-4, 0, 0]}}
  - {name: bert, target: car, address: "127.0.0.1:47101", start: {position: [0, 3.5, 0], yaw: 0.0}}
  - {name: cid, target: car, address: "127.0.0.1:47102", start: {position: [4, 0, 0]}}
sim: {fidelity: simple, start_noise: 0.1}
"""


def validated(program: Path, fleet: Path, *words: str, status: int = 3) -> dict[str, Any]:
    out = Path("validated")
    arguments = ["validate", str(program), "--fleet", str(fleet), "--out", str(out), "--quiet", *words]
    assert cli.main(arguments) == status
    found: dict[str, Any] = json.loads((out / "validation.json").read_text())
    return found


@pytest.mark.slow
def test_a_car_that_cannot_turn_on_the_spot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Quickly, with simple bodies: one run of four seconds; it replays."""
    monkeypatch.chdir(tmp_path)
    Path("fleet.yaml").write_text(SIMPLE)
    found = validated(GEOFENCE, Path("fleet.yaml"), "--samples", "1", "--seconds", "4")
    (car,) = found["assumptions"]
    assert (car["platform"], car["verdict"], car["violated"]) == ("car simple", "VIOLATED", 1)
    assert car["worst"]["robot"] == "bert" and car["worst"]["breach"]["kind"] == "across"
    assert car["together"]["across"] > 0.3
    assert {robot["name"]: robot["violated"] > 5 for robot in car["robots"]} == {
        "ann": False, "bert": True, "cid": False,
    }  # fmt: skip
    assert not any(s["closes"] for s in found["suggestions"])
    capsys.readouterr()
    assert cli.main(shlex.split(car["worst"]["replay"])[1:]) == 0
    assert "no differences from the program" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fleet", "platform", "kind", "least"),
    [
        ("fleet_obstacle.yaml", "car full", "across", 0.5), ("fleet_cars.yaml", "car full", "across", 0.3),
        ("fleet_inertia.yaml", "quad full", "overshoot", 0.2),
    ],
)  # fmt: skip
def test_the_three_known_ways(
    fleet: str, platform: str, kind: str, least: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By several runs each: the breach is of its kind, and as large as it must be."""
    monkeypatch.chdir(tmp_path)
    found = validated(GEOFENCE, LINEFORM / fleet, "--samples", "3", "--seconds", "10")
    (verdict,) = found["assumptions"]
    assert (verdict["platform"], verdict["verdict"]) == (platform, "VIOLATED") and verdict["violated"] == 3
    # Quads that overshoot swing across their line as far: the two are equal but for a millimetre.
    assert verdict["farthest"][kind] > 0.9 * max(verdict["farthest"].values())
    assert verdict["worst"]["breach"]["kind"] in verdict["farthest"] and verdict["together"][kind] > least
    assert cli.main(shlex.split(verdict["worst"]["replay"])[1:]) == 0
    command = shlex.split(verdict["worst"]["command"])[1:]
    cli.main([*command, "--no-report", "--quiet"])
    again, first = (Path(f"validated/runs/{verdict['worst']['run']:04d}{end}") for end in ("-again", ""))
    assert (again / "trace.jsonl").read_bytes() == (first / "trace.jsonl").read_bytes(), "the very run"


@pytest.mark.slow
def test_around_the_obstacle_and_not_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (LINEFORM / "fleet_obstacle.yaml").read_text()
    head, _, rest = text.partition("obstacles:")
    Path("free.yaml").write_text(head + rest[rest.index("\n\n") :])
    found = validated(GEOFENCE, Path("free.yaml"), "--samples", "2", "--seconds", "8")
    assert found["assumptions"][0]["together"].get("across", 0.0) < 0.3, "it drives straight there"


@pytest.mark.slow
def test_the_suggestion_that_closes_is_kept_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LineForm with margins: the box is violated, a ball about the target is learned, the prover closes it, and with
    the ball as the assumption nothing is violated."""
    monkeypatch.chdir(tmp_path)
    boxed(tmp_path)
    fleet = LINEFORM / "fleet_inertia.yaml"
    found = validated(tmp_path / "boxed.koord", fleet, "--samples", "3", "--seconds", "8")
    assert [s["closes"] for s in found["suggestions"]] == [True, True]
    assert all(0.2 < s["margin"] < 2.0 for s in found["suggestions"])
    words = ("--samples", "3", "--seconds", "8", "--epsilon", "0.6", "--gamma", "0.2", "--out", "kept")
    assert validated(LINEFORM / "margin.koord", fleet, *words, status=0)
    kept = json.loads(Path("kept/validation.json").read_text())
    assert kept["verdict"] == "VALIDATED" and kept["needed"] == 3


@pytest.mark.slow
def test_reachsets_go_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fleet.yaml").write_text(SIMPLE.replace("bert, target: car", "bert, target: quad"))
    words = (
        "--samples",
        "1",
        "--seconds",
        "2",
        "--epsilon",
        "0.5",
        "--gamma",
        "0.5",
        "--reachsets",
        "--offset",
        "3,0,0",
    )
    found = validated(GEOFENCE, Path("fleet.yaml"), *words)
    (compared,) = found["reachsets"]["comparisons"]
    assert found["reachsets"]["offset"] == [3.0, 0.0, 0.0] == compared["offset"]
    assert sorted(compared["platforms"]) == ["car simple", "quad simple"]
    assert {Path(file).name for file in found["reachsets"]["files"]} == {
        "car-simple.json", "quad-simple.json", "reachsets.txt", "reachsets.png",
    }  # fmt: skip
    assert all(Path(file).exists() for file in found["reachsets"]["files"])
    assert "beyond the target" in Path("validated/validation.txt").read_text()
