"""The harness end to end, on fleets of trivial agents: real processes, real files, a few seconds each."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.trace.schema import Phase, PoseRecord, Round, TraceRecord, Violation
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from targets.sim import harness
from targets.sim.base import folder
from targets.sim.base.scenario import load
from targets.sim.run import run
from targets.sim.run.scene import SimulationScene
from targets.sim.trace import files as trace
from targets.sim.trace.files import read
from tests.sim.run.fake_fleet import Telling, bundle, enlist, wait_for_a_round

REPOSITORY = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def device() -> None:
    enlist()


def sim(root: Path, out: Path, *more: str, report: bool = False) -> int:
    more = more if report else ("--no-report", *more)
    return harness.main(root, ["--duration", "1", "--seed", "7", "--out", str(out), "--quiet", *more])


def summary(out: Path) -> Any:
    return json.loads((out / "summary.json").read_text())


def records(out: Path) -> list[TraceRecord]:
    return list(read(out / "trace.jsonl")[1])


def no_process_left(root: Path) -> bool:
    found = subprocess.run(["ps", "-eww", "-o", "args"], capture_output=True, text=True, check=True).stdout
    return str(root) not in found


def test_a_good_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "leaving"]), tmp_path / "deep" / "out"
    assert sim(root, out, "--invoked-as", "koordgen sim 'my <app>'", report=True) == 0
    found = summary(out)
    assert (found["verdict"], found["seed"], found["violations"]) == ("held", 7, [])
    assert found["robots"][0]["events"]["Move"] in range(6, 13)
    assert found["robots"][1]["skips"]["no event enabled"] in range(6, 13)
    assert found["min_separation"]["distance"] == pytest.approx(2.0, abs=0.01)
    assert found["real_time_factor"] > 0.0
    seen = records(out)
    times = [record.t for record in seen]  # type: ignore[union-attr]
    assert times == sorted(times)
    first = next(record for record in seen if isinstance(record, Round))
    assert first.round == 1 and first.t == pytest.approx(0.001, abs=1e-3)  # `late` after the tick
    poses = [record for record in seen if isinstance(record, PoseRecord) and record.pid == 0]
    assert len(poses) == pytest.approx(found["steps"] / 12, abs=1), "20 poses a second, of 240 steps"
    assert any(isinstance(record, Phase) and record.phase == "stopped" for record in seen)
    assert {p.name for p in (out / "plots").iterdir()} >= {"top.png", "x-t.png", "y-t.png", "separation.png"}
    page = (out / "report.html").read_text()
    assert (
        "Held" in page and "koordgen sim &#x27;my &lt;app&gt;&#x27;" in page and "looking for the &lt;stars&gt;" in page
    )
    assert str(out / "report.html") in capsys.readouterr().out
    assert not (out / "fleet.key").exists()
    assert no_process_left(root)


def test_an_agent_that_dies_fails_the_run_but_does_not_end_it(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "dying"]), tmp_path / "out"
    assert sim(root, out, report=True) == 3
    found = summary(out)
    (violation,) = found["violations"]
    assert violation["what"] == "ended" and violation["robots"] == ["r1"]
    assert violation["t"] == pytest.approx(0.45, abs=0.3)
    assert "70" in found["why"] and "ouch" in found["why"]
    assert [(p["name"], p["outcome"]) for p in found["properties"]] == [("Here", "out of model")]
    assert found["robots"][0]["rounds"] >= 6
    assert "ValueError: <b>ouch</b>" in found["robots"][1]["last_lines"]
    page = (out / "report.html").read_text()
    assert "&lt;b&gt;ouch" in page and "<b>ouch" not in page


def test_a_fault_fails_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, out = bundle(tmp_path / "sim", ["faulty", "good"]), tmp_path / "out"
    assert sim(root, out) == 3
    assert f"run: {out}\n" in capsys.readouterr().out
    assert not (out / "report.html").exists() and not (out / "plots").exists() and records(out)
    (violation,) = summary(out)["violations"]
    assert violation["what"] == "fault" and "a.koord:3: 1 / 0" in violation["detail"]
    assert violation["t"] == pytest.approx(0.3, abs=0.3)
    assert summary(out)["robots"][0]["faults"] == 1


def test_robots_that_are_too_close_or_touch_fail_the_run(tmp_path: Path) -> None:
    places = [[0.0, 0.0, 0.0], [0.35, 0.0, 0.3], [2.0, 0.0, 0.0]]  # the second falls, and touches the first
    root, out = bundle(tmp_path / "sim", ["good"] * 3, places, min_separation=0.5), tmp_path / "out"
    assert sim(root, out) == 3
    found = summary(out)
    assert {v["what"] for v in found["violations"]} == {"separation", "collision"}
    assert all(v["robots"] == ["r0", "r1"] for v in found["violations"])
    assert found["collisions"] == 1
    assert found["min_separation"]["distance"] == pytest.approx(0.36, abs=0.03)
    for robot, other in (("r0", "r1"), ("r1", "r0")):
        said = (out / "robots" / robot / "log.txt").read_text()
        assert said.count(f"simulator: {robot} touched {other} at ") == 1


def with_obstacles(root: Path, *boxes: tuple[list[float], list[float]]) -> Path:
    """The same bundle with obstacles in its world."""
    path = root / "scenario.json"
    obstacles = [{"shape": "box", "lo": lo, "hi": hi} for lo, hi in boxes]
    path.write_text(json.dumps({**json.loads(path.read_text()), "obstacles": obstacles}))
    return root


def test_a_robot_that_touches_an_obstacle_fails_the_run(tmp_path: Path) -> None:
    far, near = ([4.0, 4.0, 0.0], [5.0, 5.0, 1.0]), ([2.17, -1.0, 0.0], [3.0, 1.0, 0.15])  # a quad's radius is 0.18
    fleet = bundle(tmp_path / "sim", ["good", "good"], [[0.0, 0.0, 0.0], [2.0, 0.0, 0.3]])  # the second falls
    root, out = with_obstacles(fleet, far, near), tmp_path / "out"
    assert sim(root, out) == 3
    (violation,) = summary(out)["violations"]
    assert (violation["what"], violation["robots"]) == ("collision", ["r1"])
    assert violation["detail"] == "touched obstacle 1"
    assert "simulator: r1 touched obstacle 1" in (out / "robots" / "r1" / "log.txt").read_text()
    assert "simulator:" not in (out / "robots" / "r0" / "log.txt").read_text()
    assert summary(out)["collisions"] == 1
    assert read(out / "trace.jsonl")[0].obstacles[1] == Block(Point(2.17, -1.0, 0.0), Point(3.0, 1.0, 0.15))


def test_a_lidar_is_for_robots_that_have_a_setting_for_one(tmp_path: Path) -> None:
    root = bundle(tmp_path / "sim", ["good", "good"])
    found = json.loads((root / "scenario.json").read_text())
    found["robots"][1]["settings"]["scans"] = ""
    (root / "scenario.json").write_text(json.dumps(found))
    scene = SimulationScene(load(root), 1, bytes(32))
    without, with_ = (actor.overrides for actor in scene.actors)
    scene.close()
    assert "scans" not in without and with_["scans"].startswith("udp:127.0.0.1:")


def test_a_fleet_that_stops_by_itself_ends_the_run(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["stopping", "stopping"]), tmp_path / "out"
    assert sim(root, out, "--duration", "60") == 0
    assert summary(out)["duration"] < 20 and "by themselves" in summary(out)["why"]


def test_a_start_that_never_comes_says_what_was_waited_for(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["waiting", "waiting"], start_timeout=1.0), tmp_path / "out"
    assert sim(root, out) == 5
    found = summary(out)
    assert found["verdict"] == "not started"
    assert "r1: starting: looking for the <stars>" in found["why"]
    assert not read(out / "trace.jsonl")[0].started
    assert no_process_left(root)


def test_an_agent_that_dies_before_round_1_ends_the_run_at_once(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["waiting", "unborn"], start_timeout=60.0), tmp_path / "out"
    began = time.monotonic()
    assert sim(root, out) == 3
    assert time.monotonic() - began < 30, "it does not wait for the other one"
    assert "r1" in summary(out)["why"] and "no autopilot answers" in summary(out)["why"]


def test_an_agent_that_will_not_rest_is_killed_and_fails_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "STOP_WITHIN", 0.5)
    root, out = bundle(tmp_path / "sim", ["good", "stubborn"]), tmp_path / "out"
    assert sim(root, out) == 3
    assert "did not stop in time" in summary(out)["why"]
    assert no_process_left(root)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_run_leaves_a_report_and_no_process(tmp_path: Path, number: int) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "good"]), tmp_path / "out"
    command = [sys.executable, "-m", "tests.sim.run.fake_fleet", str(root), "--duration", "60", "--out", str(out)]
    process = subprocess.Popen(command, cwd=REPOSITORY, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    wait_for_a_round(out)
    time.sleep(0.5)
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130, said
    assert summary(out)["verdict"] == "interrupted"
    assert 0.3 < summary(out)["duration"] < 25, "and not all of its 60 s"
    assert "Interrupted" in (out / "report.html").read_text()
    assert no_process_left(root)


def test_agents_do_not_outlive_a_killed_harness(tmp_path: Path) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    command = [sys.executable, "-m", "tests.sim.run.fake_fleet", str(root), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, cwd=REPOSITORY, stderr=subprocess.DEVNULL)
    wait_for_a_round(tmp_path / "out")
    assert not no_process_left(root)
    process.kill()
    process.wait()
    until = time.monotonic() + 20
    while not no_process_left(root) and time.monotonic() < until:
        time.sleep(0.05)
    assert no_process_left(root)


def test_check_runs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    assert sim(root, tmp_path / "out", "--check") == 0
    assert "r0" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_of_a_run_is_never_touched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, out = bundle(tmp_path / "sim", ["good"]), tmp_path / "out"
    out.mkdir()
    (out / "trace.jsonl").write_text("mine")
    assert sim(root, out) == 5
    assert "--out" in capsys.readouterr().err
    assert (out / "trace.jsonl").read_text() == "mine" and len(list(out.iterdir())) == 1


def test_a_note_left_in_a_runs_folder_saves_it(tmp_path: Path) -> None:
    with folder.RunFolder(tmp_path / "out") as path:
        (path / "summary.json").write_text("{}")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(folder.ForeignFolder, match=r"notes\.txt"), folder.RunFolder(tmp_path / "out"):
        pass
    assert (tmp_path / "out" / "summary.json").exists()


def test_a_new_run_begins_by_removing_the_old_ones_results(tmp_path: Path) -> None:
    with folder.RunFolder(tmp_path / "out") as path:
        (path / "summary.json").write_text("{}")
        (path / "plots").mkdir()
    with folder.RunFolder(tmp_path / "out") as path:
        assert [p.name for p in path.iterdir()] == [folder.MARKER]
        with pytest.raises(folder.ForeignFolder, match="another run"), folder.RunFolder(tmp_path / "out"):
            pass


def test_a_full_disk_ends_the_run_with_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Full(trace.Poses):
        def write(self, *_: Any) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "poses.jsonl")

    monkeypatch.setattr(run, "Poses", Full)
    root, out = bundle(tmp_path / "sim", ["good"]), tmp_path / "out"
    assert sim(root, out) == 5
    said = capsys.readouterr().err
    assert "disk is full" in said and "Traceback" not in said
    assert not (out / "summary.json").exists() and not (out / "fleet.key").exists()
    assert no_process_left(root)


def test_an_agent_that_is_shot_is_in_the_trace(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "shot"]), tmp_path / "out"
    assert sim(root, out) == 3
    (found,) = [record for record in records(out) if isinstance(record, Violation)]
    assert (found.what, found.robots, found.detail) == ("ended", ("r1",), "was killed by SIGKILL")


def test_devices_get_seeds_of_their_own_that_repeat(tmp_path: Path) -> None:
    scenario = load(bundle(tmp_path / "sim", ["good", "good"]))

    def seeds(seed: int) -> list[int]:
        scene = SimulationScene(scenario, seed, bytes(32))
        found = [actor.device.context.seed for actor in scene.actors if isinstance(actor.device, Telling)]
        scene.close()
        return found

    assert seeds(1) == seeds(1) != seeds(2)
    assert len(set(seeds(1))) == 2
