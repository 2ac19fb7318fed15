"""`koordgen prove fleet.yaml`: output, files and exit status."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import patch

import pytest

from koordgen.cli import main
from koordgen.verify.attack.system_runs import SystemAttack, SystemContradiction
from tests.programs import QUAD_AND_CAR
from tests.verify.prove.compositions.systems import KNOWN

ENTRIES = """\
  - {name: counter, program: counter.koord}
  - {name: user, program: user.koord, robots: [bert], import: {Counter: counter}}
"""
HOLDS = "an exporter's invariant that a guarantee protects"
FAILS = "a plain write breaks a step guarantee"


def fleet(folder: Path, name: str) -> str:
    known = KNOWN[name]
    (folder / "counter.koord").write_text(known.counter.lstrip())
    (folder / "user.koord").write_text(known.user.lstrip())
    (folder / "fleet.yaml").write_text(QUAD_AND_CAR + ENTRIES)
    return str(folder / "fleet.yaml")


def test_a_fleet_whose_applications_keep_their_guarantees_is_proved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prove", fleet(tmp_path, HOLDS), "--emit", str(tmp_path / "smt")]) == 0
    out = capsys.readouterr().out
    assert "counter: counter.koord, for every number of robots" in out and "user: user.koord" in out
    assert "PROVED         guarantee counter.Positive" in out and "attacked with" in out
    text = (tmp_path / "smt/user-guarantee-counter-Positive-Put.smt2").read_text()
    assert "; user.koord:" in text and "guarantee Positive: n >= 1" in text


def test_a_guarantee_that_fails_is_named_with_its_application(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prove", fleet(tmp_path, FAILS), "--format", "json"]) == 3
    entries = json.loads(capsys.readouterr().out)["invariants"]
    said = {(e["application"], e["name"]): e for e in entries}
    assert said["user", "guarantee counter.Rising"]["verdict"] == "NOT INDUCTIVE"
    assert "under `atomic`" in said["user", "guarantee counter.Rising"]["suggestion"]
    assert said["counter", "guarantee counter.Rising"]["verdict"] == "UNKNOWN"


@pytest.mark.parametrize("option", [["--robots", "3"], ["--param", "n=1"], ["--trace", "t"], ["--attack-from", "f"]])
def test_options_of_single_programs_are_refused(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prove", fleet(tmp_path, HOLDS), *option]) == 2
    assert f"{option[0]} is for a single program" in capsys.readouterr().err


def test_a_contradicted_verdict_is_unsound_and_nothing_else_is_relied_upon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contradiction = SystemContradiction("counter", "Low", ("init", "Put of user on robot 1 in round 1"), 2)
    said = SystemAttack({}, {}, "", contradiction)
    with patch("koordgen.verify.attack.system_runs.attack_system", lambda *_: said):
        assert main(["prove", fleet(tmp_path, HOLDS)]) == 70
    shown = capsys.readouterr()
    assert "UNSOUND        Low" in shown.out and "Put of user on robot 1 in round 1" in " ".join(shown.out.split())
    assert "PROVED  " not in shown.out and "mistake of koordgen" in shown.err


def test_without_an_attack_the_output_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", fleet(tmp_path, HOLDS), "--attack", "0"]) == 0
    assert "not attacked: the attack is switched off by `--attack 0`" in capsys.readouterr().out


def test_the_example_survey_is_proved(capsys: pytest.CaptureFixture[str]) -> None:
    survey = Path(__file__).parents[4] / "examples/survey/fleet.yaml"
    assert main(["prove", str(survey), "--format", "json", "--attack", "0"]) == 0
    verdicts = {(v["application"], v["name"]): v["verdict"] for v in json.loads(capsys.readouterr().out)["invariants"]}
    assert {("mapping", "GlobalTruth"), ("mapping", "guarantee mapping.Truth"), ("task", "Separation")} <= set(verdicts)
    assert set(verdicts.values()) == {"PROVED"}
