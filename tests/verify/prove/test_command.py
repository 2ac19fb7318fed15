"""`koordgen prove`: exit statuses, output, files, and messages about bad input."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.verify.attack.attack import attack
from koordgen.verify.prove.smt.process import memory_limit
from koordgen.verify.prove.smt.solve import Limits, solver_of
from tests.verify.attack.faults import ticks
from tests.verify.prove.programs import CONTRADICTION, COUNTER, CUBES, LINE, SECRET, STRONG

ROOT = Path(__file__).parents[3]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(text: str) -> str:
    Path("app.koord").write_text(text)
    return "app.koord"


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """The report with its times and its numbers of states taken out."""
    import re

    return re.sub(r"\d+ ms(; attacked with [1-9]\d* states?)?\)", "T)", capsys.readouterr().out)


def test_a_proof(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG)]) == 0
    assert told(capsys) == (
        """\
app.koord, for every number of robots

PROVED         Geofence  (3 obligations, T)

PROVED         (well-defined)  (1 obligation, T)
  rests on Geofence

assumed:
  - port assumption: Motion: Motion.position' in Rect(Motion.position, Motion.target) (app.koord:7);
    checked: the simulator checks the assumption in each run (`koordgen docs sim`)
  - initially: forall i in ID: Motion.position[i] in Rect(lo, hi) (app.koord:20); checked: the
    simulator checks the assumption in each run (`koordgen docs sim`)
  - start: every robot's init has a result: otherwise no mission begins (app.koord:12); checked:
    agents hold until every init has a result; a robot whose init is discarded ends (`koordgen docs
    safety`)
  - arithmetic: numbers are real numbers; robots round each result to 53 bits, and to infinity
    beyond 1.8e308; unchecked
  - arithmetic: no event compares NaN, nor keeps or sends NaN or infinity; checked: agents discard
    such an event; a property that compares NaN has no value (`koordgen docs proofs`)
"""
    )


def test_a_counterexample(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(LINE)]) == 3
    shown = told(capsys)
    assert shown.startswith("app.koord, for every number of robots\n\nNOT INDUCTIVE  Geofence  (3 obligations, T)\n")
    assert "a step of the environment, from a state in which all invariants hold" in shown
    assert "false afterwards: Motion.position[i] in Rect(lo, hi), i = 0  (app.koord:23)" in shown
    assert "N_SYS = 1  lo = (0, 0, 0)  hi = (9, 9, 3)" in shown
    assert "add `forall i in ID: Motion.target[i] in Rect(lo, hi)` to Geofence: then it is PROVED" in shown
    changed = [line for line in shown.splitlines() if line.endswith(" *")]
    assert len(changed) == 1 and "Motion.position" in changed[0]
    assert max(map(len, shown.splitlines())) <= 100


def test_a_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(COUNTER)]) == 3
    shown = told(capsys)
    assert "FALSIFIED      Below" in shown and "PROVED         Small" in shown
    assert "Up of robot 0" in shown and "third[0] = 1/3" in shown, "thirds are told exactly"
    assert "false afterwards: n[i] < 3, i = 0  (app.koord:11)" in shown


def test_json(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("koordgen.verify.attack.attack.attack", partial(attack, clock=ticks()))
    assert main(["prove", written(LINE), "--format", "json"]) == 3
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    geofence, defined = found["invariants"]
    keys = {"name", "verdict", "robots", "obligations", "counterexample", "suggestion", "assumptions"}
    assert set(geofence) == set(defined) == keys
    assert (geofence["name"], geofence["verdict"], geofence["robots"]) == ("Geofence", "NOT INDUCTIVE", "any")
    told = {"name", "file", "line", "result", "seconds", "attacked"}
    assert all(set(o) == told | {"not_attacked"} for o in geofence["obligations"])
    assert {o["not_attacked"] for o in geofence["obligations"]} == {"the verdict is not PROVED"}
    assert all(set(o) == told and o["attacked"] > 0 for o in defined["obligations"])
    assert {o["result"] for o in geofence["obligations"]} == {"sat", "unsat"}
    assert geofence["counterexample"]["conjunct"] == "Motion.position[i] in Rect(lo, hi)"
    assert geofence["counterexample"]["run"] is None
    assert "Motion.target[i] in Rect(lo, hi)" in geofence["suggestion"]
    assert (defined["verdict"], defined["counterexample"], defined["suggestion"]) == ("PROVED", None, None)
    assert all(set(a) == {"kind", "text", "file", "line", "checked"} for a in geofence["assumptions"])


def test_numbers_of_robots(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG), "--robots", "2..3", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)["invariants"]
    assert [(v["name"], v["robots"]) for v in found if v["name"] == "Geofence"] == [("Geofence", 2), ("Geofence", 3)]


@pytest.mark.parametrize(
    ("text", "status", "said"),
    [(CONTRADICTION, 4, "VACUOUS        Low"), (CUBES, 4, "UNKNOWN        Right"), ("allread: int x[N_SYS]\n", 1, "")],
)
def test_statuses(folder: Path, capsys: pytest.CaptureFixture[str], text: str, status: int, said: str) -> None:
    assert main(["prove", written(text), "--timeout", "0.3"]) == status
    assert said in capsys.readouterr().out


def test_contradictory_assumptions_are_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(CONTRADICTION)]) == 4
    shown = " ".join(told(capsys).split())
    assert "app.koord:3" in shown and "app.koord:4" in shown and "anything follows" in shown
    assert "PROVED" not in shown


def test_another_robots_state_must_be_named_by_its_robot(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(SECRET)]) == 1
    assert "K054" in capsys.readouterr().err


@pytest.mark.parametrize("robots", ["0", "3..2", "some", "1..", "-1", "any..3", "2000"])
def test_wrong_numbers_of_robots_are_usage(folder: Path, robots: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["prove", written(STRONG), f"--robots={robots}"])
    assert ended.value.code == 2


def test_params(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(LINE), "--param", "lo=1,1,1", "--param", "hi=2,2,2"]) == 3
    assert "lo = (1, 1, 1)  hi = (2, 2, 2)" in told(capsys)
    assert main(["prove", written(LINE), "--param", "low=1,1,1"]) == 2
    assert "no param 'low'" in capsys.readouterr().err
    assert main(["prove", written(LINE), "--param", "lo=three"]) == 2


def test_without_a_solver(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(folder / "python"))
    monkeypatch.setenv("PATH", str(folder))
    assert main(["prove", written(STRONG)]) == 5
    message = capsys.readouterr().err
    assert "solver z3 not found" in message and "koordgen[prove]" in message


def stand_in(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """A solver z3 of our own."""
    (folder / "z3").write_text(text)
    (folder / "z3").chmod(0o755)
    monkeypatch.setattr("koordgen.verify.prove.smt.solve.GRACE", 0.05)
    monkeypatch.setattr(sys, "executable", str(folder / "python"))


def test_a_solver_that_lies_proves_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(folder, monkeypatch, "#!/bin/sh\nwhile read line; do echo unsat; echo unsat; done\n")
    assert main(["prove", written(STRONG), "--timeout", "0.1"]) == 4
    assert "PROVED" not in capsys.readouterr().out


KILLED = "#!/bin/sh\nread line\nkill -9 $$\n"
SILENT = "#!/bin/sh\nexec sleep 60\n"
# It is killed when three are answered, of which none counts then; asked alone it never comes to an end.
HALF = """#!/bin/sh
while read line; do
  case "$line" in *check-sat*) echo unsat;; *echo*batch*) echo koordgen-batch; n=$((n+1));; esac
  [ "$n" = 3 ] && kill -9 $$
