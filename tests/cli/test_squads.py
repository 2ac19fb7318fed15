"""Fleet files with squads on the command line: most take them, and other commands refuse them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from koordgen.build.pipeline import plan_file
from koordgen.cli import main
from tests.build.squad_files import LINEFORM, fleet_files

GEOFENCE = LINEFORM.parent / "geofence.koord"
ROOT = LINEFORM.parents[2]


def columns(folder: Path) -> Path:
    """Write fleet files whose inner program is that of the page on proofs. Return the outer fleet file."""
    outer = fleet_files(folder)
    page = (ROOT / "docs/explanation/proofs.md").read_text()
    (text,) = re.findall(r"```koord\n(# column.koord\n.*?)```", page, re.DOTALL)
    (folder / "triangle.koord").write_text(text)
    return outer


def test_a_program_is_checked_together_with_a_fleet_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = fleet_files(tmp_path)
    assert main(["check", str(LINEFORM), "--fleet", str(outer)]) == 0
    assert main(["check", str(LINEFORM), "--fleet", str(LINEFORM.parent / "fleet.yaml")]) == 0
    assert not list(tmp_path.glob("build")), "nothing is written"
    capsys.readouterr()
    (tmp_path / "triangle.koord").write_text((tmp_path / "triangle.koord").read_text().replace("Motion:", "Drive:", 1))
    assert main(["check", str(LINEFORM), "--fleet", str(outer)]) == 1
    assert "lineform.koord:3:1: error[B014]: the robot alpha has no module Motion" in capsys.readouterr().err
    assert main(["check", str(outer), "--fleet", str(outer)]) == 2


def test_bundles_are_written_for_both_levels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["build", str(LINEFORM), "--fleet", str(fleet_files(tmp_path)), "-o", str(tmp_path / "build")]
    assert main(command) == 0
    folder = tmp_path / "build/lineform"
    names = ["alpha.ann", "alpha.bob", "alpha.cyd", "beta.eve", "beta.fay", "beta.gus", "dora", "fleet"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert f"{folder / 'alpha.ann'}  " in capsys.readouterr().out
    assert main([*command, "--target", "car"]) == 0
    note = "leaves out alpha.ann, alpha.bob, alpha.cyd, beta.eve, beta.fay, beta.gus;"
    assert note in capsys.readouterr().err


@pytest.mark.parametrize(
    "command", [["explore"], ["validate", "--reachsets"]],
    ids=lambda command: command[0],
)  # fmt: skip
def test_other_commands_refuse_squads(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *options = command
    assert main([name, str(GEOFENCE), "--fleet", str(fleet_files(tmp_path)), *options]) == 1
    assert "outer.yaml:6:26: error[F005]: alpha is a fleet itself, which this" in capsys.readouterr().err


def test_both_levels_are_proved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = str(columns(tmp_path))
    assert main(["prove", str(GEOFENCE), "--fleet", outer, "--attack", "0"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "alpha, beta of geofence.koord: a fleet of triangle.koord, for every number of inner robots" in text
    assert "at most three inner rounds (0.3 s)" in text, "the rounds of the inner fleets take 0.1 s"
    assert "checked: PROVED of triangle.koord for alpha, beta, see below; the simulator checks" in text
    assert "assumed in triangle.koord:" in text and text.endswith("which no program describes: dora")
    assert main(["prove", str(GEOFENCE), "--fleet", outer, "--attack", "0", "--format", "json"]) == 0
    (level,) = json.loads(capsys.readouterr().out)["levels"]
    assert level["robots"] == ["alpha", "beta"]
    assert [(each["verdict"], each["slack_seconds"]) for each in level["assumptions"]] == [("PROVED", 0.3)]


def test_inner_programs_with_other_params_are_proved_for_themselves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outer = columns(tmp_path)
    text = (tmp_path / "triangle.koord").read_text()
    text = text.replace("allwrite:", "param float reach = 0.5\nallwrite:", 1)
    (tmp_path / "triangle.koord").write_text(text.replace("(centre + goal) / 2", "centre + (goal - centre) * reach"))
    fleet = (tmp_path / "beta.yaml").read_text()
    (tmp_path / "alpha.yaml").write_text(
        (tmp_path / "alpha.yaml").read_text().replace("triangle.koord}", "triangle.koord, params: {reach: 0.5}}")
    )
    (tmp_path / "beta.yaml").write_text(fleet.replace("triangle.koord}", "triangle.koord, params: {reach: 2.0}}"))
    command = ["prove", str(GEOFENCE), "--fleet", str(outer), "--attack", "0", "--format", "json"]
    assert main(command) == 4
    found = json.loads(capsys.readouterr().out)["levels"]
    verdicts = {name: each["assumptions"][0]["verdict"] for each in found for name in each["robots"]}
    assert verdicts == {"alpha": "PROVED", "beta": "UNPROVED"}, "a step of beta goes beyond its goal"


def test_what_is_not_proved_may_be_validated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = columns(tmp_path)
    inner = tmp_path / "triangle.koord"
    inner.write_text(inner.read_text().replace("(centre + goal) / 2", "centre + (goal - centre) * 2"))
    scenario = json.loads(plan_file(str(GEOFENCE), ["sim"], str(outer), {}, squads=True)[1]["sim"]["scenario.json"])
    hashes = {each["name"]: each["program_hash"] for each in scenario["fleets"]}
    robots = [{"name": name, "windows": 300} for name in ("alpha", "beta")]
    kept = {"line": 11, "verdict": "VALIDATED", "runs": 60, "robots": robots}
    report = {"format": "koord-validation/1", "hashes": hashes, "epsilon": 0.05, "gamma": 0.05, "seconds": 30.0}
    file = tmp_path / "validation.json"
    command = ["prove", str(GEOFENCE), "--fleet", str(outer), "--attack", "0", "--validation", str(file)]

    def said(**changes: Any) -> tuple[int, str]:
        file.write_text(json.dumps({**report, "assumptions": [kept], **changes}))
        status, told = main(command), capsys.readouterr()
        return status, " ".join((told.out + told.err).split())

    status, text = said()
    assert status == 4 and "VALIDATED assume Motion.position' in Rect(Motion.position, Motion.target)" in text
    assert "not proved: it is not kept: the event" in text and "checked: VALIDATED of triangle.koord for alpha" in text
    assert "60 simulated runs of 30 s kept it: a run violates it with a probability below 0.05" in text
    for less in ({"verdict": "INCONCLUSIVE"}, {"robots": robots[:1]}, {"line": 12}):
        assert "UNPROVED assume" in said(assumptions=[{**kept, **less}])[1], less
    for name in hashes:
        status, text = said(hashes={**hashes, name: "0" * 16})
        assert status == 2 and "is about other programs, params or squads than these" in text
    assert said(format="koord-trace/2")[0] == 2
    file.unlink()
    assert main(command) == 5 and "No such file" in capsys.readouterr().err


def test_an_inner_program_that_shares_variables_with_others_is_not_proved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outer = columns(tmp_path)
    text = (tmp_path / "triangle.koord").read_text()
    (tmp_path / "triangle.koord").write_text(f"export:\n  write Point centre\n{text}")
    assert main(["prove", str(GEOFENCE), "--fleet", str(outer)]) == 4
    assert "triangle.koord shares variables with other applications" in capsys.readouterr().err


def test_a_fleet_file_names_the_inner_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outer = columns(tmp_path)
    assert main(["prove", str(GEOFENCE), "--fleet", str(outer), "--inner", str(tmp_path / "triangle.koord")]) == 2
    assert "names the fleets that are robots, but --inner is given as well" in capsys.readouterr().err


@pytest.mark.slow
def test_a_campaign_simulates_squads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outer = fleet_files(tmp_path)
    for file in tmp_path.glob("*.yaml"):
        text = file.read_text().replace("target: quad,", "target: quad, sim: {fidelity: simple},")
        file.write_text(text.replace("target: car,", "target: car, sim: {fidelity: simple},"))
    command = ["campaign", str(LINEFORM), "--fleet", str(outer), "--vary", "seed=1:2", "--lockstep", "--duration", "1"]
    assert main(command) in (0, 3)
    assert "lineform: 2 runs" in capsys.readouterr().out
