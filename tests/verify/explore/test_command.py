"""`koordgen explore` from the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.programs import QUAD_AND_CAR
from tests.verify.explore.test_search import COUNT, LOST, MOTION

EXAMPLES = Path(__file__).parents[3] / "examples"
ELECTION = str(EXAMPLES / "election/election.koord")


@pytest.fixture
def app(tmp_path: Path) -> str:
    path = tmp_path / "app.koord"
    path.write_text(LOST)
    return str(path)


def test_all_explored_and_all_kept_is_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", ELECTION]) == 0
    told = capsys.readouterr()
    assert "3 robots: HOLDS" in told.out and "explored completely" in told.out and "Agreement" in told.out
    assert told.err == ""  # no progress where there is no terminal


def test_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", ELECTION, "--robots", "2", "--format", "json", "--param", "salt=3"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "HOLDS" and told["complete"] and told["states"] > 3 and told["violation"] is None


def test_a_bound_is_4(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", ELECTION, "--rounds", "1"]) == 4
    assert "explored to depth 1" in capsys.readouterr().out


def test_commands_from_outside_are_not_explored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """So the result is not HOLDS, although no violation is found; and a fleet that waits is in no deadlock."""
    path = tmp_path / "app.koord"
    path.write_text(
        "provides Motion:\n  actuators: int target = goal\nallwrite: int goal\nallread: int seen[N_SYS]\n"
        "Go:\n  pre: seen[pid] != goal\n  eff: seen[pid] = goal\ninvariant Still: goal == 0\n"
    )
    assert main(["explore", str(path), "--robots", "2"]) == 4
    assert "INCONCLUSIVE" in (told := capsys.readouterr().out)
    assert "incomplete because of: commands from outside to goal, which are not explored" in told


def test_a_violation_is_3_with_its_files(app: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace, itf = tmp_path / "t.jsonl", tmp_path / "t.itf.json"
    assert main(["explore", app, "--robots", "2", "--trace", str(trace), "--itf", str(itf), "--format", "json"]) == 3
    told = json.loads(capsys.readouterr().out)
    assert (told["violation"]["what"], told["violation"]["rounds"]) == ("Counted", 1)
    assert json.loads(trace.read_text().splitlines()[-1])["name"] == "Counted" and json.loads(itf.read_text())["states"]


BUILDING = "export:\n  write List<int> done\n    guarantee Kept: len(done) <= len(done')\n"
BUILDING += "param int most = 1\nallwrite: List<int> done max 9\n"
BUILDING += "Put:\n  pre: len(done) < most\n  eff: atomic: done.append(pid)\n"
TASK = "import Building:\n  write List<int> done max 9\nlocal: int seen\n"
TASK += "Look:\n  pre: len(done) > seen\n  eff: seen += 1\n"


@pytest.fixture
def fleet(tmp_path: Path) -> str:
    """A fleet file with two applications, of which the second sees what the first exports."""
    (tmp_path / "building.koord").write_text(BUILDING)
    (tmp_path / "task.koord").write_text(TASK)
    path = tmp_path / "fleet.yaml"
    entries = "  - {name: building, program: building.koord, params: {most: 2}}\n"
    entries += "  - {name: task, program: task.koord, robots: [bert], import: {Building: building}}\n"
    path.write_text(QUAD_AND_CAR + entries)
    return str(path)


def test_a_fleet_file_with_applications(fleet: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explore", fleet, "--no-deadlock"]) == 0
    assert "2 applications, 2 robots: HOLDS" in capsys.readouterr().out
    assert main(["explore", fleet, "--no-deadlock", "--rounds", "1"]) == 4
    capsys.readouterr()
    assert main(["explore", fleet]) == 3
    assert "deadlock after" in capsys.readouterr().out
    more = "Clear:\n  pre: len(done) > 1\n  eff: atomic: done = []\n"
    (tmp_path / "task.koord").write_text(TASK.replace("Look:", f"{more}Look:"))
    run, trace = tmp_path / "run.itf.json", tmp_path / "run.jsonl"
    assert main(["explore", fleet, "--no-deadlock", "--format", "json", "--itf", str(run), "--trace", str(trace)]) == 3
    told = json.loads(capsys.readouterr().out)["violation"]
    assert (told["application"], told["what"], told["rounds"], told["shortest"]) == ("building", "Kept", 3, 1)
    assert told["order_of_agents"] and told["run"][-1]["application"] == "task" and told["run"][-1]["robot"] == "bert"
    assert json.loads(run.read_text())["states"][-1]["application"] == "task"
    header, *records, end = map(json.loads, trace.read_text().splitlines())
    assert header["applications"] == ["building", "task"] and end["application"] == "building"
    acted = [(r["event"], r["application"], r["pid"]) for r in records if r.get("event") not in (None, "init")]
    assert {r["skipped"] for r in records} == {None, "another robot's step", "another application's step"}
    assert acted[-1] == ("Clear", "task", 1) and {("Put", "building")} <= {each[:2] for each in acted}


def test_commands_to_an_application_are_not_explored(
    fleet: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "task.koord"
    path.write_text(f"{path.read_text()}allwrite: int goal\nprovides Motion:\n  actuators: int target = goal\n")
    assert main(["explore", fleet]) == 4
    told = capsys.readouterr().out
    assert "2 applications, 2 robots: INCONCLUSIVE" in told and "commands from outside to goal" in told


def test_a_fleet_file_with_one_application_is_its_program(
    fleet: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "app.koord").write_text(LOST)
    Path(fleet).write_text(QUAD_AND_CAR + "  - {name: only, program: app.koord}\n")
    assert main(["explore", fleet]) == 3
    told = capsys.readouterr().out
    assert main(["explore", str(tmp_path / "app.koord"), "--robots", "2"]) == 3
    assert told.partition("0.0")[0] == capsys.readouterr().out.partition("0.0")[0]


@pytest.mark.parametrize("option", ["--robots=2", "--param=most=3", "--functions=f.py"])
def test_options_of_one_program_are_refused_with_applications(
    fleet: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explore", fleet, option]) == 2
    assert f"{option.partition('=')[0]} does not apply" in capsys.readouterr().err


def test_deadlock_may_be_allowed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "app.koord"
    path.write_text(COUNT)
    assert main(["explore", str(path)]) == 3
    assert "deadlock after 3 rounds" in capsys.readouterr().out
    assert main(["explore", str(path), "--no-deadlock"]) == 0
    assert "never enabled: Never (line 6)" in capsys.readouterr().out


def test_a_port_without_values_is_2_and_a_wrong_file_is_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, env = tmp_path / "app.koord", tmp_path / "env.yaml"
    path.write_text(MOTION)
    assert main(["explore", str(path)]) == 2
    assert "Motion.position needs values" in capsys.readouterr().err
    env.write_text("Motion.position: [[0, 0, 0]]\nMotion.planner: curved\n")
    assert main(["explore", str(path), "--env", str(env)]) == 1
    assert "env.yaml:2" in capsys.readouterr().err
    env.write_text("Motion.position: [[0, 0, 0]]\nMotion.planner: straight\n")
    assert main(["explore", str(path), "--env", str(env), "--no-deadlock"]) == 0
    assert main(["explore", str(path), "--param", "none=3"]) == 2


# Robots tell once; the last one's number stays. Agents tell by ascending pid.
ORDER = """
allwrite: int last
allread: bool done[N_SYS]
Tell:
  pre: not done[pid]
  eff:
    last = (pid + 1) * (1 + last)
    done[pid] = True
