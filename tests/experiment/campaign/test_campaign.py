"""Campaign of fake bundles: folder, table and status; interruptions; resuming."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from koordgen.cli.base import building
from koordgen.cli.experiment import campaign as command
from koordgen.experiment.campaign import plots, store
from tests.experiment.campaign import fake

DRAW = plots.draw
PLANNED = {"SHA256SUMS": b"sums", "scenario.json": b'{"robots": [{"name": "bert"}]}'}


@pytest.fixture(autouse=True)
def faked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Pictures, which take longer than all else, are drawn where `drawn` is asked for."""
    monkeypatch.setattr(building, "planned", lambda options, targets, **_: ({fake.NAME: PLANNED}, "app"))
    monkeypatch.setattr(building, "require_packages", lambda: None)
    monkeypatch.setattr(command, "_builder", lambda options, harness: fake.build)
    monkeypatch.setattr(plots, "draw", lambda results, folder: [])
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def drawn(faked: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots, "draw", DRAW)


def campaign(*words: str) -> int:
    return cli.main(["campaign", "app.koord", "--fleet", "fleet.yaml", "--out", "out", "--jobs", "2", *words])


def results() -> list[dict[str, Any]]:
    return [json.loads(line) for line in Path("out/results.jsonl").read_text().splitlines()]


def began() -> dict[str, int]:
    """When each run began, by its folder: another time is another run."""
    return {path.parent.name: path.stat().st_mtime_ns for path in Path("out/runs").glob("*/began")}


