"""Real processes that run several applications: rounds over UDP, `--status`, and a restart after kill -9."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from koordgen.build.emit.program import program_hash, program_text
from koordgen.build.emit.system import applications_text, module_of, with_sizes
from koordgen.runtime.ops.status import applications_table
from tests.composed.test_agreement import contending
from tests.runtime.agent.test_process import bundles, rounds, started

__all__ = ["bundles", "started"]
MAIN = str(Path(__file__).with_name("robot_main.py"))


def start(folder: Path, running: list[subprocess.Popen[str]]) -> subprocess.Popen[str]:
    command = [sys.executable, MAIN, str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    running.append(process)
    return process


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 20
    while not condition() and time.monotonic() < limit:
        time.sleep(0.05)
    assert condition()


def adds(folder: Path, application: str) -> list[dict[str, Any]]:
    """Return the recorded rounds in which the application's event counted."""
    return [r for r in rounds(folder) if r["application"] == application and r["event"] == "Add" and not r["fault"]]


def test_processes_run_several_applications_and_one_rejoins(
    bundles: list[Path], started: list[subprocess.Popen[str]]
) -> None:
    system = with_sizes(contending())
    for folder in bundles:
        (folder / "applications.py").write_text(applications_text(system))
        for application in system.applications:
            (folder / f"program_{module_of(application)}.py").write_text(program_text(application.program))
    processes = [start(folder, started) for folder in bundles]
    until(lambda: all(len(adds(folder, "third")) >= 2 for folder in bundles))
    status = subprocess.run(
        [sys.executable, MAIN, str(bundles[0]), "--status", "--format", "json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    report = json.loads(status.stdout)
    assert [each["name"] for each in report["applications"]] == ["first", "second", "third"]
    assert all(each["event"] == "Add" for each in report["applications"])
    shown = applications_table([("alice", report)])
    assert [line.split()[1] for line in shown[1:-1]] == ["first", "second", "third"]
    assert "first: lost_contention" in report["counters"] and report["shared"][0][0] == "first.n"
    before = {name: adds(bundles[1], name)[-1] for name in ("first", "second", "third")}
    processes[1].kill()
    processes[1].communicate()
    (bundles[1] / "trace.jsonl").rename(bundles[1] / "before.jsonl")
    start(bundles[1], started)
    until(lambda: all(len(adds(bundles[1], name)) >= 2 for name in before))
    for name, last in before.items():
        again = adds(bundles[1], name)[0]
        restored = [r["restored"] for r in rounds(bundles[1]) if r["application"] == name and "restored" in r]
        assert restored[0]["round"] >= last["round"] and restored[0]["locals"]["k"] >= last["locals"]["k"]
        assert again["locals"]["k"] == restored[0]["locals"]["k"] + 1, "each application goes on where it was"


def test_a_program_of_another_build_is_refused_and_nothing_runs(
    bundles: list[Path], started: list[subprocess.Popen[str]]
) -> None:
    system, folder = with_sizes(contending()), bundles[0]
    (folder / "applications.py").write_text(applications_text(system))
    for application in system.applications:
        text = program_text(application.program)
        if application.name == "second":
            hash_ = program_hash(application.program)
            text = text.replace(hash_, "0" * 16)
        (folder / f"program_{module_of(application)}.py").write_text(text)
    process = start(folder, started)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 1 and "the bundle has files of two builds: the program of second has" in said
    assert not (folder / "trace.jsonl").exists()
