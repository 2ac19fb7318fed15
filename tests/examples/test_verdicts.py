"""Verdict scripts of Task, Mapping, Formation, survey and squads: each fault is found, and correct runs pass."""

from __future__ import annotations

import base64
import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.examples.stage import EXAMPLES

Records = list[dict[str, Any]]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"{name}_verdict", EXAMPLES / name / f"{name}_verdict.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def judged(
    name: str, folder: Path, records: Records, capsys: pytest.CaptureFixture[str], **summary: Any
) -> tuple[int, list[str]]:
    found = {"verdict": "held", "why": "", "min_separation": {"distance": 1.0}, "robots": [], **summary}
    (folder / "summary.json").write_text(json.dumps(found))
    (folder / "trace.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))
    status = script(name).main([str(folder)])
    return status, capsys.readouterr().out.splitlines()


TASKS = {1: [1.0, 0.0, 0.0], 2: [2.0, 0.0, 1.5]}


def assigned(t: float, pid: int, task: int, left: list[int]) -> dict[str, Any]:
    shared = {"all_tasks": [[TASKS[k], k] for k in left], "shared_paths": [[0, 0, 0], TASKS[task]]}
    local = {"cur_task": [TASKS[task], task], "on_task": True}
    return {"kind": "round", "t": t, "pid": pid, "event": "Assign", "shared": shared, "locals": local}


def done(t: float, pid: int, task: int, off: float = 0.1) -> Records:
    x, y, z = TASKS[task]
    pose = {"kind": "pose", "t": t, "pid": pid, "position": [x + off, y, z]}
    return [pose, {"kind": "stream", "t": t, "pid": pid, "text": f"task {task} done"}]


HEAD = {"kind": "header", "robots": [{"name": "alice", "pid": 0}, {"name": "bert", "pid": 1}], "obstacles": []}
BOTH = [assigned(0.0, 0, 1, [2]), assigned(0.5, 1, 2, [])]


def test_task_every_one_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, told = judged("task", tmp_path, [HEAD, *BOTH, *done(4.0, 0, 1), *done(4.5, 1, 2)], capsys)
    assert status == 0 and told[-2] == "Task: every task was visited once"
    assert json.loads(told[-1]) == {"tasks visited": 2, "last task, s": 4.5, "robots under way": 1.778}


@pytest.mark.parametrize(
    ("visits", "said"),
    [
        (done(4.0, 0, 1), "task 2 was visited 0 times"),
        ([*done(4.0, 0, 1), *done(4.5, 1, 2), *done(5.0, 0, 2)], "task 2 was visited 2 times"),
        ([*done(4.0, 0, 1, 0.4), *done(4.5, 1, 2)], "alice was 0.40 m from task 1"),
    ],
    ids=["not at all", "twice", "from afar"],
)
def test_task_what_is_wrong_is_told(
    visits: Records, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, told = judged("task", tmp_path, [HEAD, *BOTH, *visits], capsys)
    assert status == 3 and said in told[-2]


def test_task_a_violated_run_does_not_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records = [HEAD, *BOTH, *done(4.0, 0, 1), *done(4.5, 1, 2)]
    status, told = judged("task", tmp_path, records, capsys, verdict="violated", why="too close")
    assert status == 3 and "the run itself: violated, too close" in told[-2]


WALL = {"shape": "box", "lo": [2.0, 0.0, 0.0], "hi": [4.0, 2.0, 1.0]}  # the eastern half of 4 m x 2 m


def handed(t: float, rows: list[str]) -> dict[str, Any]:
    """Return a map with cells of 0.5 m from (0, 0), with north at the top: `?` unknown, `.` free, `#` occupied."""
    codes = [{"?": 0, ".": 1, "#": 3}[c] for row in reversed(rows) for c in row]
    bits = bytearray(math.ceil(len(codes) / 4))
    for k, code in enumerate(codes):
        bits[k >> 2] |= code << 2 * (k & 3)
    value = [0.5, 0, 0, len(rows[0]), len(rows), base64.b64encode(bits).decode()]
    return {"kind": "round", "t": t, "pid": 0, "event": "GUpdate", "shared": {"map": value}}


def mapped(*maps: dict[str, Any]) -> Records:
    pose = {"kind": "pose", "t": -1.0, "pid": 0, "position": [0.25, 0.25, 0.0]}
    return [{**HEAD, "obstacles": [WALL]}, pose, *maps]


RIGHT = ["....#???"] * 4


def test_mapping_a_right_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    half = ["..??????"] * 4
    status, told = judged("mapping", tmp_path, mapped(handed(5.0, half), handed(9.0, RIGHT)), capsys)
    assert status == 0 and "12 cells are free and can be reached" in told[0], "the column at the wall is touched by it"
    assert json.loads(told[-1]) == {"known, %": 100.0, "contradictions": 0, "95 % known, s": 9.0}


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("#...#???", "cell (0, 2) is occupied, 1.75 m from any obstacle"),
        (".#..#???", "cell (1, 2) is occupied, 1.25 m from any obstacle"),
        ("..#.#???", "cell (2, 2) is occupied, 0.75 m from any obstacle"),
        ("....#.??", "cell (5, 2) is marked as free, but lies 0.75 m inside an obstacle"),
    ],
)
def test_mapping_contradictions_are_seen_even_if_they_go_away(
    row: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = [RIGHT[0], row, *RIGHT[2:]]
    status, told = judged("mapping", tmp_path, mapped(handed(5.0, wrong), handed(9.0, RIGHT)), capsys)
    assert status == 3 and f"at 5.0 s {said}" in told[-2]


@pytest.mark.parametrize("row", ["...##???", "....#???", "....????"])
def test_mapping_what_may_be_is_no_contradiction(row: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, _ = judged("mapping", tmp_path, mapped(handed(9.0, [row, *RIGHT[1:]])), capsys)
    assert status == 0


@pytest.mark.parametrize(("t", "row"), [(9.0, "...?????"), (181.0, "....#???")], ids=["too little", "too late"])
def test_mapping_enough_in_time(t: float, row: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = handed(1.0, ["????????"] * 4)
    status, told = judged("mapping", tmp_path, mapped(first, handed(t, ["??..#???", *[row] * 3])), capsys)
    assert status == 3 and "are known, 95 % are wanted" in told[-2]


def ring(off: float, turned: float) -> list[dict[str, Any]]:
    places = [
        (3 * math.cos(math.pi * k / 3 + turned) + (off if k == 2 else 0), 3 * math.sin(math.pi * k / 3 + turned), 0.0)
        for k in range(6)
    ]
    return [{"name": f"r{k}", "final": place} for k, place in enumerate(places)]


@pytest.mark.parametrize(
    ("off", "turned", "status"), [(0.0, 1.0, 0), (0.1, 1.0, 0), (0.9, 1.0, 3), (0.0, 0.1, 3)], ids=str
)
def test_formation(off: float, turned: float, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert judged("formation", tmp_path, [], capsys, robots=ring(off, turned))[0] == status


def surveyed(folder: Path, *records: dict[str, Any]) -> Records:
    """A run in which bert maps the world of Mapping, and alice has a task at (0.75, 0.75) and one in the wall."""
    (folder / "source/task").mkdir(parents=True, exist_ok=True)
    tasks = [{"id": 1, "target": [0.75, 0.75, 1.5]}, {"id": 2, "target": [3.0, 1.0, 1.5]}]
    (folder / "source/task/params.json").write_text(json.dumps({"tasks": tasks}))
    return [*mapped({**handed(5.0, RIGHT), "application": "mapping", "pid": 1, "actuators": {}}), *records]


ASSIGN = {"kind": "round", "t": 6.0, "pid": 0, "application": "task", "shared": {}, "actuators": {"Motion.path": []}}
THERE = {"kind": "pose", "t": 7.0, "pid": 0, "position": [0.8, 0.7, 1.5]}
DID = {"kind": "stream", "t": 7.0, "pid": 0, "text": "task 1 done"}
CANNOT = {"kind": "stream", "t": 9.0, "pid": 0, "text": "task 2 is not reachable"}
END = {"kind": "end", "t": 10.0, "why": "stopped"}
STRAY = {"kind": "pose", "t": 8.0, "pid": 0, "position": [3.0, 1.0, 1.5]}


@pytest.mark.parametrize(
    ("records", "status", "said"),
    [
        ([ASSIGN, THERE, DID, CANNOT, END], 0, "all tasks are done"),
        ([ASSIGN, THERE, DID, CANNOT, END, STRAY], 0, "all tasks are done"),
        ([ASSIGN, THERE, DID, STRAY, CANNOT, END], 3, "at 8.0 s alice was above a cell that is not known"),
        ([ASSIGN, THERE, DID, END], 3, "task 2 cannot be reached, and nobody said so"),
        ([ASSIGN, THERE, DID, DID, CANNOT, END], 3, "task 1 was done 2 times"),
        ([ASSIGN, CANNOT, END], 3, "task 1 was done 0 times"),
        ([ASSIGN, {**THERE, "position": [0.2, 0.2, 1.5]}, DID, CANNOT], 3, "task 1 was reported from 0.78 m away"),
    ],
)
def test_survey(records: Records, status: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, told = judged("survey", tmp_path, surveyed(tmp_path, *records), capsys)
    assert found == status and said in told[0], told


def test_survey_a_wrong_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records = surveyed(tmp_path, ASSIGN, THERE, DID, CANNOT, END)
    wrong = {**handed(6.0, ["#...#???", *RIGHT[1:]]), "application": "mapping", "actuators": {}}
    found, told = judged("survey", tmp_path, [*records, wrong], capsys)
    assert found == 3 and "1 cells contradict the truth: at 6.0 s cell (0, 3) is occupied" in told[0]


def triangle(x: float, y: float, off: float = 0.0) -> Records:
    """Poses of a squad's quads around a place, the first of which is off its corner; then the mission's end."""
    places = [(x + 0.6 * math.cos(k * 2 * math.pi / 3), y + 0.6 * math.sin(k * 2 * math.pi / 3)) for k in range(3)]
    places[0] = places[0][0] + off, places[0][1]
    found = [{"kind": "pose", "t": 20.0, "pid": pid, "position": [*place, 1.5]} for pid, place in enumerate(places)]
    return [*found, {"kind": "end", "t": 21.0}]


@pytest.mark.parametrize(
    ("beta", "off", "verdict", "said"),
    [
        ((0.1, 0.1), 0.1, "held", ""),
        ((0.0, 0.4), 0.0, "held", "beta off the line at the end; beta off the middle at the end"),
        ((0.4, 0.0), 0.0, "held", "beta off the middle at the end"),
        ((0.0, 0.0), 0.3, "held", "alpha's quads off their corners"),
        ((0.0, 0.0), 0.0, "violated", "the run itself: violated, because"),
    ],
)
def test_squads(
    beta: tuple[float, float], off: float, verdict: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = [(-4.0, 0.0), beta, (4.0, 0.0)]
    starts = [ends[0], (0.0, -3.0), ends[2]]
    poses = [
        {"kind": "pose", "t": t, "pid": pid, "position": [*place, 0.0]}
        for t, places in ((0.0, starts), (20.0, ends))
        for pid, place in enumerate(places)
    ]
    for squad, own in (("alpha", triangle(-4.0, 0.0, off)), ("beta", triangle(*beta))):
        (tmp_path / squad).mkdir()
        (tmp_path / squad / "trace.jsonl").write_text("".join(json.dumps(record) + "\n" for record in own))
    records = [*poses, {"kind": "end", "t": 21.0}]
    status, told = judged("squads", tmp_path, records, capsys, verdict=verdict, why="because")
    assert (status, told[-1].partition(": NO: ")[2]) == (3 if said else 0, said), told


@pytest.mark.parametrize("name", ["task", "mapping", "formation", "survey", "squads"])
def test_files_that_cannot_be_used_are_told(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script(name).main([str(tmp_path)]) == 1 and "No such file" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("{")
    assert script(name).main([str(tmp_path)]) == 1 and "not the folder of a run" in capsys.readouterr().err
    assert script(name).main([]) == 2