@pytest.mark.usefixtures("drawn")
def test_all_held(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign("--vary", "seed=1:5,loss=0:0.2", "--runs", "5", "--duration", "12", "--lockstep") == 0
    told = capsys.readouterr()
    assert told.out.startswith("app: 5 runs: 5 held, 0 violated (0.0 %; 95 % confidence: 0.0 to 43.4 %)\n")
    assert told.err == "", "nobody watches: no progress"
    found = json.loads(Path("out/campaign.json").read_text())
    assert found["mission"] == {"mean": 13.0, "median": 13.0, "min": 11.0, "max": 15.0}
    assert [r["varied"]["seed"] for r in found["runs"]] == list("12345")
    assert len(Path("out/campaign.csv").read_text().splitlines()) == 6
    assert sorted(p.name for p in Path("out/plots").iterdir()) == ["loss.png", "mission.png", "seed.png"]
    assert sorted(p.name for p in Path("out/runs").iterdir()) == [f"000{k}" for k in range(5)]
    assert (Path("out/runs/0000/summary.json")).exists()
    shown = Path("out/runs/0002/began").read_text()
    assert shown.startswith("koordgen sim app.koord --fleet=fleet.yaml --duration=12 --lockstep --seed=3 --loss=0.")


def test_the_programs_may_be_those_of_a_fleet_file(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["campaign", "fleet.yaml", "--out", "out", "--jobs", "2", "--vary", "seed=1:2", "--lockstep"]
    assert cli.main(words) == 0
    shown = Path("out/runs/0001/began").read_text()
    assert shown.startswith("koordgen sim fleet.yaml --lockstep --seed=2 --out=")
    assert cli.main([*words, "--vary", "param.count=1,2"]) == 2
    assert "write one fleet file for each value" in capsys.readouterr().err


def test_a_program_without_a_fleet_file_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["campaign", "app.koord", "--vary", "seed=1:2"]) == 2
    assert "the fleet file is missing\n  help: add --fleet" in capsys.readouterr().err


def test_one_run_is_repeated_with_the_functions_of_the_campaign() -> None:
    assert campaign("--vary", "seed=1:2", "--functions", "own.py") == 0
    assert "--functions=own.py" in Path("out/runs/0001/began").read_text()


def test_reports_are_made_of_runs_only_when_they_are_asked_for() -> None:
    assert campaign("--vary", "seed=1:2") == 0
    assert not list(Path("out").rglob("report.html"))
    assert "no-report" not in Path("out/runs/0001/began").read_text(), "who repeats one run wants to see it"
    assert campaign("--vary", "seed=1:2", "--reports", "--out", "seen") == 0
    assert len(list(Path("seen").rglob("report.html"))) == 2


@pytest.mark.usefixtures("drawn")
def test_what_is_violated_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign("--vary", "seed=1:2,loss=0,0.3") == 3
    out = capsys.readouterr().out
    assert "2 held, 2 violated (50.0 %;" in out
    assert "separation: 2 times, first in run 0001 (seed 1, loss 0.3): at 1.50 s alice and bert" in out
    assert [line.split()[:3] for line in out.splitlines() if line.startswith(("0 ", "0.3 "))] == [
        ["0", "2", "0"], ["0.3", "0", "2"],
    ]  # fmt: skip


@pytest.mark.usefixtures("drawn")
def test_what_did_not_run_is_told_and_repeated(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign("--vary", "mode=held,crash") == 5
    assert "did not run: once, first in run 0001 (mode crash): status 5: error: no world" in capsys.readouterr().out
    first = began()
    assert campaign("--vary", "mode=held,crash", "--resume") == 5
    assert began()["0000"] == first["0000"] and began()["0001"] != first["0001"]


@pytest.mark.usefixtures("drawn")
def test_a_violation_goes_before_what_did_not_run() -> None:
    assert campaign("--vary", "mode=violated,crash,silent") == 3


def test_settings_and_params_go_where_they_belong() -> None:
    assert campaign("--vary", "seed=1:2,boot=0.5,firmware=px4,version=4.6,param.extra=0,100") == 0
    written = [json.loads(Path(f"out/runs/000{k}/summary.json").read_text()) for k in range(4)]
    assert written[0]["settings"] == {"boot": 0.5, "firmware": "px4", "version": "4.6"}
    assert [w["duration"] for w in written] == [11.0, 111.0, 12.0, 112.0]


def test_scenarios_go_with_their_runs(capsys: pytest.CaptureFixture[str]) -> None:
    Path("a.yaml").write_text("network: {loss: 0.1}\n")
    Path("b.yaml").write_text("events: [{at: 1, crash: bert}]\n")
    words = ("--vary", "scenario=a.yaml,b.yaml", "--lockstep")
    assert campaign(*words) == 0
    written = [json.loads(Path(f"out/runs/000{k}/summary.json").read_text())["scenario"] for k in range(2)]
    assert written == [{"network": {"loss": 0.1}}, {"events": [{"at": 1, "crash": "bert"}]}]
    assert "--scenario=b.yaml" in Path("out/runs/0001/began").read_text()
    Path("b.yaml").write_text("events: []\n")
    assert campaign(*words, "--resume") == 5
    assert "has changed since" in capsys.readouterr().err


def test_a_script_judges(capsys: pytest.CaptureFixture[str]) -> None:
    Path("verdict.py").write_text(
        "import json, sys\n"
        "seconds = json.load(open(sys.argv[1] + '/summary.json'))['duration']\n"
        "print(f'took {seconds} s')\nprint(json.dumps({'half': seconds / 2}))\nsys.exit(seconds > 12)\n"
    )
    assert campaign("--vary", "seed=1:3", "--verdict", "verdict.py") == 3
    out = capsys.readouterr().out
    assert "verdict: once, first in run 0002 (seed 3): took 13.0 s" in out
    assert any(line.split() == ["half", "6", "6", "5.5", "6.5"] for line in out.splitlines())


def test_finished_runs_are_not_repeated_and_half_a_line_is_no_run() -> None:
    assert campaign("--vary", "seed=1:4") == 0
    first = began()
    lines = Path("out/results.jsonl").read_bytes().splitlines(keepends=True)
    Path("out/results.jsonl").write_bytes(b"".join(lines[:3]) + lines[3][:20])
    cut = json.loads(lines[3])["run"]
    assert campaign("--vary", "seed=1:4", "--resume") == 0
    again = began()
    assert {name for name in first if first[name] != again[name]} == {f"{cut:04d}"}
    assert sorted(r["run"] for r in results()) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--vary", "seed=1:2"], "already contains a campaign"),
        (["--vary", "seed=1:3", "--resume"], "other things are varied: seed=1:3"[:26]),
        (["--vary", "seed=1:2", "--resume", "--duration", "3"], "the runs' options are others: none, not --duration=3"),
        (["--vary", "seed=1:2", "--resume", "--runs", "1"], "another number of runs: 2, not 1"),
    ],
)
def test_another_plan_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign("--vary", "seed=1:2") == 0
    first = began()
    assert campaign(*words) == 5
    assert said in capsys.readouterr().err and began() == first


def test_another_bundle_is_refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert campaign("--vary", "seed=1:2") == 0
    monkeypatch.setattr(
        building, "planned", lambda options, targets, **_: ({fake.NAME: {"SHA256SUMS": b"others"}}, "app")
    )
    assert campaign("--vary", "seed=1:2", "--resume") == 5
    assert "the program, the fleet file or koordgen has changed since" in capsys.readouterr().err


