"""Output that is read by programs: pipes that close, no progress, one document with the verdict, colours on demand."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.cli import main

ROOT = Path(__file__).parents[2]
LINEFORM = ROOT / "examples/lineform/lineform.koord"
FLEET = ROOT / "examples/lineform/fleet.yaml"
SIM = ["sim", str(LINEFORM), "--fleet", str(FLEET), "--lockstep", "--duration", "0.5", "--no-report"]


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


def test_a_run_prints_its_verdict_as_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "a.koord"
    program.write_text(LINEFORM.read_text() + "Never:\n  pre: pid < 0\n  eff: pass\n")
    assert main([SIM[0], str(program), *SIM[2:], "--format", "json"]) == 0
    told = capfd.readouterr()
    document = json.loads(told.out)
    assert [d["code"] for d in document["diagnostics"]] == ["K041"]
    assert (document["verdict"], document["status"], document["folder"]) == ("held", 0, "run-a")
    assert document["summary"]["app"] == "a"
    assert "HELD" in told.err and "robots are starting" not in told.err, "no progress where nobody watches"


def test_a_run_without_a_fleet_file_is_one_robots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sim", str(LINEFORM), "--lockstep", "--duration", "0.5", "--no-report"]) == 0
    told = capfd.readouterr()
    assert told.err.startswith("note: no --fleet: one simulated quad runs alone")
    summary = json.loads((tmp_path / "run-lineform/summary.json").read_text())
    assert [robot["name"] for robot in summary["robots"]] == ["robot"]
    assert main(["sim", str(LINEFORM), "--follow", "trace.jsonl"]) == 2
