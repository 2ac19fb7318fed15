"""Robots that crash, come back or stand still for a while in lockstep, and runs that do not end as they should."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from operator import methodcaller
from pathlib import Path
from typing import Any

import pytest

from targets.sim import harness
from targets.sim.run import run
from targets.sim.trace import files as trace
from tests.sim.lockstep.lockstep import Plan, built, played, summary
from tests.sim.run.fake_fleet import wait_for_a_round

CAR, QUAD = 1, 2  # pids of bert and cleo
CRASH, RESTART = methodcaller("crash"), methodcaller("restart")


@pytest.fixture(scope="module")
def lineform(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("lineform"), "lineform")


def traced(folder: Path, robot: str, kind: str) -> list[dict[str, Any]]:
    lines = (folder / "robots" / robot / "trace.jsonl").read_text().splitlines()
    return [record for record in map(json.loads, lines) if record["kind"] == kind]


def test_robots_that_crash_come_back_to_the_mission_with_what_they_kept(lineform: Path, tmp_path: Path) -> None:
    plan = Plan((2, "cleo", CRASH), (2, "bert", CRASH), (3, "cleo", RESTART), (4, "bert", RESTART))
    outcome = played(lineform, tmp_path / "out", 6.0, plan)
    assert outcome.ended == "completed" and not outcome.violations
    assert set(outcome.statuses.values()) == {0}
    for robot in ("bert", "cleo"):
        details = [phase["detail"] for phase in traced(tmp_path / "out", robot, "phase") if phase["phase"] == "running"]
        assert len(details) == 2 and details[0] == details[1], "the second life is in another mission"
        assert traced(tmp_path / "out", robot, "round")[-1]["round"] >= 60
    said = (tmp_path / "out" / "robots" / "cleo" / "log.txt").read_text()
    assert "taking over without a take-off" in said
    assert "bert is back" in said and "all robots count; cleo is back" in said


def test_a_crashed_car_is_braked_by_its_watchdog_and_a_crashed_quad_lands_by_itself(
    lineform: Path, tmp_path: Path
) -> None:
    plan = Plan((2, "cleo", CRASH), (2, "bert", CRASH))
    outcome = played(lineform, tmp_path / "out", 15.0, plan)
    assert plan.speed(CAR, 2.0) > 0.5 and plan.speed(CAR, 2.5) < 0.01
    height = {t: states[QUAD].position[2] for t, states in plan.states}
    still = min(z for t, z in height.items() if t < 10)
    assert still > 1.3, "ArduPilot waits 5 s for its ground station, and hovers for 4 s before it descends"
    assert height[max(height)] < 0.01
    assert outcome.ended == "completed" and not outcome.violations
    assert (outcome.statuses["cleo"], outcome.statuses["alice"]) == (-9, 0)


@pytest.mark.slow
def test_a_quad_that_has_landed_meanwhile_takes_off_again_and_rejoins(lineform: Path, tmp_path: Path) -> None:
    plan = Plan((2, "cleo", CRASH), (12, "cleo", RESTART))
    outcome = played(lineform, tmp_path / "out", 30.0, plan)
    assert outcome.ended == "completed" and not outcome.violations
    said = (tmp_path / "out" / "robots" / "cleo" / "log.txt").read_text()
    assert "already flying in LAND: waiting until it has landed" in said and "cleo is back" in said
    height = {t: states[QUAD].position[2] for t, states in plan.states}
    assert min(height.values()) < 0.01 and height[max(height)] < 0.01
    assert max(z for t, z in height.items() if t > 22) > 1.3


def test_a_frozen_robot_does_nothing_for_so_long_and_goes_on(lineform: Path, tmp_path: Path) -> None:
    plan = Plan((2, "bert", lambda agent: agent.freeze(1.5)))
    outcome = played(lineform, tmp_path / "out", 5.0, plan)
    assert not outcome.violations
    times = [record["time"] - outcome.zero for record in traced(tmp_path / "out", "bert", "round")]
    assert not [t for t in times if 2.01 < t < 3.49]
    assert times[-1] > 4.8
    assert plan.speed(CAR, 2.0) > 0.5 and plan.speed(CAR, 2.5) < 0.01
    assert "the watchdog braked" in (tmp_path / "out" / "robots" / "bert" / "log.txt").read_text()


@pytest.mark.slow
def test_faults_repeat(lineform: Path, tmp_path: Path) -> None:
    def run(name: str) -> str:
        plan = Plan((0.5, "cleo", CRASH), (1.0, "cleo", RESTART), (1, "bert", lambda a: a.freeze(0.7)))
        played(lineform, tmp_path / name, 3.0, plan, seed=4)
        return "".join((tmp_path / name / "robots" / robot / "trace.jsonl").read_text() for robot in ("bert", "cleo"))

    assert run("a") == run("b")


def test_an_interrupted_run_leaves_a_report(lineform: Path, tmp_path: Path) -> None:
    command = [sys.executable, str(lineform), "--lockstep", "--duration", "1000", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    wait_for_a_round(tmp_path / "out")
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert summary(tmp_path / "out")["verdict"] == "interrupted"
    assert (tmp_path / "out" / "report.html").exists()


def changed(bundle: Path, tmp_path: Path, **robot: Any) -> Path:
    """The same bundle with another robot 0."""
    root = tmp_path / "sim"
    shutil.copytree(bundle, root)
    scenario = json.loads((bundle / "scenario.json").read_text())
    scenario["robots"][0] |= robot
    (root / "scenario.json").write_text(json.dumps(scenario))
    return root


def test_a_target_that_does_not_say_how_is_refused(
    lineform: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = changed(lineform, tmp_path, inside="")
    assert harness.main(root, ["--lockstep", "--out", str(tmp_path / "out"), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert "alice: its target quad cannot run in lockstep" in said and "leave out --lockstep" in said


def test_an_agent_that_cannot_begin_is_that_robots_failure(lineform: Path, tmp_path: Path) -> None:
    root = changed(lineform, tmp_path, inside="tests.sim.lockstep.test_lockstep_faults:nothing")
    plan = Plan()
    outcome = played(root, tmp_path / "out", 5.0, plan)
    assert outcome.ended == "died"
    (violation,) = outcome.violations
    assert violation.robots == ("alice",) and "status 70" in violation.detail
    assert "ZeroDivisionError" in (tmp_path / "out" / "robots" / "alice" / "log.txt").read_text()


def nothing(*arguments: object) -> float:
    return 1 / 0


def test_a_full_disk_ends_the_run(lineform: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(trace.Poses):
        def write(self, *_: Any) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "poses.jsonl")

    monkeypatch.setattr(run, "Poses", Full)
    plan = Plan()
    with pytest.raises(OSError, match="No space left"):
        played(lineform, tmp_path / "out", 5.0, plan)
    assert not any(agent.alive for agent in plan.run.conduct.agents)