done
"""


@pytest.mark.parametrize(("text", "why"), [(KILLED, "killed by signal 9"), (SILENT, "in time"), (HALF, "in time")])
def test_a_solver_that_ends_or_says_nothing_proves_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, text: str, why: str
) -> None:
    stand_in(folder, monkeypatch, text)
    assert main(["prove", written(STRONG), "--timeout", "0.05"]) == 4
    said = " ".join(capsys.readouterr().out.split())
    assert "PROVED" not in said and "Geofence-init (app.koord:" in said, "the obligation is named"
    assert why in said


def test_a_solver_that_is_gone_before_it_is_asked_proves_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where it finds no memory to load its libraries, and we come to look only then."""
    stand_in(folder, monkeypatch, "#!/bin/sh\nexit 127\n")
    monkeypatch.setattr("resource.prlimit", lambda pid, *_: os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT))
    assert main(["prove", written(STRONG)]) == 4
    said = " ".join(capsys.readouterr().out.split())
    assert "PROVED" not in said and "z3 ended with status 127" in said


def test_a_solver_without_memory_proves_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("koordgen.verify.prove.smt.solve.Limits", lambda **given: Limits(memory=4, **given))
    assert main(["prove", written(STRONG)]) == 4
    said = " ".join(capsys.readouterr().out.split())
    assert "PROVED" not in said and "limited to 4 MB" in said


def test_a_solver_has_no_more_memory_than_we_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (100 << 20, 200 << 20))
    assert (memory_limit(2048), memory_limit(50)) == (100, 50)


def test_a_trace_of_the_counterexample(folder: Path) -> None:
    assert main(["prove", written(COUNTER), "--trace", "trace.jsonl"]) == 3
    lines = [json.loads(line) for line in Path("trace.jsonl").read_text().splitlines()]
    assert lines[0]["kind"] == "header" and lines[0]["format"] == "koord-trace/2"
    assert lines[-1]["kind"] == "violation" and lines[-1]["name"] == "Below"
    assert lines[-1]["line"] == "app.koord:11" and lines[-1]["detail"] == "false: n[i] < 3"
    values = [line["shared"]["n"] for line in lines if line["kind"] == "round" and line["pid"] == 0]
    assert values[-1] == 3 and values == sorted(values)
    assert main(["prove", written(COUNTER), "--trace", "no/such/folder/trace"]) == 5


