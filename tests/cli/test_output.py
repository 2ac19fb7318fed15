"""Output for programs: closed pipes, no progress, one document with the verdict, colours on demand."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.cli.experiment.harness import ALONE

ROOT = Path(__file__).parents[2]
LINEFORM = ROOT / "examples/lineform/lineform.koord"
SIM = ["sim", str(LINEFORM), "--fleet", "fleet.yaml", "--lockstep", "--duration", "0.5", "--no-report"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The working directory, with a fleet that is fast to simulate."""
    (tmp_path / "fleet.yaml").write_text(ALONE.format(target="car") + "sim: {fidelity: simple}\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("arguments", [["explain"], ["help"], ["fmt", "--help"], ["dump", str(LINEFORM)], SIM])
def test_a_broken_pipe_ends_quietly(arguments: list[str], tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "koordgen", *arguments], stdout=writer, stderr=subprocess.PIPE, cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
    finally:
        os.close(writer)
    assert done.stderr == b""
    assert done.returncode in ((0,) if arguments == SIM else (0, 5)), "the verdict of a run stands"


def test_an_output_that_is_full_is_no_internal_error() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "koordgen", "explain"], stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT
        )
    assert (done.returncode, done.stderr) == (5, "error: standard output: No space left on device\n")


def test_a_run_prints_its_verdict_as_json(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    program = tmp_path / "a.koord"
    program.write_text(LINEFORM.read_text() + "Never:\n  pre: pid < 0\n  eff: pass\n")
    assert main([SIM[0], str(program), *SIM[2:], "--format", "json"]) == 0
    told = capfd.readouterr()
    document = json.loads(told.out)
    assert [d["code"] for d in document["diagnostics"]] == ["K041"]
    assert (document["verdict"], document["status"], document["folder"]) == ("held", 0, "run-a")
    assert document["summary"]["app"] == "a"
    assert "HELD" in told.err and "is starting" not in told.err, "no progress where nobody watches"


def test_a_run_without_a_fleet_file_is_one_robots(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", str(LINEFORM), "--lockstep", "--duration", "0.5", "--no-report"]) == 0
    told = capfd.readouterr()
    assert told.err.startswith("note: no --fleet: one simulated quad runs alone")
    summary = json.loads((tmp_path / "run-lineform/summary.json").read_text())
    assert [robot["name"] for robot in summary["robots"]] == ["robot"]
    assert main(["sim", str(LINEFORM), "--follow", "trace.jsonl"]) == 2


def on_a_terminal(*arguments: str, **env: str) -> bytes:
    """Return the output of a command whose standard output and error are a terminal."""
    ours, device = pty.openpty()
    command = [sys.executable, "-m", "koordgen", *arguments]
    done = subprocess.Popen(command, stdout=device, stderr=device, cwd=ROOT, env={**os.environ, "TERM": "xterm", **env})
    os.close(device)
    told = b""
    with suppress(OSError):  # the terminal's other end is closed
        while piece := os.read(ours, 4096):
            told += piece
    done.wait()
    os.close(ours)
    return told


def test_colours_are_for_terminals_that_want_them(tmp_path: Path) -> None:
    program = tmp_path / "a.koord"
    program.write_text(LINEFORM.read_text().replace("/ 2", "/ math.pi"))
    told = on_a_terminal("check", str(program))
    assert b"\x1b[1;31merror\x1b[0m[K010]" in told and b"\x1b[1;31m^" in told and b"= \x1b[1;36mhelp\x1b[0m:" in told
    assert b"\x1b" not in on_a_terminal("check", str(program), NO_COLOR="1")
    assert b"\x1b" not in on_a_terminal("check", str(program), TERM="dumb")
    assert b"\x1b[1;31merror\x1b[0m: no option --formt" in on_a_terminal("check", "--formt", "x")
    explored = on_a_terminal("explore", "examples/election/election.koord", "--rounds", "1")
    assert b": \x1b[1;33mINCONCLUSIVE\x1b[0m" in explored


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "koordgen" in script
    for word in ("validate", "sim", "duration", "mcap"):
        assert word in script


def test_bash_completes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "koordgen"
    script.write_text(capsys.readouterr().out)
    words = "COMP_WORDS=(koordgen sim --du); COMP_CWORD=2; COMPREPLY=()"
    command = f"source {script}; {words}; _shtab_koordgen; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.stdout.split() == ["--duration", "--duplication"], done.stderr
