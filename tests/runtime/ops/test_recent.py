"""The recent history in an agent's report: numbered, bounded, merged by its reader without doubles."""

from __future__ import annotations

import json
from typing import Any

import pytest
from msgspec.structs import replace

from benchmarks.fixtures.fleet import Fleet
from koordgen.runtime.ops.recent import LINES_BYTES, LONGEST_VALUE, MOST_POINTS, VALUES_BYTES, Recent, goal
from koordgen.runtime.program.program import Effects, Fault
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Vitals


def effects(**shared: Any) -> Effects:
    return Effects({}, shared, {}, False)


def event(number: int, name: str = "Go", **shared: Any) -> RoundRecord:
    return RoundRecord(number, number / 10, 0.002, {}, None, name, effects(**shared))


def skipped(number: int, why: str) -> RoundRecord:
    return RoundRecord(number, number / 10, 0.05, {}, None, skipped=why)


def test_rounds_with_one_outcome_are_one_run_that_ends_at_a_gap() -> None:
    recent = Recent()
    for record in (event(1), event(2), skipped(3, "not current"), event(4), event(6)):
        recent.round(record)
    recent.round(RoundRecord(7, 0.7, 0.0, {}, None, fault=Fault("a.koord", 3, "division by zero")))
    report = recent.report(0.75, {})
    assert report["outcomes"] == [
        [1, 2, "event", "Go", [2.0, 2.0]], [3, 1, "skipped", "not current", [50.0]], [4, 1, "event", "Go", [2.0]],
        [6, 1, "event", "Go", [2.0]], [7, 1, "fault", "a.koord:3: division by zero", [0.0]],
    ]  # fmt: skip
    assert report["decided"] == 0.05


def test_runs_of_several_applications_overlap() -> None:
    recent = Recent()
    for number in (1, 2, 3):
        recent.round(replace(event(number), application="map"))
        recent.round(replace(skipped(number, "no event"), application="task"))
    assert [run[:4] for run in recent.report(0.0, {})["outcomes"]] == [
        [1, 3, "event", "map: Go"], [1, 3, "skipped", "task: no event"],
    ]  # fmt: skip
    assert (recent.of("map").event, recent.of("map").event_round, recent.of("task").event) == ("Go", 3, "")


def test_a_fault_of_an_application_ends_with_its_next_record() -> None:
    recent = Recent()
    fault = Fault("a.koord", 3, "division by zero")
    recent.round(RoundRecord(4, 0.4, 0.0, {}, None, "Go", fault=fault, application="map"))
    assert recent.of("map").fault == "a.koord:3: division by zero" and recent.of("map").event == ""
    recent.round(replace(event(5), application="map"))
    assert recent.of("map").fault == "" and recent.of("map").event_round == 5


def test_lines_keep_their_numbers_when_older_ones_have_gone() -> None:
    recent = Recent()
    for k in range(100):
        recent.line(float(k), k, "info", f"line {k}")
    lines = recent.report(100.0, {})["lines"]
    assert [line[0] for line in lines] == list(range(101 - len(lines), 101))
    assert lines[-1] == [100, 1.0, 99, "info", "line 99"]


def test_a_report_stays_small_whatever_a_program_says_and_shares() -> None:
    recent, kinds = Recent(), {f"v{k}": "allwrite" for k in range(100)}
    for k in range(100):
        recent.line(0.0, k, "warning", "ä" * 10_000)
        recent.round(event(k, f"{k}" * 1000, **{f"v{k}": "x" * 100_000}))
    report = recent.report(1.0, kinds)
    assert len(json.dumps(report, ensure_ascii=False).encode()) < 8000
    assert len(json.dumps(report["shared"])) < 1.2 * VALUES_BYTES
    assert len(json.dumps(report["lines"], ensure_ascii=False).encode()) < 1.2 * LINES_BYTES
    assert len(report["shared"][0][3]["cut"]) == LONGEST_VALUE
    assert report["lines"][-1][0] == 100 and report["outcomes"][-1][0] == 99


def test_the_last_write_of_a_variable_is_reported_with_its_round() -> None:
    recent = Recent()
    recent.wrote(0, {"at": Point(1, 2, 3), "n": 0})
    recent.round(event(5, at=Point(4, 5, 6)))
    assert recent.report(1.0, {"at": "allread", "n": "allwrite"})["shared"] == [
        ["at", "allread", 5, [4.0, 5.0, 6.0]], ["n", "allwrite", 0, 0],
    ]  # fmt: skip


@pytest.mark.parametrize("count", [1, MOST_POINTS, MOST_POINTS + 1, 1000])
def test_a_long_path_is_thinned_and_keeps_its_end(count: int) -> None:
    path = tuple(Point(k, 0, 1) for k in range(count))
    found = goal({"Motion.target": Point(), "Motion.path": path}, transmissible)
    assert len(found) <= MOST_POINTS and found[-1] == [count - 1, 0, 1]


def test_what_is_not_finite_is_no_goal() -> None:
    assert goal({"Motion.path": (), "Motion.target": Point(float("nan"))}, transmissible) == []
    assert goal({"Motion.path": (), "Motion.target": Point(1, 2, 3)}, transmissible) == [[1, 2, 3]]


def test_an_agent_reports_its_pose_goal_rounds_and_lines() -> None:
    fleet = Fleet(3)
    robots = [fleet.boot(pid) for pid in range(3)]
    before = robots[0].agent.snapshot(robots[0].clock.now())
    assert before["pose"]["yaw"] is None and before["battery"] is None
    fleet.run(4.0)
    robot = robots[1]
    robot.platform.vitals = Vitals(0.5, 0.81)  # type: ignore[attr-defined]
    found = robot.agent.snapshot(robot.clock.now())
    place = robot.platform.position
    assert found["pose"]["position"] == [round(c, 3) for c in (place.x, place.y, place.z)]
    assert (found["pose"]["yaw"], found["battery"]) == (0.5, 0.81) and 0 <= found["pose"]["age"] < 0.1
    assert found["goal"] and len(found["goal"][0]) == 3
    assert any(text.startswith("running: mission") for *_, text in found["lines"])
    assert {run[2] for run in found["outcomes"]} >= {"event"} and 0 <= found["decided"] < 0.3
    assert json.loads(json.dumps(found)) == found
