"""What robots' own monitors said beside the truth, from canned records; and a fleet whose monitors act."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from koordgen.cli import main
from koordgen.runtime.trace.schema import Monitor, Verdict, Violation
from targets.sim.judging.summary import violation_text as in_words
from targets.sim.trace.monitor_reports import (
    MOST,
    OF_ONE,
    DisplayFilter,
    Monitored,
    MonitorSummary,
    as_text,
    status_text,
)
from tests.sim.lockstep.lockstep import digest, ran, summary

NAMES = {0: "alice", 1: "bert", 2: "cleo"}


def record(pid: int, t: float, outcome: str, age: int = 0, name: str = "Near") -> Monitor:
    return Monitor("invariant", name, "a.koord:7", outcome, age, "why", "log", 1, 0.0, t, pid)


def beside(records: list[Monitor], outcome: Any = "violated") -> list[MonitorSummary]:
    found = Monitored(NAMES, 0.1)
    for record in records:
        found.add(record)
    return found.beside([Verdict(9.0, "invariant", "Near", "a.koord:7", outcome, 3.0)])


def test_who_saw_it_and_who_held_it_true() -> None:
    records = [record(pid, 0.0, "unknown" if pid == 2 else "held") for pid in range(3)]
    (found,) = beside([*records, record(1, 3.1, "violated"), record(1, 4.0, "held")])
    assert (found.seen, found.missed, found.mistaken) == ({"bert": 3.1}, ["alice"], [])
    assert as_text(found) == "invariant Near (a.koord:7): seen by bert at 3.10 s; alice said that it holds"
    old = [
        record(0, 0.0, "held"),
        record(0, 2.0, "unknown"),
        record(1, 0.0, "held", age=2),
        record(2, 3.5, "held"),
    ]
    assert beside(old) == [], "who does not know, or knew, or had not looked yet, has not missed it"


def test_what_who_saw_it_did_then_is_said() -> None:
    held = [replace(record(0, t, outcome), action="hold") for t, outcome in ((3.1, "violated"), (4.0, "held"))]
    (found,) = beside([*held, replace(record(1, 3.2, "violated"), action="land"), record(2, 3.3, "violated")])
    assert found.acted == {"alice": "hold", "bert": "land"}
    assert as_text(found).endswith(": seen by alice at 3.10 s (holds), bert at 3.20 s (lands), cleo at 3.30 s")


def test_what_the_truth_does_not_show_was_measured() -> None:
    (found,) = beside([record(0, 1.0, "violated")], "held")
    assert found.mistaken == ["alice"] and "in truth it held: alice measured otherwise" in as_text(found)
    assert beside([record(0, 0.0, "held")], "held") == []


def test_pages_show_violations_and_their_ends_but_not_without_end() -> None:
    notable = DisplayFilter()
    outcomes = ["held", "violated", "unknown", "held", "violated", "held"]
    assert [notable.add(record(0, 0.0, outcome)) for outcome in outcomes] == [
        False,
        True,
        True,
        False,
        True,
        True,
    ]
    assert sum(notable.add(record(0, 0.0, "violated")) for _ in range(9)) == OF_ONE - 4, "the others have room"
    held = [notable.add(replace(record(1, 0.0, "violated"), action="hold")) for _ in range(MOST + 9)]
    assert sum(held) == MOST - OF_ONE, "what a robot does is shown, each time"


def test_what_a_robot_does_is_said() -> None:
    assert status_text(replace(record(0, 0.0, "violated"), action="hold")) == "invariant Near: violated, holds"
    assert status_text(replace(record(0, 0.0, "held"), action="hold")) == "invariant Near: held"
    assert status_text(record(0, 0.0, "violated")) == "invariant Near: violated"


def test_a_violation_of_nobody_is_one_sentence() -> None:
    nobody = Violation(1.0, "property", (), "invariant Near does not hold", name="Near", line="a.koord:7")
    assert in_words(nobody) == "at 1.00 s: invariant Near does not hold (a.koord:7)"


# Robot 0 leaves its yard: the bound on its target is missing.
YARD = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume position' in Rect(position, target) or position' in Ball(target, 20)
allread: int steps[N_SYS]
Go:
  pre: True
  eff:
    if pid == 0: Motion.target = Motion.position + Point(1, 0, 0)
    steps[pid] += 1
invariant Yard: forall i in ID: i > 0 or Motion.position[i].x < -2.7
invariant Few: forall i in ID: steps[i] < 15
"""
FLEET = """\
delta: 0.1
origin: {latitude: 47.397742, longitude: 8.545594, altitude: 488.0}
geofence: {lo: [-6.0, -5.0, -0.5], hi: [6.0, 5.0, 4.0]}
sim: {fidelity: simple}
monitors: {MONITORS}
robots:
  - {name: alice, target: TARGET, address: "127.0.0.1:47100", start: {position: [-3.0, 0.0, 0.0]}}
  - {name: bert, target: TARGET, address: "127.0.0.1:47101", start: {position: [3.0, 0.0, 0.0]}}
"""


