"""`koordgen replay`: a traced program is run again on the recorded inputs of its robots."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.runtime.net.network import Conditions
from tests.verify.replay.runs import EXAMPLES, Run, example

ALL = """\
def Mark:
  Point at
  int count
param int most = 4
using Motion:
  sensors:
    Point position
    bool reached
  actuators:
    Point target
  PathPlanner planner
using Log:
  stream stdout
allread:
  List<Mark> marks[N_SYS] max 4
  float nothing[N_SYS]
allwrite:
  Map<string, int> seen max 8, 8
local:
  Set<int> numbers max 8
  float level
  GridMap map max 100
  string text
extern fun weigh(List<Mark> marks, int me) -> Mark
init:
  Log.stdout << "robot " << pid
  marks[pid] = [Mark(Motion.position, pid)]
Count:
  pre: not (pid in numbers) and len(seen) < most
  eff: atomic:
    seen["r" + str(pid)] = pid
    numbers.add(pid)
Far:
  pre: level == 0
  eff:
    level = 1e308 * (1 - pid % 2) + pid + 0.1
    text = "x"
    map = mark_free(GridMap(Point(0, 0, 0), Point(2, 2, 0), 0.5), Grid(1, 1, 0.5))
Plan:
  pre: len(marks[pid]) < 3
  eff:
    marks[pid].append(weigh(marks[0], pid))
    Motion.target = first(Motion.planner(Motion.position + Point(0, 1, 0)))
    Log.stdout << "marks " << len(marks[pid])
Fail:
  pre: text == "x" and Motion.reached and pid == 0
  eff:
    text = "y"
    nothing[pid] = 1 / (len(numbers) - 1)
Stop:
  pre: Motion.reached
  eff: stop
"""
FUNCTIONS = """\
from koordgen.runtime.values.points import Point
def weigh(marks, me):
    return (Point(0.5, 0.25 * me, 0.0), len(marks) + me)
"""


def replay(*arguments: object) -> int:
    return main(["replay", *map(str, arguments)])


def edited(path: Path, change: Callable[[dict[str, Any]], bool]) -> int:
    """Change the first record that `change` says it did; its line."""
    lines = path.read_text().splitlines()
    for k, line in enumerate(lines):
        record = json.loads(line)
        if change(record):
            lines[k] = json.dumps(record)
            path.write_text("\n".join(lines) + "\n")
            return k + 1
    raise AssertionError("there is nothing to change")


@pytest.mark.parametrize("name", ["lineform", "task", "atomicsum", "election"])
def test_traces_of_the_examples_are_as_their_programs_mean(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = example(tmp_path, name).run(6.0).save()
    assert replay(folder) == 0
    assert replay(folder / "robots/bert/trace.jsonl") == 0
    told = capsys.readouterr().out.splitlines()
    assert "3 robots, " in told[0] and "1 robot, " in told[1]
    assert all(line.endswith("no differences from the program") for line in told)
    events = [int(line.split(" rounds, ")[1].split()[0]) for line in told]
    assert events[0] >= events[1] > 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a program with all kinds of values, faults, planner calls, streams and transactions."""
    run = Run(tmp_path_factory.mktemp("all"), ALL, params={"most": 3}, functions=FUNCTIONS).run(6.0)
    assert {"Count", "Far", "Plan", "Fail", "Stop"} <= {
        r.event for robot in run.fleet.robots.values() for r in robot.records
    }
    return run.save()


@pytest.fixture
def copied(whole: Path, tmp_path: Path) -> Path:
    import shutil

    shutil.copytree(whole, tmp_path / "run")
    return tmp_path / "run"


def test_every_kind_of_value_and_fault_is_replayed(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay(whole) == 0, capsys.readouterr().err
    rounds = [json.loads(line) for line in (whole / "trace.jsonl").read_text().splitlines()]
    assert any(r.get("fault") for r in rounds) and any(r.get("calls") for r in rounds)
    assert any("level" in r.get("locals", {}) and r["locals"]["level"] == 1e308 for r in rounds)


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("level", lambda r: "level" in r.get("locals", {}) and r["locals"].update(level=2.5) is None),
        ("marks", lambda r: r.get("event") == "Plan" and r["shared"]["marks"].reverse() is None),
        ("Motion.target", lambda r: "Motion.target" in r.get("actuators", {}) and r["kind"] == "round"
         and r["actuators"].update({"Motion.target": [0, 0, 7.0]}) is None),
        ("the event", lambda r: r.get("event") == "Far" and r.update(event="Plan") is None),
        ("Log.stdout", lambda r: r["kind"] == "stream" and r["round"] > 0 and r.update(text="marks 9") is None),
        ("stop", lambda r: r.get("stopped") is True and r.update(stopped=False) is None),
        ("numbers", lambda r: r["kind"] == "init" and r["locals"].update(numbers=[4]) is None),
        ("event Fail", lambda r: bool(r.get("fault")) and r["fault"].update(line=3) is None),
        ("copy of seen", lambda r: r.get("event") == "Far" and "seen" in r.get("copy", {})
         and r["copy"].update(seen=[["r9", 9]]) is None),
    ],
)  # fmt: skip
def test_a_difference_is_told_with_its_place(
    copied: Path, capsys: pytest.CaptureFixture[str], what: str, change: Callable[[dict[str, Any]], bool]
) -> None:
    path = copied / "trace.jsonl"
    line = edited(path, change)
    record = json.loads(path.read_text().splitlines()[line - 1])
    assert replay(copied) == 3
    told = capsys.readouterr()
    first = told.err.splitlines()[0]
    when = f"round {record['round']}" if record.get("round") else "init"
    assert first.startswith(f"{path}:{line}: {when}, robot {('alice', 'bert', 'cleo')[record['pid']]}: {what}"), first
    assert " in the trace, " in first and first.endswith(" by the program") and "difference" in told.out


