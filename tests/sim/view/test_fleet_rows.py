"""Reports that come again and again become rows, each line, round and write once."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from koordgen.runtime.trace.schema import ApplicationRecord, Header
from targets.sim.view.web.dashboard import first_header
from targets.sim.view.web.fleet_rows import FRESH, FleetRows, LatestRows, Report, completed, read_report

FLEET = first_header([("alice", "quad"), ("bert", "car")], {"delta": 0.1})


def report(**changes: Any) -> Report:
    plain: dict[str, Any] = {"phase": "running", "round": 5, "boot": "a", "delta": 0.1} | changes
    found = read_report(plain)
    assert isinstance(found, Report), found
    return found


def rows(header: Header = FLEET) -> FleetRows:
    return FleetRows(header)


def test_lines_and_rounds_of_overlapping_reports_are_told_once() -> None:
    fleet = rows()
    runs = [[1, 2, "event", "Go", [2.0, 3.0]], [3, 1, "skipped", "not current", [50.0]]]
    fleet.add_report(0, report(lines=[[1, 0.5, 0, "info", "a"], [2, 0.1, 1, "error", "b"]], outcomes=runs), "", 10.0)
    runs = [[1, 2, "event", "Go", [2.0, 3.0]], [3, 2, "skipped", "not current", [50.0, 1.0]]]
    fleet.add_report(0, report(lines=[[2, 0.3, 1, "error", "b"], [3, 0.0, 5, "info", "c"]], outcomes=runs), "", 10.2)
    chunk = fleet.taken(10.2)
    assert chunk["logs"] == [[0, 9.5, "info", "a"], [0, 9.9, "error", "b"], [0, 10.2, "info", "c"]]
    assert [(row[1], row[4], row[5]) for row in chunk["rounds"]] == [
        (9.8, 0, "Go"), (9.9, 0, "Go"), (10.0, 1, "not current"), (10.2, 1, "not current"),
    ]  # fmt: skip
    assert fleet.taken(10.3) == {}


def test_outcomes_of_all_applications_of_a_round_are_told_once() -> None:
    fleet, both = rows(), [{"name": "map", "members": [0, 1]}, {"name": "task", "stopped": True, "event": "End"}]
    runs = [[1, 2, "event", "map: Go", [2.0, 3.0]], [1, 1, "skipped", "task: no event", [2.0]]]
    fleet.add_report(0, report(outcomes=runs, applications=both), "", 10.0)
    runs = [[1, 2, "event", "map: Go", [2.0, 3.0]], [1, 2, "skipped", "task: no event", [2.0, 3.0]]]
    fleet.add_report(0, report(outcomes=runs, applications=both), "", 10.1)
    told = [row[5] for row in fleet.taken(10.2)["rounds"]]
    assert told == ["map: Go", "task: no event", "map: Go", "task: no event"]
    map_, task = fleet.table()[0]["applications"]
    assert (map_.name, map_.stopped, task.stopped, task.event) == ("map", False, True, "End")


def test_the_header_gets_the_applications_that_robots_report() -> None:
    shared = [["map.at", "allread", 1, 3], ["task.done", "allwrite", 0, []]]
    header = completed(FLEET, report(applications=[{"name": "map", "members": [1]}], shared=shared))
    assert header.composition == (ApplicationRecord("map", (1,), {"at": "map.at"}),)
    more = report(applications=[{"name": "task", "members": [0]}], shared=shared)
    both = completed(header, more)
    assert both.applications == ("map", "task") and completed(both, more) is both
    assert both.composition[1] == ApplicationRecord("task", (0,), {"done": "task.done"})  # type: ignore[index]
    assert completed(FLEET, report()) is FLEET


def test_lines_that_came_too_fast_are_counted() -> None:
    fleet = rows()
    fleet.add_report(0, report(lines=[[1, 0.0, 0, "info", "a"]]), "", 1.0)
    fleet.add_report(0, report(lines=[[41, 0.0, 0, "info", "z"]]), "", 2.0)
    lines = [row[3] for row in fleet.taken(2.0)["logs"]]
    assert lines == ["a", "39 lines before this one arrived too fast to be shown", "z"]


def test_an_agent_that_began_anew_counts_from_the_beginning() -> None:
    fleet = rows()
    fleet.add_report(0, report(lines=[[7, 0.0, 0, "info", "a"]]), "", 1.0)
    fleet.add_report(0, report(lines=[[1, 0.0, 0, "info", "again"]], boot="b"), "", 2.0)
    chunk = fleet.taken(2.0)
    assert [row[3] for row in chunk["logs"]] == ["a", "again"]
    assert [(row[1], row[3]) for row in chunk["marks"]] == [("restart", ["alice"])]


def test_a_robot_that_falls_silent_stays_with_its_last_report() -> None:
    fleet = rows()
    fleet.miss(1, "no answer: no agent runs there", 0.5)
    fleet.add_report(0, report(battery=0.5), "", 1.0)
    fleet.miss(0, "no answer", 1.0 + FRESH / 2)
    assert "marks" not in fleet.taken(2.0), "one lost question is no silence"
    fleet.miss(0, "no answer", 1.1 + FRESH)
    fleet.miss(0, "no answer", 9.0)
    alice, bert = fleet.table()
    assert (alice["silent"], alice["at"], alice["battery"], alice["note"]) == (True, 1.0, 0.5, "no answer")
    assert (bert["at"], bert["note"]) == (None, "no answer: no agent runs there")
    fleet.add_report(0, report(), "", 10.0)
    marks = fleet.taken(10.0)["marks"]
    assert [(row[0], row[1], row[4]) for row in marks] == [
        (2.1, "silent", "no answer"), (10.0, "answers", "was silent for 9.0 s"),
    ]  # fmt: skip


def test_poses_are_told_once_and_silent_robots_are_no_closest_pair() -> None:
    fleet = rows()
    pose = {"position": [1, 2, 3], "yaw": None, "age": 0.25}
    fleet.add_report(0, report(pose=pose), "", 1.0)
    fleet.add_report(1, report(pose={"position": [1, 2, 0], "yaw": 1.5}), "", 1.0)
    fleet.add_report(0, report(pose=pose | {"age": 0.5}), "", 1.25)
    chunk = fleet.taken(1.25)
    assert chunk["poses"] == [[0, 0.75, 1.0, 2.0, 3.0, 0.0], [1, 1.0, 1.0, 2.0, 0.0, 1.5]]
    assert chunk["near"] == [[1.25, 3.0, 0, 1]]
    fleet.add_report(0, report(pose=pose | {"age": 0.0}), "", 9.0)
    assert "near" not in fleet.taken(9.0)


def test_properties_goals_and_writes_are_told_when_they_change() -> None:
    fleet = rows()
    broken = {"counts": {}, "violated": [{"of": "invariant", "name": "Apart", "line": "a.koord:3", "why": "too near"}]}
    first = report(goal=[[1, 2, 3]], shared=[["x", "allread", 3, [1, 2]]], monitors=broken, outcomes=[])
    for t in (1.0, 2.0):
        fleet.add_report(0, first, "", t)
    fleet.add_report(0, report(goal=[[4, 5, 6]], shared=[["x", "allread", 4, 7]]), "", 3.0)
    chunk = fleet.taken(3.0)
    assert [row[2] for row in chunk["paths"]] == [((1, 2, 3),), ((4, 5, 6),)]
    assert [(row[0], row[1], row[3], row[4]) for row in chunk["shared"]] == [("x", 0, 3, [1, 2]), ("x", 0, 4, 7)]
    assert [row[2] for row in chunk["marks"]] == [
        "invariant Apart: violated", "invariant Apart: no longer violated",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "broken",
    [
        None, [], "x", {}, {"phase": 3, "round": 0}, {"phase": "running", "round": 1, "pose": [1, 2]},
        {"phase": "\ud800", "round": 1}, {"phase": "running", "round": 10**400}, {"phase": "running", "round": -1},
        {"phase": "running", "round": 1, "pose": {"position": [float("nan"), 0, 0]}},
        {"phase": "running", "round": 1, "shared": [["x", "allread", 1, "\ud800"]]},
    ],
)  # fmt: skip
def test_what_is_no_report_says_why(broken: Any) -> None:
    assert "cannot be read" in str(read_report(broken))


def test_a_report_of_an_older_agent_is_shown_as_far_as_it_goes() -> None:
    fleet = rows()
    fleet.add_report(0, report(), "", 1.0)
    alice = fleet.table()[0]
    assert (alice["phase"], alice["pose"], alice["battery"], alice["loss"]) == ("running", None, None, None)
    assert msgspec.json.encode(fleet.table())


def test_the_header_is_completed_by_reports_once() -> None:
    bare = first_header([("alice", "")], {})
    told = report(app="show", geofence=[[-1, -1, 0], [1, 1, 2]], shared=[["x", "allwrite", 0, 1]])
    more = completed(bare, told)
    assert (more.app, more.delta, more.geofence) == ("show", 0.1, ((-1, -1, 0), (1, 1, 2)))
    assert [(v.name, v.kind) for v in more.shared] == [("x", "allwrite")]
    assert completed(more, told) is more


def test_what_silent_robots_told_survives_a_new_header() -> None:
    fleet = rows()
    fleet.add_report(1, report(battery=0.3, lines=[[1, 0.0, 0, "info", "a"]]), "", 1.0)
    fleet.miss(1, "no answer", 5.0)
    fleet.taken(5.0)
    fleet.renew(completed(FLEET, report(app="show")))
    bert = fleet.table()[1]
    assert (bert["at"], bert["battery"], bert["silent"], bert["questions"]) == (1.0, 0.3, True, 2)
    assert fleet.taken(6.0)["logs"] == [[1, 1.0, "info", "a"]]


def test_a_dashboard_that_is_open_for_days_keeps_only_the_latest_rows() -> None:
    latest = LatestRows(FLEET)
    for k in range(20_000):
        latest.extend({"poses": [[k % 2, k, 0, 0, 0, 0]], "marks": [[k, "x", "", [], ""]], "near": [[k, 1, 0, 1]]})
    whole = latest.whole()
    assert len(whole["poses"]) == 2400 and whole["poses"][-1][1] == 19_999 and len(whole["marks"]) == 300
