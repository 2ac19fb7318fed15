"""LineForm's judge, on runs that line up and on all kinds that do not."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from targets.sim.judging import summary
from targets.sim.trace import files as trace
from tests.sim.view.canned import Place, header, moving, outcome, write

JUDGE = Path(__file__).parents[3] / "examples" / "lineform" / "verdict.py"
STARTS: list[Place] = [(-4, -1.5, 0), (-3, 2.5, 0), (1.5, -2.5, 0), (0.5, 3.2, 0), (4, 1.5, 0)]
ENDS: list[Place] = [(-4, -1.5, 1.5), (-2, -0.75, 0), (0, 0, 1.5), (2, 0.75, 0), (4, 1.5, 1.5)]


def judged(folder: Path, starts: list[Place], ends: list[Place], **change: Any) -> subprocess.CompletedProcess[str]:
    names = ["alice", "bert", "cleo", "dora", "emil"]
    path = write(folder / "trace.jsonl", header(names), moving(starts, ends))
    summary.write(summary.summarise(*trace.read(path), outcome(**change)), folder)
    return run(folder)


def run(*arguments: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(JUDGE), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def moved(places: list[Place], pid: int, x: float, y: float) -> list[Place]:
    return [(a + x, b + y, c) if k == pid else (a, b, c) for k, (a, b, c) in enumerate(places)]


def test_a_good_line(tmp_path: Path) -> None:
    done = judged(tmp_path, STARTS, ENDS)
    assert done.returncode == 0, done.stderr
    assert "they lined up" in done.stdout and "cleo" in done.stdout and "0.800 m" in done.stdout


@pytest.mark.parametrize(
    ("pid", "x", "y", "status"),
    [
        (2, -0.351 * 0.31, 0.936 * 0.31, 3),  # across the line, just outside and just inside
        (2, -0.351 * 0.29, 0.936 * 0.29, 0),
        (1, 0.936 * 0.31, 0.351 * 0.31, 3),  # along the line
        (1, 0.936 * 0.29, 0.351 * 0.29, 0),
    ],
)
def test_crooked_and_uneven_lines(tmp_path: Path, pid: int, x: float, y: float, status: int) -> None:
    done = judged(tmp_path, STARTS, moved(ENDS, pid, x, y))
    assert done.returncode == status, done.stdout


def test_height_does_not_matter_but_an_extremal_robot_moves_the_line(tmp_path: Path) -> None:
    assert judged(tmp_path, STARTS, [(x, y, 3.0) for x, y, _ in ENDS]).returncode == 0
    assert judged(tmp_path, STARTS, moved(ENDS, 4, 0.0, 2.0)).returncode == 3


def test_a_robot_that_started_on_the_line_shows_nothing(tmp_path: Path) -> None:
    done = judged(tmp_path, moved(STARTS, 3, 0.0, -1.8), ENDS)
    assert done.returncode == 3 and "dora" in done.stdout


def test_too_close_by_the_harness_or_by_the_trace(tmp_path: Path) -> None:
    from targets.sim.run.scene import Closest

    done = judged(tmp_path, STARTS, ENDS, closest=Closest(0.29, 3.0, (1, 2)))
    assert done.returncode == 3 and "too close" in done.stdout
    near = moved(moved(STARTS, 2, -1.5, 2.5), 3, -0.3, -3.1)  # cleo and dora begin 0.22 m apart
    done = judged(tmp_path, near, ENDS)
    assert "too close" in done.stdout and done.returncode == 3


def test_a_run_that_did_not_hold_is_no_evidence(tmp_path: Path) -> None:
    done = judged(tmp_path, STARTS, ENDS, ended="interrupted")
    assert done.returncode == 3 and "interrupted" in done.stdout


def test_what_came_after_the_end_does_not_count(tmp_path: Path) -> None:
    judged(tmp_path, STARTS, ENDS)
    with (tmp_path / "trace.jsonl").open("a") as file:
        file.write(json.dumps({"kind": "pose", "t": 13.0, "pid": 2, "position": [0, 3, 0], "yaw": 0}) + "\n")
    assert run(tmp_path).returncode == 0


@pytest.mark.parametrize("name", ["trace.jsonl", "summary.json"])
@pytest.mark.parametrize("text", [None, "", "{", "[]", '{"kind": "pose"}\n'])
def test_unusable_files(tmp_path: Path, name: str, text: str | None) -> None:
    judged(tmp_path, STARTS, ENDS)
    if text is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_text(text)
    done = run(tmp_path)
    assert done.returncode == 1 and "error:" in done.stderr and "Traceback" not in done.stderr


def test_usage() -> None:
    assert run().returncode == 2