@pytest.mark.parametrize(("text", "name"), [(COUNTER, "Below"), (LINE, "Geofence")])
def test_a_report_shows_the_trace_and_a_replay_says_why_it_does_not(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, name: str
) -> None:
    assert main(["prove", written(text), "--trace", "trace.jsonl"]) == 3
    assert main(["report", "trace.jsonl"]) == 0
    assert name in Path("report.html").read_text()
    capsys.readouterr()
    assert main(["replay", "trace.jsonl", "--program", "app.koord"]) == 1
    assert "not of a run: `koordgen sim --follow` runs it with agents" in capsys.readouterr().err


def test_without_a_counterexample_no_trace_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", written(STRONG), "--trace", "trace.jsonl"]) == 0
    assert not Path("trace.jsonl").exists()
    assert "no counterexample" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["", "app.koord", "/dev/full"])
def test_what_cannot_be_written_takes_no_verdict_away(
    folder: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    assert main(["prove", written(STRONG), f"--emit={place}"]) == 5
    told = capsys.readouterr()
    assert "PROVED         Geofence" in told.out and "--emit" in told.err and "-o" not in told.err.split()
    assert main(["prove", written(COUNTER), "--trace=/dev/full"]) == 5
    assert "No space left" in capsys.readouterr().err


def emitted(folder: Path, text: str) -> list[Path]:
    main(["prove", written(text), "--emit", "smt"])
    return sorted((folder / "smt").glob("*.smt2"))


def test_files_are_the_same_bytes_each_time_whatever_the_hash_seed(folder: Path) -> None:
    found = {}
    for seed in ("0", "1"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "koordgen", "prove", written(LINE), "--emit", f"out{seed}"]
        assert subprocess.run(command, env=environment, stdout=subprocess.DEVNULL).returncode == 3
        found[seed] = {p.name: p.read_bytes() for p in (folder / f"out{seed}").iterdir()}
    assert found["0"] == found["1"]


def test_a_file_is_readable(folder: Path) -> None:
    text = next(p for p in emitted(folder, STRONG) if p.stem == "Geofence-environment").read_text()
    assert text.startswith("; app.koord:")
    assert "(set-info :status unsat)\n" in text and "(set-info :smt-lib-version 2.6)\n" in text
    assert "app.koord:7: assume position' in Rect(position, target)" in text, "the program's own line"
    assert "to be shown, therefore negated" in text
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize("name", ["z3", "cvc5"])
def test_every_file_gets_the_answer_that_it_expects(folder: Path, name: str) -> None:
    from koordgen.verify.prove.smt.solve import command_of

    files = emitted(folder, STRONG)
    assert len(files) >= 6
    for path in files:
        asked = f'{path.read_text().replace("(exit)", "")}(echo "end")\n'
        command = command_of(name, 1024)
        said = subprocess.run(command, input=f"(reset)\n{asked}", capture_output=True, text=True, timeout=30).stdout
        wanted = "sat" if path.stem.startswith("consistency") else "unsat"
        assert said.replace('"', "").split() == [wanted, "end"], path.name


@pytest.mark.parametrize("name", ["z3", "cvc5"])
def test_what_was_proved_in_a_second_try_is_written_as_it_was_proved(folder: Path, name: str) -> None:
    files = emitted(folder, (ROOT / "examples/patrol/patrol.koord").read_text())
    with solver_of(name, Limits()) as solver:
        process = solver.command  # type: ignore[union-attr]
    for path in files:
        asked = f'{path.read_text().replace("(exit)", "")}(echo "end")\n'
        said = subprocess.run(process, input=f"(reset)\n{asked}", capture_output=True, text=True, timeout=30).stdout
        wanted = "sat" if path.stem.startswith("consistency") else "unsat"
        assert said.replace('"', "").split() == [wanted, "end"], path.name


@pytest.mark.skipif(shutil.which("sh") is None, reason="needs a shell")
def test_the_script_checks_offline_and_notices_a_wrong_answer(folder: Path) -> None:
    files = emitted(folder, STRONG)
    solver = solver_of("z3", Limits()).command[0]  # type: ignore[union-attr]
    run = subprocess.run(["sh", "smt/run.sh", solver], capture_output=True, text=True)
    assert run.returncode == 0 and f"{len(files)} obligations, 0 not as expected" in run.stdout
    broken = next(p for p in files if p.stem == "Geofence-environment")
    broken.write_text(broken.read_text().replace(":status unsat", ":status sat"))
    run = subprocess.run(["sh", "smt/run.sh", solver], capture_output=True, text=True)
    assert run.returncode == 3 and "WRONG Geofence-environment.smt2: unsat, where sat is expected" in run.stdout
    assert subprocess.run(["sh", "smt/run.sh", "no-such-solver"], capture_output=True).returncode == 5


def test_a_folder_that_is_not_ours_stays(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine").mkdir()
    (folder / "mine/thesis.tex").write_text("years of work")
    assert main(["prove", written(STRONG), "--emit", "mine"]) == 5
    assert "thesis.tex" in capsys.readouterr().err
    assert [p.name for p in (folder / "mine").iterdir()] == ["thesis.tex"]
    assert main(["prove", written(STRONG), "--emit", "ours"]) == 0
    assert main(["prove", written(LINE), "--emit", "ours"]) == 3, "ours may be written again"
