"""The knowledge of each robot of a run at a time: by `koordgen show`, as tables, and as its agent itself knew it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from koordgen.cli import main
from koordgen.runtime.trace import schema
from koordgen.runtime.trace import writer as runtime
from koordgen.runtime.trace.schema import End, SharedVariable, Violation
from targets.sim.base.scenario import load
from targets.sim.trace.beliefs import Beliefs
from tests.sim.lockstep.lockstep import Plan, built, played
from tests.sim.view.canned import header, moving, write

HEAD = msgspec.structs.replace(
    header(["ann", "bob"]), shared=(SharedVariable("x", "allread", "int"), SharedVariable("best", "allwrite", "float")),
)  # fmt: skip


def records() -> list[dict[str, Any]]:
    """Bob hears nothing of ann from round 3 on."""

    def one(number: int, pid: int, **what: Any) -> dict[str, Any]:
        return {"kind": "round", "t": number / 10 - 0.1, "pid": pid, "round": number, **what}

    return [
        {"kind": "init", "t": -1.0, "pid": 0, "locals": {"n": 0}, "shared": {"x": 1}, "actuators": {"Led.on": False}},
        {"kind": "init", "t": -1.0, "pid": 1, "locals": {"n": 7}, "shared": {"x": 2}},
        one(1, 0, event="Go", copy={"x": {"0": 1, "1": 2}, "best": 0.0}, locals={"n": 1}, shared={"x": 10, "best": 0.5},
            sensors={"Motion.reached": True}, actuators={"Led.on": True}),
        one(1, 1, skipped="no event enabled", copy={"x": {"0": 1, "1": 2}, "best": 0.0}),
        one(2, 1, event="Go", copy={"x": {"0": 10}, "best": 0.5}, locals={"n": 8}),
        one(3, 0, event="Go", shared={"x": 30}),
        one(3, 1, skipped="not current: lacks ann"),
        one(4, 0, event="Go", skipped="fault", fault={"file": "a.koord", "line": 0, "reason": "too late"}),
        one(4, 1, skipped="not current: lacks ann"),
        one(9, 1, skipped="no event enabled", copy={"x": {"0": 30}}, restored={"round": 2, "locals": {"n": 8}}),
    ]  # fmt: skip


@pytest.fixture
def run(tmp_path: Path) -> Path:
    marks: list[Violation | End] = [Violation(0.35, "collision", ("ann",), "touched"), End(1.0, "completed")]
    moves = moving([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], 1)
    write(tmp_path / "trace.jsonl", HEAD, [*moves, *records()], marks)
    return tmp_path


def shown(run: Path, capsys: pytest.CaptureFixture[str], *more: str) -> str:
    assert main(["show", str(run), *more]) == 0
    return capsys.readouterr().out


def test_a_robot_that_hears_nothing_goes_by_what_it_heard_last(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ann, bob = shown(run, capsys, "--at", "0.3").split("\n\n")[1:]
    assert ann.splitlines() == [
        "ann: not started, round 4, fault: a.koord: too late",
        "  true position          (0.00, 0.00, 0.00)",
        "  sensor Motion.reached  true",
        "  local n                1",
        "  actuator Led.on        true",
        "  shared x[ann]          30",
        "  shared x[bob]          2",
        "  shared best            0.5",
    ]
    assert bob.splitlines() == [
        "bob: not started, round 4, skipped: not current: lacks ann",
        "  true position  (2.00, 0.00, 0.00)",
        "  local n        8",
        "  shared x[ann]  10",
        "  shared x[bob]  2",
        "  shared best    0.5",
        "  its copy of the shared variables is of round 2",
    ]


def test_the_time_is_the_first_violations_where_none_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(run, capsys).startswith("line<form> at 0.35 s since round 1\n")
    found = json.loads(shown(run, capsys, "--at", "9", "--format", "json"))
    bob = found["robots"][1]
    assert (found["t"], bob["robot"], bob["round"], bob["copied"]) == (9.0, "bob", 9, 9)
    assert bob["locals"] == {"n": 8} and bob["shared"] == {"x": {"ann": 30, "bob": 2}, "best": 0.5}
    early = json.loads(shown(run, capsys, "--at=-0.5", "--format", "json"))["robots"]
    assert [robot["shared"] for robot in early] == [{"x": {"ann": 1}}, {"x": {"bob": 2}}]


def test_what_is_no_run_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(run / "none"), "--at", "1"]) == 1
    with pytest.raises(SystemExit, match="2"):
        main(["show", str(run), "--at", "soon"])
    assert "expected seconds since round 1" in capsys.readouterr().err


def test_tables_have_each_change_of_what_a_robot_knew(run: Path) -> None:
    assert main(["export", str(run), "--to", "csv"]) == 0
    with (run / "csv" / "beliefs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    known = {(r["of"], r["name"], r["slot"]): (r["t"], json.loads(r["value"])) for r in rows
             if r["robot"] == "bob" and float(r["t"]) <= 0.3}  # fmt: skip
    assert known == {
        ("local", "n", ""): ("0.1", 8), ("shared", "x", "ann"): ("0.1", 10), ("shared", "x", "bob"): ("-1.0", 2),
        ("shared", "best", ""): ("0.1", 0.5),
    }  # fmt: skip


def test_it_is_what_the_agents_themselves_knew(tmp_path: Path) -> None:
    bundle = built(tmp_path, "atomicsum")
    seen: list[tuple[int, runtime.RoundRecord]] = []

    class Watching(Plan):
        def launched(self, run: Any) -> None:
            super().launched(run)
            for agent in run.conduct.agents:
                agent.monitors.append(lambda record, pid=agent.robot.pid: seen.append((pid, record)))

    plan = Watching()
    played(bundle, tmp_path / "run", 3.0, plan)
    scenario = load(bundle)
    head = msgspec.structs.replace(header([robot.name for robot in scenario.robots]), shared=scenario.shared)
    beliefs = Beliefs(head)
    told: dict[tuple[int, int], tuple[Any, Any]] = {}
    for agent in plan.run.conduct.agents:
        for line in agent.trace_file.read_bytes().splitlines()[1:]:
            record = schema.decoded(line)
            if isinstance(record, (schema.InitRecord, schema.Round)):
                own = msgspec.structs.replace(record, pid=agent.robot.pid)
                beliefs.apply(own)
                belief = beliefs.robots[own.pid]
                told[own.pid, belief.round] = json.loads(msgspec.json.encode([belief.locals, belief.shared]))
    compared = 0
    for pid, had in seen:
        if had.frame is None:
            continue
        shared: dict[str, Any] = {name: dict(enumerate(value)) if isinstance(value, tuple) else value
                  for name, value in had.frame.shared.items()}  # fmt: skip
        if had.effects is not None:
            for name, value in had.effects.shared.items():
                if isinstance(shared[name], dict):
                    shared[name][pid] = value
                else:
                    shared[name] = value
        own_locals = had.effects.locals if had.effects is not None else had.frame.locals
        assert told[pid, had.round] == json.loads(msgspec.json.encode([own_locals, shared], enc_hook=repr))
        compared += 1
    assert compared > 10
