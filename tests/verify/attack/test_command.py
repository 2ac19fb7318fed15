"""`koordgen prove` with its attack: counts, UNSOUND and its file, `--attack` and `--attack-from`."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.verify.attack.attack import attack
from koordgen.verify.prove.report.verdict import InvariantVerdict, Question, prove
from koordgen.verify.prove.smt.solve import ObligationResult, SolverAnswer
from tests.verify.attack.faults import FAULTS, ticks
from tests.verify.prove.programs import COUNTER, STRONG

FAULT = FAULTS["a value written before a loop"].lstrip()
RIGHT = FAULT.replace("a = 7", "a = 0")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The budget is one of work, not of seconds."""
    monkeypatch.setattr("koordgen.verify.attack.attack.attack", partial(attack, clock=ticks()))


@pytest.fixture
def forged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A prover that says PROVED of everything."""

    def forge(question: Question, solver: Any) -> list[InvariantVerdict]:
        found, said = prove(question, solver), []
        names = [v.invariant for v in found]
        for verdict in found:
            outcomes = tuple([ObligationResult(o.obligation, SolverAnswer("unsat", 0.001)) for o in verdict.outcomes])
            rests = tuple(
                [name for name in names if name != verdict.invariant and verdict.invariant != "(well-defined)"]
            )
            said.append(verdict._replace(verdict="PROVED", outcomes=outcomes, explanation=None, rests_on=rests))
        return said

    monkeypatch.setattr("koordgen.verify.prove.report.verdict.prove", forge)


def written(text: str) -> str:
    Path("app.koord").write_text(text)
    return "app.koord"


def test_a_verdict_says_how_many_states_were_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG), "--format", "json"]) == 0
    verdicts = json.loads(capsys.readouterr().out)["invariants"]
    counts = {o["name"]: o["attacked"] for v in verdicts for o in v["obligations"]}
    assert all(counts.values()) and set(counts) >= {"Geofence-init", "Geofence-TargetUpdate", "Geofence-environment"}
    assert main(["prove", written(STRONG)]) == 0
    assert " ms; attacked with " in capsys.readouterr().out


def test_the_attack_can_be_switched_off_and_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG), "--attack", "0"]) == 0
    shown = capsys.readouterr().out
    assert "attacked with 0 states)" in shown
    assert "not attacked: the attack is switched off by `--attack 0`" in shown
    assert main(["prove", written(STRONG), "--attack=0", "--format=json"]) == 0
    verdicts = json.loads(capsys.readouterr().out)["invariants"]
    assert {o["attacked"] for v in verdicts for o in v["obligations"]} == {0}
    assert {o["not_attacked"] for v in verdicts for o in v["obligations"]} == {
        "the attack is switched off by `--attack 0`"
    }


@pytest.mark.parametrize("seconds", ["-1", "soon", "1e9"])
def test_wrong_budgets_are_usage(folder: Path, seconds: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["prove", written(STRONG), f"--attack={seconds}"])
    assert ended.value.code == 2


def test_obligations_that_were_not_attacked_are_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "local: int a\nGo:\n  pre: a == 0\n  eff: a = half(4)\ninvariant Q: forall i in ID: a[i] >= 0\n"
    extern = "extern fun half(int x) -> int:\n  ensures: result >= 0\n"
    assert main(["prove", written(extern + text)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "not attacked Q-Go: the result of the extern function half is unknown" in shown


def test_each_number_of_robots_is_attacked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG), "--robots", "3..5", "--format", "json"]) == 0
    verdicts = [v for v in json.loads(capsys.readouterr().out)["invariants"] if v["name"] == "Geofence"]
    assert [v["robots"] for v in verdicts] == [3, 4, 5]
    assert [v["obligations"][0]["attacked"] > 0 for v in verdicts] == [True, True, False]
    assert verdicts[2]["obligations"][0]["not_attacked"] == "only fleets of at most 4 robots are attacked"


def test_a_contradicted_verdict_is_unsound(folder: Path, forged: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(FAULT)]) == 70
    told = capsys.readouterr()
    shown = " ".join(told.out.split())
    assert "UNSOUND Q" in shown and "PROVED Q" not in shown
    assert "after Go of robot 0, in a fleet of 1, it is false" in shown
    assert "a mistake of koordgen, not of your program" in told.err
    assert "report app.unsound.json together with app.koord" in told.err
    assert "`koordgen prove app.koord --attack-from app.unsound.json`" in told.err
    assert json.loads(Path("app.unsound.json").read_text())["invariant"] == "Q"


def test_what_rests_on_an_unsound_verdict_is_not_known(
    folder: Path, forged: None, capsys: pytest.CaptureFixture[str]
) -> None:
    text = FAULT + "invariant R: forall i in ID: a[i] <= 0 and a[i] >= 0\n"
    assert main(["prove", written(text), "--format", "json"]) == 70
    verdicts = {v["name"]: v for v in json.loads(capsys.readouterr().out)["invariants"]}
    assert verdicts["Q"]["verdict"] == "UNSOUND"
    assert verdicts["R"]["verdict"] == "UNKNOWN"
    assert verdicts["R"]["suggestion"] == "its proof rests on Q, which is UNSOUND"


def test_a_place_where_nothing_can_be_written_takes_no_verdict_away(
    folder: Path, forged: None, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("app.unsound.json").mkdir()
    assert main(["prove", written(FAULT)]) == 70
    told = capsys.readouterr()
    assert "UNSOUND" in told.out and "app.unsound.json: Is a directory" in told.err


def contradicted(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    main(["prove", written(FAULT)])
    capsys.readouterr()
    return "app.unsound.json"


def test_a_contradiction_is_repeated_from_its_file(
    folder: Path, forged: None, capsys: pytest.CaptureFixture[str]
) -> None:
    name = contradicted(folder, capsys)
    assert main(["prove", "app.koord", "--attack-from", name]) == 70
    shown = capsys.readouterr().out
    assert "a[0] = 7" in shown and "Go of robot 0" in shown
    assert "false afterwards: a[i] == 0, i = 0" in shown
    assert "UNSOUND: Q: it is false, after Go of robot 0, in a fleet of 1" in shown


def test_a_file_of_another_program_is_refused(folder: Path, forged: None, capsys: pytest.CaptureFixture[str]) -> None:
    name = contradicted(folder, capsys)
    assert main(["prove", written(RIGHT), "--attack-from", name]) == 1
    said = capsys.readouterr().err
    assert "the file was written for another program" in said and "help: give the program for which" in said


def test_a_trial_that_contradicts_nothing_says_so(
    folder: Path, forged: None, capsys: pytest.CaptureFixture[str]
) -> None:
    name = contradicted(folder, capsys)
    document = json.loads(Path(name).read_text())
    document["steps"] = [document["steps"][0], {"event": "(environment)", "sensors": [{}]}]
    Path(name).write_text(json.dumps(document))
    assert main(["prove", "app.koord", "--attack-from", name]) == 0
    assert "no contradiction: after the last step Q hold" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "status", "said"),
    [
        ({"state": None}, 1, "the state is not an object"),
        ({"steps": [{"event": "Go", "robot": 0, "answers": []}] * 2}, 1, "contradicts no verdict: "),
        ({"proved": ["R"]}, 1, "is none of the allowed names"),
    ],
)
def test_a_file_that_is_wrong_is_told_so(
    folder: Path, forged: None, capsys: pytest.CaptureFixture[str], change: dict[str, Any], status: int, said: str
) -> None:
    name = contradicted(folder, capsys)
    Path(name).write_text(json.dumps({**json.loads(Path(name).read_text()), **change}))
    assert main(["prove", "app.koord", "--attack-from", name]) == status
    told = capsys.readouterr().err
    assert said in told and "help: " in told


def test_a_file_that_is_not_there_is_told_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(RIGHT), "--attack-from", "no.json"]) == 1
    assert "no.json: No such file or directory" in capsys.readouterr().err


def test_a_falsified_invariant_is_not_attacked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(COUNTER)]) == 3
    assert not Path("app.unsound.json").exists()
