"""What the pages get of a trace: rows, and how they are kept few."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from koordgen.runtime.trace import schema
from koordgen.runtime.trace.schema import (
    End,
    EventFault,
    InitRecord,
    MemberPose,
    MetricsRecord,
    PeerQuality,
    PoseRecord,
    Round,
    SharedVariable,
    TraceRecord,
    Verdict,
    Violation,
)
from targets.sim.trace import files as trace
from targets.sim.view.data.history import MOST_MAPS, History, gathered
from targets.sim.view.data.rows import EVENT, FAULT, SKIPPED, Rows
from targets.sim.view.web import report
from tests.sim.view.canned import header, write

HEAD = msgspec.structs.replace(
    header(["alice", "bert"]),
    shared=(
        SharedVariable("x", "allread", "Point"),
        SharedVariable("sum", "allwrite", "int"),
        SharedVariable("map", "allwrite", "GridMap"),
    ),
)


def raw(**values: Any) -> dict[str, msgspec.Raw]:
    return {name: msgspec.Raw(msgspec.json.encode(value)) for name, value in values.items()}


def rows(*records: TraceRecord) -> dict[str, list[list[Any]]]:
    made = Rows(HEAD)
    for record in records:
        assert not isinstance(record, schema.Header)
        made.add(record, record.t)
    made.end()
    return made.taken()


def test_robots_of_squads_have_rows_of_their_own_and_count_for_the_closest_pair() -> None:
    robots = tuple(replace(r, target=target) for r, target in zip(HEAD.robots, ("squad", "car"), strict=True))
    made = Rows(replace(HEAD, robots=robots))
    for t in (1.0, 1.5):
        made.add(PoseRecord(0, (0.0, 0.0, 1.0), 0.0, t=t), t)
        made.add(PoseRecord(1, (0.0, 0.1, 1.0), 0.0, t=t), t)
        for name, x in (("ann", -1.0), ("cleo", 1.0)):
            made.add(MemberPose(0, name, (x, t, 1.0), 0.25, t=t), t)
    found = made.taken()
    assert found["members"][:2] == [[0, 1.0, "ann", -1.0, 1.0, 1.0, 0.25], [0, 1.0, "cleo", 1.0, 1.0, 1.0, 0.25]]
    assert found["near"] == [[1.0, 1.345, 1, "alice.ann"]], "the place of the squad itself is no robot"
    history = History(HEAD)
    history.extend(found)
    assert history.whole()["members"] == sorted(found["members"], key=lambda row: row[2])


def test_a_round_tells_its_outcome_its_writes_where_it_leads_and_how_late_it_was() -> None:
    path = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.00049]]
    found = rows(
        Round(
            4,
            "Go",
            shared=raw(x=[1, 2, 3]),
            actuators=raw(**{"Motion.path": path, "Log.level": 3}),
            late=0.07,
            t=1.2,
            pid=1,
        ),
        Round(5, skipped="no event enabled", late=0.01, t=1.3, pid=1),
        Round(6, "Go", skipped="fault", fault=EventFault("a.koord", 3, "1 / 0"), t=1.4, pid=1),
    )
    assert found["rounds"] == [
        [1, 1.2, 1.2, 1, EVENT, "Go"],
        [1, 1.3, 1.3, 1, SKIPPED, "no event enabled"],
        [1, 1.4, 1.4, 1, FAULT, "a.koord:3: 1 / 0"],
    ]
    assert found["shared"] == [["x", 1, 1.2, 4, [1, 2, 3]]]
    assert found["paths"] == [[1, 1.2, [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]]]
    assert found["late"] == [[1, 1, 0.07, 3, 1]]


@pytest.mark.parametrize("value", [None, 5, "x", [1, 2], [[1, 2]], {"a": 1}, [[1, 2, "z"]]])
def test_what_is_no_path_is_none(value: Any) -> None:
    assert "paths" not in rows(Round(1, "Go", actuators=raw(**{"Motion.path": value}), pid=0))


def test_a_lidars_newest_scan_is_a_row_once_a_second() -> None:
    def seen(*ranges: float) -> list[Any]:
        return [[1.0, 2.0, 0.5], [[0.0, math.pi / 2, math.pi], ranges, 6.0]]

    def at(t: float, *scans: Any, pid: int = 0) -> Round:
        return Round(1, "Look", sensors=raw(**{"MotionWithScan.pscan": scans}), t=t, pid=pid)

    found = rows(
        at(0.0),
        at(0.2, seen(1.0, 1.0, 1.0), seen(2.0, 6.0, 3.0)),  # the second ray met nothing
        at(0.4, seen(5.0, 5.0, 5.0)),
        at(1.2, seen(0.5, 1.25, 6.0)),
        at(1.2, seen(6.0, 6.0, 6.0), pid=1),
        at(2.3, [[1, 2, 3], "no scan"], pid=1),
    )
    assert found["scans"] == [
        [0, 0.2, [1.0, 2.0, 0.5], [200, 0, -300, 0]],
        [0, 1.2, [1.0, 2.0, 0.5], [50, 0, 0, 125]],
        [1, 1.2, [1.0, 2.0, 0.5], []],
    ]


def test_the_closest_pair_is_that_of_all_robots_once_all_are_known() -> None:
    found = rows(
        PoseRecord(1, (0.0, 0.0, 0.0), 0.0, t=0.0),
        PoseRecord(0, (3.0, 4.0, 0.0), 0.0, t=0.05),
        PoseRecord(1, (0.0, 0.0, 12.0), 0.0, t=0.05),
    )
    assert found["near"] == [[0.05, 13.0, 0, 1]]


def test_links_marks_and_strangers() -> None:
    peers: dict[str, PeerQuality] = {
        "1": {"loss": 0.25, "delay_ms": {"p50": 1.5, "p99": 4}, "silent_ms": None, "repeats": 2},
        "x": {},
    }
    found = rows(
        MetricsRecord(peers=peers, rejected={"mac": 2, "epoch": 1}, t=9.0, pid=0),
        Violation(2.0, "separation", ("alice", "bert"), "0.2 m apart"),
        End(10.0, "completed"),
        Round(1, "Go", pid=7),
        PoseRecord(-1, (0.0, 0.0, 0.0), 0.0),
    )
    assert found["links"] == [[0, 9.0, [[1, 0.25, 1.5, 4, None, 2]], 3]]
    assert found["marks"] == [
        [2.0, "violation", "separation", ["alice", "bert"], "0.2 m apart"],
        [10.0, "end", "completed", [], ""],
    ]
    assert set(found) == {"links", "marks"}


def test_what_init_wrote_is_there_before_round_1_and_a_verdict_is_a_mark() -> None:
    found = rows(
        InitRecord(shared=raw(sum=3), t=-0.2, pid=0),
        Verdict(10.0, "invariant", "Safe", "a.koord:9", "violated", 2.5, ("bert",), "x was 3"),
    )
    assert found["shared"] == [["sum", 0, -0.2, 0, 3]]
    assert found["marks"] == [[10.0, "verdict", "invariant Safe: violated", ["bert"], "a.koord:9, x was 3"]]


def test_a_history_keeps_the_whole_run_however_long_it_is() -> None:
    history = History(HEAD)
    for k in range(100_001):
        history.extend({"poses": [[k % 2, k / 20, 0, 0, 0, 0]], "near": [[k / 20, 1.0, 0, 1]]})
    whole = history.whole()
    for times in ([row[1] for row in whole["poses"] if row[0] == 0], [row[0] for row in whole["near"]]):
        assert len(times) <= 4001 and times == sorted(times)
        assert times[0] == 0.0 and times[-1] == 5000.0
        assert max(b - a for a, b in itertools.pairwise(times)) < 5000 / 1000
    assert len(json.dumps(whole)) < 1_000_000


def test_thinning_leaves_no_robot_out_and_no_marker() -> None:
    names = [f"r{pid}" for pid in range(64)]
    history = History(header(names))
    for second in range(600):
        history.extend(
            {"late": [[pid, second, 0.001, 10, 0] for pid in range(64)], "markers": [[second, second % 9, 1]]}
        )
    whole = history.whole()
    assert {row[0] for row in whole["late"]} == set(range(64)) and len(whole["late"]) < 6000
    assert [row[1] for row in whole["late"] if row[0] == 1][-1] == 599
    assert len(whole["markers"]) == 600


def test_a_round_that_waited_for_others_is_not_late() -> None:
    found = rows(
        Round(1, "Go", late=0.07, t=0.1, pid=0),
        Round(2, skipped="not current: lacks bert", late=0.07, t=0.2, pid=0),
        Round(3, skipped="not confirmed", late=0.07, t=0.3, pid=0),
        Round(4, "Go", late=0.04, t=0.4, pid=0),
    )
    assert found["late"] == [[0, 0, 0.07, 4, 1]]


def test_rounds_with_one_outcome_are_one_row_and_a_fault_outlasts_thinning() -> None:
    history = History(HEAD)
    for k in range(40_000):
        outcome = [FAULT, "bad"] if k == 777 else [k % 2, "Go" if k % 2 == EVENT else "no event enabled"]
        history.extend({"rounds": [[0, k / 10, k / 10, 1, *outcome], [1, k / 10, k / 10, 1, SKIPPED, "stopped"]]})
    whole = history.whole()["rounds"]
    assert [row for row in whole if row[0] == 1] == [[1, 0.0, 3999.9, 40_000, SKIPPED, "stopped"]]
    own = [row for row in whole if row[0] == 0]
    assert len(own) <= 3001 and sum(row[3] for row in own) == 40_000
    assert any(row[4] == FAULT and row[1] <= 77.7 <= row[2] for row in own)


def test_values_that_stay_are_told_once_and_long_ones_are_cut() -> None:
    history = History(HEAD)
    for k in range(10):
        history.extend({"shared": [["sum", k % 2, k / 10, k + 1, k // 5]]})
    history.extend({"shared": [["x", 0, 2.0, 20, "a" * 100_000]]})
    for k in range(500):
        history.extend({"shared": [["map", 0, 3.0 + k, 30 + k, [0.5, 0, 0, 2, 2, f"{k}=="]]]})
    whole = history.whole()["shared"]
    assert [row[2:] for row in whole if row[0] == "sum"] == [[0.0, 1, 0], [0.5, 6, 1]]
    (long,) = (row for row in whole if row[0] == "x")
    assert len(long[4]["cut"]) <= 3000
    maps = [row for row in whole if row[0] == "map"]
    assert len(maps) <= MOST_MAPS + 1 and maps[-1][2] == 502.0


def test_locals_are_what_events_wrote_and_what_a_robot_came_back_with() -> None:
    back = schema.Restored(4, locals=raw(n=2))
    found = rows(
        schema.InitRecord(locals=raw(n=0), t=-0.5, pid=1),
        Round(5, "Go", locals=raw(n=3), restored=back, t=0.4, pid=1),
    )
    assert found["locals"] == [[1, -0.5, 0, "n", 0], [1, 0.4, 4, "n", 2], [1, 0.4, 5, "n", 3]]
    history = History(HEAD)
    for k in range(100_000):
        history.extend({"locals": [[0, k / 10, k, "path", [k] * 20]]})
    kept = history.whole()["locals"]
    assert len(kept) > 100 and len(msgspec.json.encode(kept)) < 300_000 and kept[-1][4] == [99_999] * 20


def big(path: Path, robots: int, seconds: int) -> Path:
    """A trace as sixteen robots leave one: poses 20 times and rounds 10 times a second, all of them writing paths."""
    head = msgspec.structs.replace(
        header([f"robot{pid}" for pid in range(robots)]), shared=(SharedVariable("paths", "allread", "List<Point>"),)
    )
    with path.open("wb") as file:
        file.write(msgspec.json.encode(head) + b"\n")
        for k in range(20 * seconds):
            for pid in range(robots):
                place = [math.sin(k / 99 + pid) * 3, math.cos(k / 87 + pid) * 3, 1 + pid / 9]
                record: dict[str, Any] = {"kind": "pose", "t": k / 20, "pid": pid, "position": place, "yaw": k / 50}
                file.write(msgspec.json.encode(record) + b"\n")
                if k % 2:
                    event, skipped = (None, "no event enabled") if k % 4 == 1 else ("Assign", None)
                    record = {
                        "kind": "round", "t": k / 20, "pid": pid, "round": k // 2, "event": event, "skipped": skipped,
                        "shared": {"paths": [place] * 4}, "actuators": {"Motion.path": [place] * 4}, "late": 0.001,
                    }  # fmt: skip
                    file.write(msgspec.json.encode(record) + b"\n")
        file.write(b'{"kind":"end","t":%d,"why":"completed"}\n' % seconds)
    return path


@pytest.mark.slow
def test_the_report_of_sixteen_robots_and_three_minutes_stays_below_five_megabytes(tmp_path: Path) -> None:
    path = big(tmp_path / "trace.jsonl", 16, 180)
    report.write(tmp_path / "report.html", path)
    assert 500_000 < (tmp_path / "report.html").stat().st_size < 5_000_000


def test_what_is_gathered_of_a_canned_trace_fits_its_records(tmp_path: Path) -> None:
    path = write(
        tmp_path / "trace.jsonl", HEAD, [{"kind": "pose", "t": 1.0, "pid": 0, "position": [1, 2, 3], "yaw": 4}]
    )
    found = gathered(*trace.read(path))
    assert found["poses"] == [[0, 1.0, 1.0, 2.0, 3.0, 4.0]]
    assert found["marks"] == [[10.0, "end", "completed", [], ""]]
