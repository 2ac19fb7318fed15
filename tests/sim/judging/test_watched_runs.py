"""Whole runs in lockstep: what their properties come to, what replay says of them, and tasks that nobody can do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.sim.lockstep.lockstep import EXAMPLES, built, digest, ran, summary

CHASE = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume position' in Rect(position, target) or position' in Ball(target, 20)
allread: Point x[N_SYS]
init: x[pid] = Motion.position
Go:
  pre: pid == 0 and N_SYS > 2
  eff:
    Motion.target = x[2]
    x[pid] = Motion.position
initially: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 1
invariant Apart: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 1
invariant Shared: forall i in ID: distance(x[i], Motion.position[i]) < 0.5
"""


def chased(folder: Path, text: str = CHASE) -> Path:
    source = folder / "chase.koord"
    source.write_text(text)
    fleet = EXAMPLES / "atomicsum/fleet.yaml"
    assert main(["build", str(source), "--fleet", str(fleet), "--target", "sim", "-o", str(folder / "build")]) == 0
    return folder / "build/chase/sim"


def test_a_property_that_does_not_hold_fails_the_run_at_its_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundle, out = chased(tmp_path), tmp_path / "out"
    assert ran(bundle, out, 2.3) == 3
    found = summary(out)
    properties = {p["name"] or p["of"]: p for p in found["properties"]}
    assert {name: p["outcome"] for name, p in properties.items()} == {
        "initially": "held", "Apart": "violated", "Shared": "held", "Motion": "held"
    }  # fmt: skip
    apart = properties["Apart"]
    assert apart["line"] == "chase.koord:15" and set(apart["robots"]) == {"alice", "bert"}
    poses = [json.loads(line) for line in (out / "trace.jsonl").read_text().splitlines() if '"pose"' in line[:20]]
    before = max(p["t"] for p in poses if p["pid"] == 0 and p["position"][0] <= -2.5)
    assert apart["since"] == pytest.approx(before, abs=0.06), "bert stands at -1.5: closer than 1 m from there on"
    assert "chase.koord:15" in found["why"] and found["violations"][0]["what"] == "property"
    assert found["watching"] < 0.25
    assert properties["Apart"]["observations"] > 0 and "VIOLATED since" in (out / "summary.txt").read_text()
    assert main(["replay", str(out)]) == 0
    assert "5 robots" in capsys.readouterr().out


def test_verdicts_repeat_byte_for_byte(tmp_path: Path) -> None:
    bundle = chased(tmp_path)
    for k in range(2):
        assert ran(bundle, tmp_path / str(k), 2.5, hashing=str(k)) == 3
    assert digest(tmp_path / "0") == digest(tmp_path / "1")


def settings(folder: Path, **values: Any) -> str:
    (folder / "settings.json").write_text(json.dumps(values))
    return f"--settings={folder / 'settings.json'}"


TASKS = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: List<Point> path
  PathPlanner planner
allread: Point at[N_SYS]
allwrite: List<Point> tasks = [Point(-3, 1, 0), Point(0, 0, 2)]
Assign:  # the second is in the air: no car has a way there
  pre: Motion.reached and len(tasks) > 0
  eff: atomic:
    List<Point> way = Motion.planner(first(tasks))
    if pid == 0 and len(way) > 0:
      tasks.pop(0)
      Motion.path = way
    at[pid] = Motion.position
Done:
  pre: Motion.reached and len(tasks) == 0
  eff: stop
invariant Left: len(tasks) <= 2
"""


def test_tasks_that_nobody_can_do_are_told_and_not_waited_for(tmp_path: Path) -> None:
    bundle, out = chased(tmp_path, TASKS), tmp_path / "out"
    assert ran(bundle, out, 60.0, settings(tmp_path, idle_timeout=3.0)) == 3
    found = summary(out)
    (violation,) = found["violations"]
    assert violation["what"] == "idle" and found["duration"] < 15 and len(violation["robots"]) == 5
    assert violation["t"] == pytest.approx(found["duration"] - 3.0, abs=0.3)
    assert "no robot made progress for 3 s" in found["why"] and "Assign" in violation["detail"]
    assert [p["outcome"] for p in found["properties"]] == ["held"]


@pytest.mark.slow
@pytest.mark.parametrize("app", ["lineform", "task", "atomicsum", "election", "delivery", "hvac", "formation"])
def test_runs_of_the_examples_are_as_their_programs_mean(tmp_path: Path, app: str) -> None:
    seconds = 14.0 if app == "task" else 12.0  # at 12 s a quad is above a car, and a run's end lands it there
    assert ran(built(tmp_path, app), tmp_path / "out", seconds) == 0
    assert main(["replay", str(tmp_path / "out")]) == 0
    assert main(["replay", str(next((tmp_path / "out/robots").iterdir()) / "trace.jsonl")]) == 0
