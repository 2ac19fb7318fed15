"""`koordgen validate` over fake bundles: statuses, output, continuation, bad options."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from koordgen import cli
from koordgen.cli.base import building, console
from koordgen.cli.experiment import campaign as campaigns
from koordgen.experiment.campaign import store
from koordgen.experiment.campaign.plan import CampaignPlan
from koordgen.experiment.validate import picture
from tests.experiment.campaign.fake import full_disk
from tests.experiment.validate import fake

OUT = Path("out")
PLANNED = {"SHA256SUMS": b"sums", "scenario.json": b'{"harness": {"start_noise": 0.3}, "program_hash": "0"}'}
PROGRAM = """
using Motion:
  sensors: Point position
  actuators: Point target



  assume position' in Rect(position, target)
Go:
  pre: True
  eff: Motion.target = Motion.position
invariant Somewhere: forall i in ID: Motion.position[i] == Motion.position[i]
"""


@pytest.fixture(autouse=True)
def faked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(building, "planned", lambda options, targets, **_: ({fake.NAME: PLANNED}, "app"))
    monkeypatch.setattr(building, "require_packages", lambda: None)
    monkeypatch.setattr(campaigns, "_builder", lambda options, harness: fake.build)
    monkeypatch.setattr("koordgen.cli.experiment.validate.fleet_params", lambda *_, **more: {})
    monkeypatch.setattr(
        picture, "draw", lambda found, title, path: bool(path.write_bytes(b"")) or True
    )  # it takes long
    monkeypatch.chdir(tmp_path)
    Path("app.koord").write_text(PROGRAM)


def validate(*words: str) -> int:
    return cli.main(["validate", "app.koord", "--fleet", "fleet.yaml", "--out", "out", "--jobs", "2", *words])


def runs() -> list[str]:
    return sorted(path.name for path in Path("out/runs").iterdir())


def test_validated(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--epsilon", "0.5", "--gamma", "0.2", "--seconds", "7")
    assert validate(*words) == 0
    told = capsys.readouterr()
    assert "quad full  VALIDATED     4         0" in told.out and told.err == ""
    assert "app.koord on fleet.yaml: 4 of 4 runs of 7 s, seeds 1 to 4" in told.out
    assert "within 0.3 m (and rad) of the fleet file's" in told.out
    assert (
        "VALIDATED: with confidence 0.8, a run from these starts violates an assumption with a probability below 0.5"
        in told.out
    )
    assert Path("out/windows.png").exists() and Path("out/validation.txt").exists()
    assert Path("out/runs/0002/began").read_text() == (
        "koordgen sim app.koord --fleet=fleet.yaml --duration=7 --lockstep --seed=3 --out=out/runs/0002"
    )
    assert validate(*words, "--format", "json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads(Path("out/validation.json").read_text())
    assert (found["format"], found["verdict"], found["needed"]) == ("koord-validation/1", "VALIDATED", 4)


def test_more_samples_go_on_with_those_that_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert validate("--samples", "2") == 4
    out = capsys.readouterr().out
    assert "quad full: 58 more samples wanted" in out and "runs without a violation are needed" in out
    first = Path("out/runs/0001/began").stat().st_mtime_ns
    assert validate("--samples", "5") == 4
    assert "55 more samples wanted" in capsys.readouterr().out
    assert len(runs()) == 5 and Path("out/runs/0001/began").stat().st_mtime_ns == first
    assert validate("--samples", "2", "--seed", "9") == 5
    assert (
        "out: contains a validation with another plan: other things are varied: seed=1:, not seed=9:"
        in capsys.readouterr().err
    )
    plan = CampaignPlan("app", "", "", (), (), 3)
    with (
        pytest.raises(store.FolderUnusable, match="out: contains a validation, not a campaign"),
        store.claimed(OUT, plan, True),
    ):
        pass


def test_violated(capsys: pytest.CaptureFixture[str]) -> None:
    assert validate("--seed", "100", "--samples", "4", "--format", "json") == 3
    found = json.loads(capsys.readouterr().out)
    quad, car = found["assumptions"]
    assert (quad["platform"], quad["verdict"]) == ("quad full", "INCONCLUSIVE")
    assert (car["platform"], car["verdict"], car["violated"], car["runs"]) == ("car full", "VIOLATED", 2, 4)
    worst = car["worst"]
    assert (worst["run"], worst["seed"], worst["robot"]) == (1, 101, "robot1")
    assert worst["breach"]["kind"] == "across" and worst["breach"]["distance"] == 0.04
    assert worst["replay"] == "koordgen replay out/runs/0001"
    assert worst["command"].endswith("--lockstep --seed=101 --out=out/runs/0001-again")
    assert [s["margin"] for s in found["suggestions"]] == [0.3, 5.0]
    assert all(s["closes"] for s in found["suggestions"]), "this invariant always holds"
    assert validate("--seed", "100", "--samples", "4") == 3
    out = capsys.readouterr().out
    assert "car full: across, 2 windows, at most 0.040 m outside the box in one, 0.040 m in a row" in out
    assert "The prover proves all invariants with: assume position' in Rect" in out


def test_a_run_that_fails_leaves_it_inconclusive(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--seed", "948", "--samples", "3", "--epsilon", "0.9", "--gamma", "0.9")
    Path("again").touch()
    assert validate(*words) == 3, "949 violates"
    capsys.readouterr()
    assert cli.main(["validate", "app.koord", "--fleet", "f", "--out", "o", "--seed", "950", "--samples", "1"]) == 4
    out = capsys.readouterr().out
    assert "some runs did not finish; the first reason: status 5: error: no world" in out and "INCONCLUSIVE" in out


def test_a_program_that_assumes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    Path("app.koord").write_text(PROGRAM.replace("  assume position' in Rect(position, target)\n", ""))
    assert validate() == 4
    err = capsys.readouterr().err
    assert (
        "app.koord has no assumptions about its ports" in err
        and "`assume position'" in err
        and not Path("out").exists()
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--epsilon", "0"], "a probability from 1e-06 to 0.999, not 0"), (["--gamma", "1"], "0.999, not 1"),
        (["--epsilon", "nan"], "0.999, not nan"), (["--gamma", "x"], "0.999, not x"),
        (["--samples", "0"], "a whole number from 1 on, not 0"),
        (["--seconds", "0"], "expected seconds from 0.01 to 86400, not 0"),
        (["--seed", "-1"], "a whole number from 0 on, not -1"),
        (["--jobs", "1.5"], "a whole number from 1 on, not 1.5"),
        (["--offset", "1,2"], "expected X,Y,Z in metres, such as 0.7,0.4,0, not 1,2"),
    ],
)  # fmt: skip
def test_wrong_calls(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        validate(*words)
    assert left.value.code == 2 and said in capsys.readouterr().err and not Path("out").exists()


def test_a_missing_simulator_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise console.Failure(console.SURROUNDINGS, "packages are missing: pybullet")

    monkeypatch.setattr(building, "require_packages", missing)
    assert validate() == 5 and not Path("out").exists()


def test_folders_of_others_are_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").mkdir()
    Path("out/thesis.tex").write_text("x")
    assert validate("--samples", "1") == 5 and os.listdir("out") == ["thesis.tex"]


def test_a_full_disk_is_told_and_one_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    with full_disk(finished=1):
        assert validate("--samples", "3") == 5
    err = capsys.readouterr().err
    assert "the disk is full; 1 of 3 runs are finished; the same command executes the others" in err
    assert validate("--samples", "3") == 4 and len(runs()) == 3


def test_interrupted_it_keeps_what_was_finished(capsys: pytest.CaptureFixture[str]) -> None:
    def finished() -> list[Any]:
        path = Path("out/results.jsonl")
        return path.read_text().splitlines() if path.exists() else []

    def interrupt() -> None:
        end = time.monotonic() + 20
        while not (Path("hangs").exists() and len(finished()) == 2) and time.monotonic() < end:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    assert validate("--seed", "898", "--samples", "3") == 130
    thread.join()
    told = capsys.readouterr()
    assert "2 of 3 runs are finished; the same command executes the others" in told.err
    assert "VIOLATED" in told.out, "899 is"
    Path("again").touch()
    assert validate("--seed", "898", "--samples", "3") == 3 and len(finished()) == 3
