"""All windows of all robots: told also after the first violation, and without a change to what is said of the run."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.values.points import Point
from targets.sim.judging.windows import FILE
from tests.sim.judging.watched import Watched

FORTH = """\
using Motion:
  sensors:
    Point position
    bool reached
    PathPlanner planner
  actuators: Point target
  assume position' in Rect(position, target)
  assume planner(goal) == [] or len(planner(goal)) > 0
Go:
  pre: pid == 1
  eff: Motion.target = Motion.position + Point(3, 0, 0)
"""


def windows(folder: Path, **options: Any) -> tuple[Watched, list[dict[str, Any]]]:
    """Robot 2 is moved 1 cm north in each round from 2 s on, robot 0 once."""
    watched = Watched(folder, FORTH, **options)

    def moved(pid: int, t: float, place: Point) -> Point:
        if pid == 2 and t > 2.0:
            return place + Point(0, 0.01 * ((t - 2.0) / watched.fleet.delta), 0)
        return place + Point(0, 0, -0.5) if pid == 0 and 1.0 < t < 1.02 else place

    watched.moved = moved
    watched.run(4.0).end()
    if watched.windows is None:
        return watched, []
    watched.windows.write(folder, "completed")
    return watched, [json.loads(line) for line in (folder / FILE).read_text().splitlines()]


def test_each_robot_has_its_own_windows(tmp_path: Path) -> None:
    watched, (head, *rows, end) = windows(tmp_path, told=True)
    assert head["body"] == "Motion" and end == {"end": "completed"}
    assert [(a["module"], a["line"]) for a in head["assumptions"]] == [("Motion", 7), ("Motion", 8)]
    assert head["robots"][0] == {"name": "alice", "platform": "none made"}
    rounds = {row["round"] for row in rows}
    assert rounds == set(range(1, max(rounds) + 1)) and len(rows) == 3 * len(rounds)
    came = {pid: Counter(row["came"][0] for row in rows if row["pid"] == pid) for pid in range(3)}
    assert came[0]["v"] in (1, 2) and came[1]["v"] == 0 and came[2]["v"] >= 4
    assert {row["came"][1] for row in rows} == {"-"}, "nobody asked the planner"
    (first,) = watched.violations()
    assert first.robots == ("alice",), "the run is told of the first alone"


def test_how_far_and_where(tmp_path: Path) -> None:
    _, (_, *rows, _) = windows(tmp_path, told=True)
    bodies = [row for row in rows if row["pid"] == 2 and row["came"][0] == "v"]
    full = [row for row in bodies if row["out"][1] > 0.005]
    assert all(row["out"][1] == pytest.approx(0.01, abs=2e-3) and row["out"][0] == 0.0 for row in full) and full
    assert all(row["far"] <= row["reach"] for row in bodies)
    flies = [row for row in rows if row["pid"] == 1 and row["round"] > 2]
    assert all("out" not in row and row["reach"] == pytest.approx(3.0, abs=0.2) for row in flies)


def test_what_is_said_of_the_run_is_the_same(tmp_path: Path) -> None:
    said = []
    for told in (False, True):
        (tmp_path / str(told)).mkdir()
        watched, _ = windows(tmp_path / str(told), told=told)
        said.append(watched.run_.marks)
    assert said[0] == said[1]
