"""Execution of one simulation run: starts the bundle, reads its summary, and calls the user's verdict script.

Workers of a Dask cluster import this module, so it imports few other modules.
"""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from koordgen.experiment.campaign.store import RunResult

HELD, VIOLATED = 0, 3  # exit statuses of a simulation run: all properties held, or some were violated
POLL = 0.05  # seconds between two checks for a stop of the campaign
PATIENCE = 10.0  # seconds from the second SIGTERM until a run is killed
MOST_SHOWN = 300  # characters after which the reason for a violation or a failure is cut off


class CampaignStopped(Exception):
    """Raised if the campaign was stopped during a run. The process of the run has ended, and the run has no result."""


@dataclass(frozen=True)
class Job:
    """Simulation run to execute.

    `number`: number of the run in the campaign's plan.
    `varied`: name -> value of each quantity that the campaign varies.
    `flags`: command-line options for the bundle.
    `settings`: settings of the simulation harness; a setting here overrides the scenario's setting.
    `verdict`: path of the user's verdict script, which is called with the run's folder; "" without a script."""

    number: int
    varied: Mapping[str, str]
    flags: tuple[str, ...]
    settings: Mapping[str, Any]
    verdict: str
    gentle: bool  # if true, the run gets a low CPU priority on its host
    scenario: str = ""  # scenario with the faults of the run, as JSON text; "" for a run without a scenario


def execute(job: Job, bundle: Path, folder: Path, stopped: Callable[[], bool]) -> RunResult:
    """Execute a simulation run, and return its result.

    The run writes its files into `folder`. The run's settings and scenario are stored in two files beside `folder`.
    `stopped`: returns whether the campaign was stopped. Raises CampaignStopped, OSError."""
    command = [sys.executable, str(bundle), *job.flags, f"--out={folder}", "--quiet"]
    own = folder.with_name(f"{folder.name}.settings.json")
    if job.settings:
        own.write_text(json.dumps(dict(job.settings)), encoding="utf-8")
        command.append(f"--settings={own}")
    if job.scenario:
        scenario = folder.with_name(f"{folder.name}.scenario.json")
        scenario.write_text(job.scenario, encoding="utf-8")
        command.append(f"--scenario={scenario}")
    began = time.monotonic()
    status, output = run_command(_gently(command) if job.gentle else command, stopped)
    wall = round(time.monotonic() - began, 3)
    if status not in (HELD, VIOLATED):
        return RunResult(job.number, dict(job.varied), "failed", _why_not(status, output), wall=wall)
    result = _summarised(job, status, _summary(folder / "summary.json"), wall)
    return _judged(result, job.verdict, folder, stopped) if job.verdict else result


def run_command(command: list[str], stopped: Callable[[], bool]) -> tuple[int, str]:
    """Run a command to its end, and return its exit status and its output.

    `stopped`: returns whether the campaign was stopped. Raises CampaignStopped after a stop, which terminates the
        command."""
    # The command gets its own process group. So Ctrl-C in a terminal sends SIGINT to koordgen but not to the command;
    # koordgen then terminates the command.
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, process_group=0
    ) as child:
        while True:
            try:
                output, _ = child.communicate(timeout=POLL)
            except subprocess.TimeoutExpired:
                if not stopped():
                    continue
                _end(child)
                raise CampaignStopped from None
            return child.returncode, output.decode("utf-8", "replace")


def _end(child: subprocess.Popen[bytes]) -> None:
    """Terminate the process of a run with two SIGTERMs, or with SIGKILL if the process does not end.

    SIGKILL follows PATIENCE seconds after the second SIGTERM.
    After only one SIGTERM, a run first stops its robots and writes a report."""
    for _ in range(2):
        child.terminate()
        try:
            child.communicate(timeout=0.5)
            return
        except subprocess.TimeoutExpired:
            continue
    try:
        child.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()


def _gently(command: list[str]) -> list[str]:
    nice = shutil.which("nice")
    return [nice, "-n", "10", *command] if nice else command


def _why_not(status: int, output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    said = next((line for line in lines if line.startswith("error:")), lines[-1] if lines else "it said nothing")
    how = f"killed by signal {-status}" if status < 0 else f"status {status}"
    return f"{how}: {said}"[:MOST_SHOWN]


def _summary(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def _summarised(job: Job, status: int, summary: dict[str, Any], wall: float) -> RunResult:
    violations = summary.get("violations") or [{}]
    separation = (summary.get("min_separation") or {}).get("distance")
    late = [robot.get("late_rounds", 0) for robot in summary.get("robots", [])]
    return RunResult(
        job.number,
        dict(job.varied),
        "held" if status == HELD else "violated",
        "" if status == HELD else str(summary.get("why") or "no summary")[:MOST_SHOWN],
        str(violations[0].get("what", "")) if status == VIOLATED else "",
        summary.get("duration"),
        separation,
        sum(late) if late else None,
        wall,
    )


def _judged(result: RunResult, script: str, folder: Path, stopped: Callable[[], bool]) -> RunResult:
    """Call the user's verdict script with the run's folder, and return the run's result with the script's verdict.

    If the script's exit status is not 0, a run that held counts as violated. The last line of the script's output is
    the reason. A JSON object in the last line is no reason: its numbers become figures of the run."""
    status, output = run_command([sys.executable, script, str(folder)], stopped)
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    figures = _figures(lines[-1]) if lines else None
    if figures is not None:
        lines.pop()
    result = replace(result, figures=figures or {})
    if status == 0 or result.outcome != "held":
        return result
    why = lines[-1] if lines else f"{script} ended with status {status} and printed no reason"
    return replace(result, outcome="violated", why=why[:MOST_SHOWN], what="verdict")


def _figures(line: str) -> dict[str, float] | None:
    try:
        value = json.loads(line)
    except ValueError:
        return None
    if not isinstance(value, dict):
        return None
    return {
        str(k): float(v)
        for k, v in value.items()
        if isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)
    }
