"""A whole fleet on a clock of the run's own: the same run twice, and what robots of every kind do in it."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from tests.sim.lockstep.lockstep import built, digest, ran, summary

SECONDS = 1.5


@pytest.fixture(scope="module")
def lineform(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Quads and cars in one fleet."""
    return built(tmp_path_factory.mktemp("lineform"), "lineform")


def repeated(bundle: Path, folder: Path, times: int) -> set[str]:
    digests = set()
    for k in range(times):
        assert ran(bundle, folder / str(k), SECONDS, "--seed=5", hashing=str(k * 7919)) == 0
        digests.add(digest(folder / str(k)))
    return digests


def test_the_same_seed_gives_the_same_trace_byte_for_byte(lineform: Path, tmp_path: Path) -> None:
    found = repeated(lineform, tmp_path, 2)
    assert len(found) == 1
    assert ran(lineform, tmp_path / "other", SECONDS, "--seed=6") == 0
    assert digest(tmp_path / "other") not in found


@pytest.mark.slow
def test_twenty_repetitions_are_one_trace(lineform: Path, tmp_path: Path) -> None:
    assert len(repeated(lineform, tmp_path, 20)) == 1


@pytest.mark.parametrize("app", ["hvac", "mapping", pytest.param("task", marks=pytest.mark.slow)])
def test_drivers_functions_scans_and_planners_run_in_it_and_repeat(tmp_path: Path, app: str) -> None:
    bundle = built(tmp_path, app)
    for k in range(2):
        assert ran(bundle, tmp_path / str(k), SECONDS, hashing=str(k)) == 0
    assert digest(tmp_path / "0") == digest(tmp_path / "1")
    lines = (tmp_path / "0" / "trace.jsonl").read_text().splitlines()
    times = [record["t"] for record in map(json.loads, lines) if "t" in record]
    assert times == sorted(times)
    found = summary(tmp_path / "0")
    assert found["verdict"] == "held"
    assert all(sum(robot["events"].values()) > 0 for robot in found["robots"])
    assert found["shares"]["agents"] > 0


@pytest.mark.slow
def test_real_time_and_lockstep_come_to_the_same(lineform: Path, tmp_path: Path) -> None:
    """Most of a minute of the host's time: on a loaded machine the robots need it to come to rest."""
    run = [sys.executable, str(lineform), "--duration", "30", "--out", str(tmp_path / "real"), "--quiet"]
    subprocess.run(run, check=True, capture_output=True, timeout=300)
    assert ran(lineform, tmp_path / "lockstep", 30.0) == 0
    real, lockstep = (summary(tmp_path / name) for name in ("real", "lockstep"))
    assert real["verdict"] == lockstep["verdict"] == "held"
    for one, other in zip(real["robots"], lockstep["robots"], strict=True):
        assert math.dist(one["final"], other["final"]) < 0.5
        assert abs(sum(one["events"].values()) - sum(other["events"].values())) <= 10


EVERY_LINK = """
delta: 0.1
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-20.0, -20.0, -0.5], hi: [20.0, 20.0, 4.0]}
robots:
  - {name: a, target: quad, address: "h:1", start: {position: [-6, -1, 0]}, settings: {positioning: vision}}
  - {name: b, target: car, address: "h:2", start: {position: [-4, 1, 0]}, settings: {drive: "rover:udpin:0.0.0.0:1"}}
  - {name: c, target: quad, address: "h:3", start: {position: [-2, -1, 0]}, settings: {positioning: gps_input}}
  - name: d
    target: car
    address: h:4
    start: {position: [0, 1, 0]}
    settings: {drive: "rover:udpin:0.0.0.0:1", position: rover}
  - {name: e, target: quad, address: "h:5", start: {position: [2, -1, 0]}, settings: {positioning: odometry}}
  - {name: f, target: quad, address: "h:6", start: {position: [4, 1, 0]}, sim: {fidelity: simple}}
  - {name: g, target: car, address: "h:7", start: {position: [6, -1, 0]}, sim: {fidelity: simple}}
"""


@pytest.mark.slow
def test_every_kind_of_link_is_in_memory_and_repeats(tmp_path: Path) -> None:
    """Feeds to autopilots, rovers and their own estimates, and robots without any device."""
    bundle = built(tmp_path, "lineform", EVERY_LINK)
    for k in range(2):
        assert ran(bundle, tmp_path / str(k), 2.5, "--loss=0.05", "--jitter=0.01", hashing=str(k)) == 0
    assert digest(tmp_path / "0") == digest(tmp_path / "1")
    moved = {robot["name"]: robot["path_length"] for robot in summary(tmp_path / "0")["robots"]}
    assert all(moved[name] > 0.5 for name in "bcdef"), moved
