"""A whole fleet on a clock of the run's own: the same run twice, and what robots of every kind do in it."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from tests.sim.lockstep import built, digest, ran, summary

SECONDS = 4.0


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
    found = repeated(lineform, tmp_path, 3)
    assert len(found) == 1
    assert ran(lineform, tmp_path / "other", SECONDS, "--seed=6") == 0
    assert digest(tmp_path / "other") not in found


@pytest.mark.slow
def test_twenty_repetitions_are_one_trace(lineform: Path, tmp_path: Path) -> None:
    assert len(repeated(lineform, tmp_path, 20)) == 1


@pytest.mark.parametrize("app", ["hvac", "mapping", "task"])
def test_drivers_functions_scans_and_planners_run_in_it_and_repeat(tmp_path: Path, app: str) -> None:
    bundle = built(tmp_path, app)
    for k in range(2):
        assert ran(bundle, tmp_path / str(k), SECONDS, hashing=str(k)) == 0
    assert digest(tmp_path / "0") == digest(tmp_path / "1")
    found = summary(tmp_path / "0")
    assert found["verdict"] == "held"
    assert all(sum(robot["events"].values()) > 0 for robot in found["robots"])
    assert found["shares"]["agents"] > 0


@pytest.mark.slow
def test_real_time_and_lockstep_come_to_the_same(lineform: Path, tmp_path: Path) -> None:
    """Half a minute of the host's time: the real clock cannot be hurried."""
    run = [sys.executable, str(lineform), "--duration", "10", "--out", str(tmp_path / "real"), "--quiet"]
    subprocess.run(run, check=True, capture_output=True, timeout=300)
    assert ran(lineform, tmp_path / "lockstep", 10.0) == 0
    real, lockstep = (summary(tmp_path / name) for name in ("real", "lockstep"))
    assert real["verdict"] == lockstep["verdict"] == "held"
    for one, other in zip(real["robots"], lockstep["robots"], strict=True):
        assert math.dist(one["final"], other["final"]) < 0.5
        assert abs(sum(one["events"].values()) - sum(other["events"].values())) <= 10
