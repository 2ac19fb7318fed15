"""Robots without a way: each says what is wanted and why there is none, in its log, its trace and the summary."""

from __future__ import annotations

import json
import math
from html import escape
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.runtime.values.points import Point
from targets.sim.view.web import report
from tests.sim.autopilots.test_simple import Rig
from tests.sim.lockstep.lockstep import ran, summary

PROGRAM = """\
param List<Point> goals max 8 = [Point(0, 0, 0)]
using Motion:
  actuators: Point target
  sensors:
    Point position
    bool reached
local:
  bool sent = False
Go:
  pre: not sent and pid < len(goals)
  eff:
    sent = True
    Motion.target = goals[pid]
"""
FLEET = """\
delta: 0.1
origin: {latitude: 47.4, longitude: 8.5, altitude: 488.0}
geofence: {lo: [-5.0, -5.0, -0.5], hi: [5.0, 5.0, 3.0]}
params: {goals: [[3.0, 0.0, 0.0], [3.0, 0.0, 1.5], [0.0, 9.0, 1.5]]}
robots:
- {name: carl, target: car, address: '127.0.0.1:47100', start: {position: [0.0, 0.0, 0.0]}}
- {name: wing, target: quad, address: '127.0.0.1:47104', start: {position: [0.0, -2.0, 0.0]}}
- {name: yoyo, target: quad, address: '127.0.0.1:47108', start: {position: [-2.0, 2.0, 0.0]}}
sim: {fidelity: simple}
obstacles:
- {lo: [2.6, -0.4, 0.0], hi: [3.4, 0.4, 3.0]}
"""


SLOW = """\
delta: 0.1
origin: {latitude: 47.4, longitude: 8.5, altitude: 488.0}
geofence: {lo: [-8.0, -8.0, -0.5], hi: [8.0, 8.0, 3.0]}
params: {goals: [[4.0, 2.0, 0.0]]}
robots:
- name: carl
  target: car
  address: 127.0.0.1:47100
  start: {position: [0.0, 0.0, 0.0]}
  settings: {drive: 'rover:udpin:127.0.0.1:14550', position: rover}
sim: {speed_lag: 2.0}
"""


def went(folder: Path, fleet: str, seconds: float) -> Path:
    """The folder of a run in lockstep."""
    (folder / "go.koord").write_text(PROGRAM)
    (folder / "fleet.yaml").write_text(fleet)
    arguments = ["build", str(folder / "go.koord"), "--fleet", str(folder / "fleet.yaml"), "--target", "sim"]
    assert main([*arguments, "-o", str(folder / "build")]) == 0
    ran(folder / "build/go/sim", folder / "out", seconds)
    return folder / "out"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return went(tmp_path_factory.mktemp("stalls"), FLEET, 4.0)


WANTED = {
    "carl": "target (3.00, 0.00) lies inside obstacle 0",
    "wing": "to (3.00, 0.00, 1.50) comes within 0.00 m of obstacle 0",
}


def stalls_of(run: Path, robot: str) -> list[dict[str, Any]]:
    found = [json.loads(line) for line in (run / "robots" / robot / "trace.jsonl").read_text().splitlines()]
    return [record for record in found if record["kind"] == "stall"]


@pytest.mark.parametrize("robot", WANTED)
def test_a_robot_without_a_way_says_why(run: Path, robot: str) -> None:
    stalls = stalls_of(run, robot)
    assert [s["state"] for s in stalls] == ["begins"] and WANTED[robot] in stalls[0]["why"]
    log = (run / "robots" / robot / "log.txt").read_text()
    assert f"{robot}: warning: no way for 2 s: " in log and WANTED[robot] in log
    (told,) = next(r for r in summary(run)["robots"] if r["name"] == robot)["stalls"]
    assert WANTED[robot] in told["why"] and not told["over"] and told["seconds"] > 3.5
    text = (run / "summary.txt").read_text()
    assert f"{robot} from " in text and WANTED[robot] in text
    report.write(run / "report.html", run / "trace.jsonl")
    assert escape(WANTED[robot]) in (run / "report.html").read_text()


def test_commands_that_were_clamped_or_refused_are_told_of_the_whole_run(run: Path) -> None:
    warnings = {robot["name"]: [each["text"] for each in robot["warnings"]] for robot in summary(run)["robots"]}
    (refused,), (clamped,) = warnings["wing"], warnings["yoyo"]  # a stall is told once, as a stall
    assert refused.startswith("the commanded path is not flown, holding instead: ") and WANTED["wing"] in refused
    assert clamped.startswith("Motion.target = Point(x=0.0, y=9.0, z=1.5) is outside the geofence, commanding Point(")
    assert f"yoyo at 0.00 s: {clamped}" in (run / "summary.txt").read_text()
    report.write(run / "report.html", run / "trace.jsonl")
    page = (run / "report.html").read_text()
    for text in (refused, clamped):
        assert page.index(escape(text)) < page.index("<canvas"), "at the top of the page"


def test_a_quad_whose_planner_finds_no_way() -> None:
    rig = Rig("quad")
    rig.run(6.0)
    assert rig.ready() and rig.platform.stall == ""
    assert rig.platform.call("Motion.planner", (Point(9.0, 0.0, 1.0),)) == ()
    assert rig.platform.stall == "the planner's goal (9.00, 0.00, 1.00) is outside the geofence"
    assert rig.platform.call("Motion.planner", (Point(1.0, 0.0, 0.0),)) == ()
    assert rig.platform.stall == "", "a goal on the ground is a car's task"
    rig.platform.call("Motion.planner", (Point(9.0, 0.0, 1.0),))
    rig.platform.hold(True, rig.world.time)
    assert rig.platform.stall == "", "it was told to hold"
    rig.platform.close()
    rig.device.close()


def test_a_rover_whose_motor_is_slow_is_warned_of_and_stands_at_its_target(tmp_path: Path) -> None:
    """tests/car/control/test_lag.py tests that a car that circles its target gives up."""
    run = went(tmp_path, SLOW, 21.0)
    log = (run / "robots/carl/log.txt").read_text()
    assert "warning: the motor follows its commands with a lag of 2." in log
    poses = [json.loads(line) for line in (run / "trace.jsonl").read_text().splitlines() if '"kind":"pose"' in line]
    late = [tuple(p["position"]) for p in poses if p["t"] > 18.0]
    assert len(late) > 10 and len(set(late)) == 1, "it stands"
    assert math.dist(late[0][:2], (4.0, 2.0)) < 0.1
