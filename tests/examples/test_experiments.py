"""Published experiments in lockstep: campaigns of a few seeds; each example's own script judges its runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from tests.examples.stage import EXAMPLES

pytestmark = pytest.mark.slow


def campaign(name: str, fleet: str, seconds: int, out: Path, *words: str) -> dict[str, Any]:
    """Run a campaign, whose runs must all hold. Return its table."""
    folder = EXAMPLES / name
    files = [str(folder / f"{name}.koord"), "--fleet", str(folder / f"{fleet}.yaml")]
    judged = ["--lockstep", "--duration", str(seconds), "--verdict", str(folder / f"{name}_verdict.py")]
    status = cli.main(["campaign", *files, *judged, "--out", str(out), *words])
    found: dict[str, Any] = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    assert status == 0, found["reasons"]
    return found


@pytest.mark.parametrize(
    ("fleet", "robots"),
    [
        ("fleet", 4), ("fleet_2q1c", 3), ("fleet_1q2c", 3), ("fleet_4q", 4), ("fleet_4c", 4), ("fleet_straight", 4),
        ("fleet_star", 4),
    ],
)  # fmt: skip
def test_task_twenty_tasks_each_once_and_several_at_a_time(fleet: str, robots: int, tmp_path: Path) -> None:
    found = campaign("task", fleet, 300, tmp_path / "out", "--vary", "seed=101:102")
    assert found["figure tasks visited"]["min"] == 20
    assert found["figure robots under way"]["min"] > 0.5 * robots
    assert found["separation"]["min"] > 0.5, "eps of the program"


def test_task_holds_on_a_bad_network(tmp_path: Path) -> None:
    campaign("task", "fleet", 300, tmp_path / "out", "--vary", "seed=1:2,loss=0.1,0.3")


def test_task_that_nobody_can_reach_is_told(tmp_path: Path) -> None:
    """A car cannot reach the tasks in the air; the mission ends all the same."""
    text = (EXAMPLES / "task/fleet_4c.yaml").read_text(encoding="utf-8")
    text = text.replace("0.0], id: 20}", "1.5], id: 20}")
    (tmp_path / "fleet.yaml").write_text(text, encoding="utf-8")
    files = [str(EXAMPLES / "task/task.koord"), "--fleet", str(tmp_path / "fleet.yaml")]
    out = tmp_path / "run"
    assert cli.main(["sim", *files, "--duration", "300", "--lockstep", "--quiet", "--out", str(out)]) == 0
    assert "all robots ended by themselves" in (out / "summary.txt").read_text(encoding="utf-8")
    assert "task 20 is not reachable" in (out / "robots/alice/log.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize("fleet", ["fleet", "fleet_u"])
def test_mapping_never_contradicts_the_truth(fleet: str, tmp_path: Path) -> None:
    found = campaign("mapping", fleet, 180, tmp_path / "out", "--vary", "seed=101:103")
    assert found["figure known, %"]["min"] >= 95 and found["figure 95 % known, s"]["max"] <= 180


@pytest.mark.parametrize("fleet", ["fleet", "fleet_9q", "fleet_16q", "fleet_mixed"])
def test_formation_of_any_fleet(fleet: str, tmp_path: Path) -> None:
    campaign("formation", fleet, 30, tmp_path / "out", "--vary", "seed=101")