def went(folder: Path, target: str, monitors: str) -> tuple[Any, list[dict[str, Any]]]:
    """The run's summary and what its monitors told."""
    (folder / "yard.koord").write_text(YARD)
    (folder / "fleet.yaml").write_text(FLEET.replace("TARGET", target).replace("MONITORS", monitors))
    arguments = ["build", str(folder / "yard.koord"), "--fleet", str(folder / "fleet.yaml"), "--target", "sim"]
    assert main([*arguments, "-o", str(folder / "build")]) == 0
    assert ran(folder / "build/yard/sim", folder / "out", 2.5) == 3
    lines = map(json.loads, (folder / "out/trace.jsonl").read_text().splitlines())
    return summary(folder / "out"), [line for line in lines if line["kind"] == "monitor"]


def test_hold_keeps_a_robot_where_the_property_does_not_hold(tmp_path: Path) -> None:
    found, monitored = went(tmp_path, "car", "Yard: hold")
    alice = found["robots"][0]
    assert -2.75 < alice["final"][0] < -2.2 and alice["events"]["Go"] >= 24, "it stands, its events go on"
    yard, few = ([t for t in monitored if t["name"] == name] for name in ("Yard", "Few"))
    assert [(t["pid"], t["outcome"], t["action"]) for t in yard if t["outcome"] == "violated"] == [
        (0, "violated", "hold")
    ]
    assert {(t["pid"], t["round"], t["age"]) for t in few if t["outcome"] == "violated"} == {(0, 16, 0), (1, 16, 0)}
    by_name = {one["name"]: one for one in found["monitors"]}
    truth = {p["name"]: p for p in found["properties"]}
    for name in ("Yard", "Few"):
        assert 0 <= by_name[name]["seen"]["alice"] - truth[name]["since"] <= 0.2 and not by_name[name]["mistaken"]
    text = (tmp_path / "out/summary.txt").read_text()
    assert "the robots' own monitors:" in text and "invariant Yard (yard.koord:13): seen by alice at " in text
    assert re.search(r"seen by alice at \d\.\d\d s \(holds\)", text)


@pytest.mark.slow
@pytest.mark.parametrize(("target", "action"), [("car", "stop"), ("quad", "land"), ("quad", "stop")])
def test_land_and_stop_end_a_robots_part(tmp_path: Path, target: str, action: str) -> None:
    found, monitored = went(tmp_path, target, f"Yard: {action}")
    alice = found["robots"][0]
    assert alice["final"][0] < -2.0 and any(t["name"] == "Yard" and t["action"] == action for t in monitored)
    ended = [v for v in found["violations"] if v["what"] == "ended"]
    assert alice["status"] == 3 or any("invariant Yard" in v["detail"] for v in ended), found["violations"]


@pytest.mark.slow
def test_runs_with_monitors_repeat_byte_for_byte(tmp_path: Path) -> None:
    for k in ("0", "1"):
        (tmp_path / k).mkdir()
        went(tmp_path / k, "car", "Yard: hold")
    assert digest(tmp_path / "0/out") == digest(tmp_path / "1/out")