Finish:
  pre: done[pid]
  eff: stop
invariant No: {}
"""


def explored(path: Path, robots: int, wrong: str, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    path.write_text(ORDER.format(wrong))
    assert main(["explore", str(path), "--robots", str(robots), "--format", "json", *more]) == 3
    found = json.loads(capsys.readouterr().out)["violation"]
    assert isinstance(found, dict)
    return found


def test_an_order_that_agents_do_not_have_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "app.koord"
    found = explored(path, 2, "last != 1 or done.count(True) < 2", capsys)
    assert found["order_of_agents"] is False and found["rounds"] == 1
    assert main(["explore", str(path), "--robots", "2"]) == 3
    assert "robots' agents cannot execute this run" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("more", [(), ("--no-independence",), ("--no-symmetry", "--no-forgetting"), ("--seconds=100",)])
def test_of_runs_of_equally_many_rounds_one_that_agents_can_do_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...]
) -> None:
    # Robots 1 and 0 in this order are found first, then 1 and 2.
    wrong = "last == 2 or done.count(True) < 2 or not (exists i in ID: done[i] and i == 1)"
    found = explored(tmp_path / "app.koord", 3, wrong, capsys, *more)
    assert found["order_of_agents"] is True and found["rounds"] == 1
    assert [step["robot"] for step in found["run"] if step["event"] == "Tell"] == [1, 2]
    assert main(["explore", str(tmp_path / "app.koord"), *more]) == 3
    assert "robots' agents can execute this run" in capsys.readouterr().out