def test_folders_of_others_are_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").mkdir()
    Path("out/thesis.tex").write_text("x")
    assert campaign("--vary", "seed=1:2") == 5
    assert "contains files, but no campaign" in capsys.readouterr().err and os.listdir("out") == ["thesis.tex"]
    assert cli.main(["campaign", "a", "--fleet", "f", "--out", "no", "--resume"]) == 5
    assert "no: there is no campaign to resume" in capsys.readouterr().err and not Path("no").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--vary", "seed"], "--runs"), (["--vary", "loss"], "neither"), (["--vary", "height=0,1"], "unrecognized"),
        (["--vary", "seed=1:2", "--runs", "5"], "too few seeds"), (["--vary", "loss=0,many"], "invalid float"),
        (["--vary", "loss=0,many,0.1"], "invalid float"), (["--vary", "boot=1,soon"], "boot=soon: it must be a float"),
        (["--vary", "position_noise=-1,1"], "position_noise=-1: it must be 0 to 1"),
        (["--vary", "out=a,b"], "cannot be varied"),
    ],
)  # fmt: skip
def test_wrong_calls_are_told_before_anything_runs(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert campaign(*words) == 2
    assert said in capsys.readouterr().err and not Path("out").exists()


def test_a_missing_verdict_script_is_told_before_anything_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert campaign("--vary", "seed=1:2", "--verdict", "none.py") == 1
    assert "none.py: no such file" in capsys.readouterr().err and not Path("out").exists()


def test_a_wrong_scenario_in_the_middle_is_told_with_its_place(capsys: pytest.CaptureFixture[str]) -> None:
    for name, text in (("a", "{}"), ("b", "events: [{at: 1, crush: bert}]"), ("c", "{}")):
        Path(f"{name}.yaml").write_text(text + "\n")
    assert campaign("--vary", "scenario=a.yaml,b.yaml,c.yaml") == 1
    assert "b.yaml:1:18: error[F002]: unknown key 'crush'" in capsys.readouterr().err and not Path("out").exists()


def test_progress_is_for_terminals(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert campaign("--vary", "loss=0,0.3") == 3
    err = capsys.readouterr().err
    assert "2 of 2 runs, 1 violated, 0:00 remaining" in err and err.endswith("\n")
    assert campaign("--vary", "loss=0,0.3", "--resume", "--quiet") == 3
    assert capsys.readouterr().err == ""


def test_a_full_disk_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with fake.full_disk(finished=1):
        assert campaign("--vary", "seed=1:4") == 5
    err = capsys.readouterr().err
    assert (
        "the disk is full; 1 of 4 runs are finished; --resume executes the others" in err and "free disk space" in err
    )
    assert campaign("--vary", "seed=1:4", "--resume") == 0
    assert sorted(r["run"] for r in results()) == [0, 1, 2, 3]


def test_a_run_that_the_disk_failed_ends_the_campaign(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store.CampaignStore, "full", lambda self: True)
    assert campaign("--vary", "mode=crash,held") == 5
    assert "the disk is full" in capsys.readouterr().err
    assert all(r["outcome"] != "failed" for r in (results() if Path("out/results.jsonl").exists() else []))


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("drawn")
def test_interrupted_it_can_be_resumed(number: signal.Signals, capsys: pytest.CaptureFixture[str]) -> None:
    """Three runs held, then two hang: these are ended, and begin anew."""

    def interrupt() -> None:
        until(lambda: Path("hangs").exists() and Path("out/results.jsonl").exists() and len(results()) == 3)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=interrupt)
    thread.start()
    words = ("--vary", "mode=held,held,held,once,once")
    started = time.monotonic()
    assert campaign(*words) == 130
    thread.join()
    assert time.monotonic() - started < 15
    told = capsys.readouterr()
    assert "3 of 5 runs are finished; --resume executes the others" in told.err and "2 not yet run" in told.out
    assert json.loads(Path("out/campaign.json").read_text())["held"] == 3
    Path("again").touch()
    first = began()
    assert campaign(*words, "--resume") == 0
    again = began()
    assert all((first[name] == again[name]) == (name < "0003") for name in first)


def test_killed_it_can_be_resumed(tmp_path: Path) -> None:
    """kill -9, while a run hangs."""
    program = (
        "import sys\nfrom koordgen import cli\nfrom koordgen.cli.base import building\n"
        "from koordgen.cli.experiment import campaign\n"
        "from tests.experiment.campaign import fake\n"
        "building.planned = lambda options, targets, **_: ({'sim': {'SHA256SUMS': b'sums'}}, 'app')\n"
        "building.require_packages = lambda: None\ncampaign._builder = lambda options, harness: fake.build\n"
        "cli.main(['campaign', 'app.koord', '--fleet', 'fleet.yaml', '--out', 'out', '--jobs', '2', *sys.argv[1:]])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    words = ["--vary", "mode=held,held,once"]
    child = subprocess.Popen([sys.executable, "-c", program, *words], env=environment, cwd=tmp_path)
    until(lambda: Path("hangs").exists() and Path("out/results.jsonl").exists() and len(results()) == 2)
    child.kill()
    child.wait()
    Path("again").touch()
    assert campaign(*words, "--resume") == 0
    assert sorted(r["run"] for r in results()) == [0, 1, 2]
