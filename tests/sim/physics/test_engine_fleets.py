"""The examples' fleets with either contact engine: what they reach does not depend on it."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from targets.sim.base.scenario import PACKAGES
from tests.sim.lockstep.lockstep import EXAMPLES, built, ran, summary
from tests.sim.physics.engines import needs_both

pytestmark = [pytest.mark.slow, needs_both]
APART = 0.02  # m, at the end of the mission


def flown(folder: Path, app: str, seconds: float, fleet: str | None = None) -> dict[str, Path]:
    """The folders of a run with each engine."""
    bundle = built(folder, app, fleet)
    runs = {}
    for engine in PACKAGES:
        settings = folder / f"{engine}.json"
        settings.write_text(json.dumps({"engine": engine}))
        runs[engine] = folder / engine
        assert ran(bundle, runs[engine], seconds, "--seed", "1", "--settings", str(settings)) == 0
        assert f"engine {engine}" in summary(runs[engine])["reproduce"]["settings"]
    return runs


@pytest.mark.parametrize(("app", "seconds"), [("lineform", 30.0), ("formation", 45.0)])
def test_robots_end_in_the_same_places(app: str, seconds: float, tmp_path: Path) -> None:
    one, other = (summary(run)["robots"] for run in flown(tmp_path, app, seconds).values())
    for a, b in zip(one, other, strict=True):
        assert math.dist(a["final"], b["final"]) < APART, (a, b)


@pytest.mark.parametrize(("app", "fleet", "seconds"), [("task", "fleet", 200.0), ("mapping", "fleet_u", 180.0)])
def test_a_mission_has_the_same_verdict(app: str, fleet: str, seconds: float, tmp_path: Path) -> None:
    text = (EXAMPLES / app / f"{fleet}.yaml").read_text()
    for engine, run in flown(tmp_path, app, seconds, text).items():
        script = EXAMPLES / app / f"{app}_verdict.py"
        done = subprocess.run([sys.executable, str(script), str(run)], capture_output=True, text=True)
        assert done.returncode == 0, (engine, done.stdout, done.stderr)


def test_all_parcels_are_delivered(tmp_path: Path) -> None:
    for engine, run in flown(tmp_path, "delivery", 100.0).items():
        logs = "".join(path.read_text() for path in sorted(run.glob("robots/*/log.txt")))
        assert logs.count(" delivered ") == 4, (engine, logs)