def test_a_stream_that_was_not_put_out_is_missed(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = copied / "trace.jsonl"
    lines = path.read_text().splitlines()
    k = next(k for k, line in enumerate(lines) if '"stream"' in line)
    path.write_text("\n".join(lines[:k] + lines[k + 1 :]) + "\n")
    assert replay(copied) == 3
    assert "Log.stdout is nothing in the trace, robot 0 by the program" in capsys.readouterr().err


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_die_and_come_back_and_bad_networks_are_replayed(tmp_path: Path, seed: int) -> None:
    conditions = Conditions(loss=0.1, delay=0.001, jitter=0.02, duplication=0.1)
    run = example(tmp_path, "lineform", n=4, seed=seed, conditions=conditions).run(3.0)
    run.fleet.network._queues.pop(1, None)
    run.fleet.robots[1].wake = 1e9
    run.run(0.5)
    run.boot(1)
    folder = run.run(4.0).save()
    text = (folder / "robots/bert/trace.jsonl").read_text()
    assert '"restored"' in text
    assert replay(folder) == 0
    assert replay(folder / "robots/bert/trace.jsonl") == 0


def test_several_events_that_a_dead_robot_did_not_record_are_no_difference(tmp_path: Path) -> None:
    """A robot died before it recorded rounds 5 and 6. It rejoined after its event of round 6, which counted."""
    text = "allread: int x[N_SYS]\nlocal: int k\nGo:\n  pre: True\n  eff:\n    k += 1\n    x[pid] = k\n"
    trace = Run(tmp_path, text).run(2.5).save() / "trace.jsonl"
    records = [json.loads(line) for line in trace.read_text().splitlines()]
    own = {r["round"]: r for r in records if r["kind"] == "round" and r["pid"] == 0}
    assert max(own) > 9 and [own[r]["locals"]["k"] for r in (6, 7)] == [6, 7]
    own[7]["restored"] = {"round": 6, "locals": {"k": 6}, "actuators": {}}
    own[7]["copy"] = {"x": {"0": 6, "1": 6, "2": 6}}
    kept = [r for r in records if r is not own[5] and r is not own[6]]
    trace.write_text("".join(f"{json.dumps(r)}\n" for r in kept))
    assert replay(tmp_path) == 0


def test_robots_that_do_not_agree_who_counts_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = example(tmp_path, "lineform", n=3).run(1.0)
    run.fleet.network._queues.pop(1, None)
    run.fleet.robots[1].wake = 1e9
    folder = run.run(2.0).save()
    assert replay(folder) == 0
    path = folder / "trace.jsonl"
    lines = path.read_text().splitlines()
    k = next(k for k, line in reversed(list(enumerate(lines))) if '"number":1' in line and '"view"' in line)
    view = json.loads(lines[k])
    lines[k] = json.dumps(view | {"since": view["since"] + 1})
    path.write_text("\n".join(lines) + "\n")
    assert replay(folder) == 3
    assert f"{path}:{k + 1}: round {view['since'] + 1}, robot" in (told := capsys.readouterr().err)
    assert f"view 1 is [0, -1, 0] from round {view['since'] + 1} on in the trace, [0, -1, 0] from round" in told


def test_a_trace_that_is_cut_off_is_replayed_as_far_as_it_goes(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copied / "trace.jsonl"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    cut = data[: len(data) // 2].count(b"\n") + 1
    assert replay(copied) == 0
    told = capsys.readouterr()
    assert f"{path}:{cut}: the trace is cut off here" in told.err and "no differences from the program" in told.out


def test_a_trace_broken_amid_it_is_refused(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = copied / "trace.jsonl"
    lines = path.read_text().splitlines()
    lines[20] = lines[20][:30]
    path.write_text("\n".join(lines) + "\n")
    assert replay(copied) == 1
    assert f"{path}:21: " in capsys.readouterr().err


def test_a_number_that_no_robot_has_is_refused(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = edited(
        copied / "trace.jsonl",
        lambda r: (
            "Motion.position" in r.get("sensors", {})
            and r["sensors"].update({"Motion.position": [10**400, 0, 0]}) is None
        ),
    )
    assert replay(copied) == 1
    assert f":{line}: " in capsys.readouterr().err


def test_a_trace_of_another_version_is_refused(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (copied / "source/params.json").write_text('{"most": 4}')
    assert replay(copied) == 1
    told = capsys.readouterr().err
    assert "is the trace of a program with the hash" in told and "params" in told
    assert replay(copied, "--param", "most=3") == 0


def test_a_trace_without_its_program_asks_for_it(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import shutil

    shutil.move(copied / "source", copied.parent / "elsewhere")
    assert replay(copied) == 2
    assert "--program" in capsys.readouterr().err
    there = copied.parent / "elsewhere"
    assert replay(copied, "--program", there / "app.koord", "--param", "most=3") == 0


def test_what_is_no_trace_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("", "no JSON\n", '{"kind": "pose"}\n', "[1]\n"):
        (tmp_path / "trace.jsonl").write_text(text)
        assert replay(tmp_path) == 1, text
    assert replay(tmp_path / "missing.jsonl") == 1
    assert "No such file" in capsys.readouterr().err


def test_an_example_is_found_by_its_program_and_fleet(tmp_path: Path) -> None:
    import yaml

    params = yaml.safe_load((EXAMPLES / "task/fleet.yaml").read_text())["params"]
    folder = example(tmp_path, "task", params=params).run(3.0).save()
    own = folder / "robots/cleo/trace.jsonl"
    program, fleet = EXAMPLES / "task/task.koord", EXAMPLES / "task/fleet.yaml"
    assert replay(own) == 0
    assert replay(own, "--program", program) == 1, "without the fleet's params it is another program"
    assert replay(own, "--program", program, "--fleet", fleet) == 1, "the program's name is part of it"


@pytest.mark.parametrize("change", ["locals", "shared", "actuators", "stopped"])
def test_a_write_in_a_round_without_an_event_is_refused(
    copied: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    values = {"locals": {"level": 3.0}, "shared": {"nothing": 1.0}, "actuators": {"Motion.target": [0, 0, 0]}}
    path = copied / "robots/bert/trace.jsonl"

    def write(record: dict[str, Any]) -> bool:
        if record["kind"] != "round" or record["event"] is not None:
            return False
        record[change] = values.get(change, True)
        return True

    line = edited(path, write)
    assert replay(path) == 1
    assert f"{path}:{line}: a write in a round without an event" in capsys.readouterr().err
    main(["audit", str(path)])
    told = "".join(capsys.readouterr().out.split())  # which is wrapped
    assert f"{path}:{line}: a write in a round without an event".replace(" ", "") in told


@pytest.mark.parametrize(
    ("field", "value"), [("n_sys", 10**9), ("n_sys", 0), ("n_sys", 1e400), ("pid", 3), ("pid", -1)]
)
def test_a_header_of_too_many_robots_is_refused(
    copied: Path, capsys: pytest.CaptureFixture[str], field: str, value: float
) -> None:
    path = copied / "robots/bert/trace.jsonl"
    edited(path, lambda record: record.update({field: value}) is None)
    assert replay(path) == 1
    assert f"{path}:1: a broken header" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "words"),
    [(10**12, "a broken record of kind round"), (10**7, "round 10000000 after round"), (1.5, "a broken record"),
     (1e400, "a broken record"), (-1, "a broken record"), (None, "a broken record")],
)  # fmt: skip
def test_a_round_that_none_can_be_is_refused(
    copied: Path, capsys: pytest.CaptureFixture[str], value: float, words: str
) -> None:
    path = copied / "trace.jsonl"
    seen = 0

    def change(record: dict[str, Any]) -> bool:
        nonlocal seen
        seen += int(record["kind"] == "round")
        if seen == 9:
            record["round"] = value
        return seen == 9

    line = edited(path, change)
    assert replay(copied) == 1
    assert f"{path}:{line}: {words}" in capsys.readouterr().err


@pytest.mark.parametrize("seed", range(12))
def test_damage_never_ends_in_an_internal_error(copied: Path, seed: int) -> None:
    """Bytes that are changed, cut out or doubled, or a field that holds something else."""
    rng, path = Random(seed), copied / "trace.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    for _ in range(3):
        k = rng.randrange(len(lines))
        data = bytearray(lines[k])
        match rng.randrange(4):
            case 0:
                data[rng.randrange(len(data))] = rng.randrange(256)
            case 1:
                del data[rng.randrange(len(data)) :]
            case 2:
                data = data * 2
            case _:
                record = json.loads(data) if data.endswith(b"}\n") and data.count(b"\n") == 1 else {"kind": "round"}
                nonsense: list[Any] = [None, -1, 1e400, [], {}, "x", 10**400, [[[]]], {"9": [None]}, True]
                record[rng.choice(list(record))] = rng.choice(nonsense)
                data = bytearray(json.dumps(record).encode() + b"\n")
        lines[k] = bytes(data)
    path.write_bytes(b"".join(lines))
    assert replay(copied) in (0, 1, 3)
