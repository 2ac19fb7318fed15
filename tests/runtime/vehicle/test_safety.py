"""The safety layer: geofence, own position stale, lost or outside, a body or a program that breaks."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.fixtures.fleet import STARTS, FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.config.settings import Box, Safety
from koordgen.runtime.program.program import Event
from koordgen.runtime.trace.writer import Trace
from koordgen.runtime.values.points import Point, distance
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.safety import clamp, inside

_metre = st.floats(-100, 100)
_point = st.builds(Point, _metre, _metre, _metre)


@given(_point, _point, _point, _point)
def test_clamp_gives_the_nearest_point_of_the_box(a: Point, b: Point, p: Point, q: Point) -> None:
    box = Box(a, b)
    near = clamp(box, p)
    assert inside(box, near) and (near == p) == inside(box, p)
    assert distance(p, near) <= distance(p, clamp(box, q)) + 1e-9


def fly_out(s: State) -> None:
    s.target.value = Point(20.0 if s.count.value < 5 else 30.0, 0.0, 9.0)
    s.count.value += 1


def test_a_commanded_point_is_moved_into_the_fence_and_told_once() -> None:
    fleet = Fleet(n=1, program=replace(PROGRAM, events=(Event("Only", 9, lambda s: True, fly_out),))).boot_all()
    fleet.run_rounds(10)
    robot = fleet.robots[0]
    assert {c["Motion.target"] for _, c in robot.platform.commands} == {Point(6, 0, 4)}
    assert robot.agent._body.actuators["Motion.target"] == Point(30, 0, 9)  # the variable is as the program wrote it
    assert len([line for line in robot.lines if "outside the geofence" in line]) == 1
    assert robot.trace("round")[0]["actuators"] == {"Motion.target": [20, 0, 9]}


def test_a_stale_position_holds_and_skips_then_goes_on() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(5)
    bert = fleet.robots[1]
    bert.platform.fresh = False
    fleet.run(1.0)
    assert bert.held()
    assert bert.records[-1].skipped is not None and "own position is" in bert.records[-1].skipped
    assert fleet.robots[2].records[-1].event == "TargetUpdate"  # the others go on
    bert.platform.fresh = True
    fleet.run(0.5)
    assert not bert.held() and bert.records[-1].event == "TargetUpdate"
    assert [t["message"] for t in bert.trace("log")][-1] == "own position is fresh again"


def test_a_lost_position_ends_this_robot_safely_and_it_still_serves() -> None:
    fleet = Fleet().boot_all()
    fleet.run_rounds(5)
    bert = fleet.robots[1]
    bert.platform.fresh = False
    fleet.run(2.6)
    commands = len(bert.platform.commands)
    assert bert.agent.phase == "stopped" and bert.platform.stopped and not bert.done()
    fleet.run(2.0)
    assert fleet.robots[2].records[-1].event == "TargetUpdate"
    assert bert.records[-1].skipped == "left the mission" and len(bert.platform.commands) == commands
    bert.agent.end("SIGTERM")
    fleet.run(0.1)
    assert bert.done() and bert.agent.status == 5


def test_a_robot_outside_the_fence_ends_safely() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(5)
    robot = fleet.robots[1]
    robot.platform.position = Point(0, 7, 0)
    fleet.run(0.3)
    robot.platform.position = Point(0, 4, 0)
    fleet.run(0.6)
    assert robot.agent.phase == "running"  # back in time
    robot.platform.position = robot.platform.target = Point(0, 7, 0)
    fleet.run(0.7)
    assert robot.agent.phase in ("stopping", "stopped")
    assert "outside the geofence for 0.5 s, at (0.00, 7.00, 0.00)" in "".join(robot.lines)


def test_a_position_that_is_no_number_holds_and_never_reaches_the_program() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(5)
    fleet.robots[1].platform.position = Point(float("nan"), 0, 0)
    fleet.run(0.5)
    robot = fleet.robots[1]
    assert robot.held() and robot.records[-1].frame is None
    assert fleet.robots[0].records[-1].frame is not None
    fleet.run(3.0)
    assert robot.agent.phase in ("stopping", "stopped")


def test_a_lost_body_is_brought_to_rest_or_given_up() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(5)
    robot = fleet.robots[1]
    robot.platform.raises = Unready("no heartbeat for 5 s", "look at the cable")
    fleet.run(1.0)
    assert robot.agent.phase == "stopping" and robot.platform.stopping is not None and not robot.done()
    assert len([line for line in robot.lines if "no heartbeat for 5 s (look at the cable)" in line]) == 1
    fleet.run(11.0)
    assert robot.done() and robot.agent.status == 5


def test_a_body_that_serves_again_is_waited_for_however_long_it_takes_to_rest() -> None:
    """A quad that a failsafe brings home: the process must not end before it has landed."""

    class Slow(FakePlatform):
        @property
        def stopped(self) -> bool:
            return self.stopping is not None and self.now - self.stopping >= 25.0

    fleet = Fleet(n=1)
    robot = fleet.boot(0, Slow(Point()))
    fleet.run_rounds(5)
    robot.platform.raises = Unready("the autopilot is in RTL")
    fleet.run(1.0)
    robot.platform.raises = None
    fleet.run(23.0)
    assert robot.agent.phase == "stopping" and not robot.done()
    fleet.run(3.0)
    assert robot.done() and robot.agent.status == 5 and robot.agent.phase == "stopped"
    assert "did not stop in time" not in "".join(robot.lines)


def test_a_rested_robot_whose_body_is_switched_off_still_serves_until_it_is_told_to_end() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(5)
    bert = fleet.robots[1]
    bert.platform.raises = Unready("a pilot took over")
    fleet.run(0.1)
    bert.platform.raises = None
    fleet.run(0.5)
    assert bert.agent.phase == "stopped"
    bert.platform.raises = Unready("switched off")
    fleet.run(30.0)
    assert not bert.done() and fleet.robots[0].records[-1].skipped == "no event enabled"
    bert.agent.end("SIGTERM")
    fleet.run(0.1)
    assert bert.done() and bert.agent.status == 5 and "did not stop in time" not in "".join(bert.lines)


def test_a_body_that_cannot_start_is_done_at_once() -> None:
    class Absent(FakePlatform):
        def start(self, now: float) -> None:
            raise Unready("no autopilot on udpin:14550")

    fleet = Fleet(n=1)
    fleet.boot(0, Absent(Point()))
    fleet.run(0.1)
    assert fleet.robots[0].agent.done and fleet.robots[0].agent.status == 5


@pytest.mark.parametrize("forever", [False, True])
def test_an_internal_error_brings_the_body_to_rest(forever: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(5)
    robot = fleet.robots[1]

    def broken(*arguments: Any) -> float:
        raise AttributeError("our mistake")

    monkeypatch.setattr(robot.agent._rounds, "poll", broken)
    if forever:
        robot.platform.raises = AttributeError("our second mistake")
    fleet.run(5.0)
    assert robot.done() and robot.agent.status == 70
    assert robot.platform.stopping is not None and robot.platform.stopped != forever
    assert len([line for line in robot.lines if "internal error, please report it" in line]) == 1
    assert "our mistake" in "".join(robot.lines) or forever


def test_a_full_disk_ends_the_trace_with_one_warning_and_not_the_robot() -> None:
    class Full(io.BytesIO):
        def write(self, data: Any) -> int:
            if self.tell() > 2000:
                raise OSError(28, "No space left on device")
            return super().write(data)

        def close(self) -> None:
            """As a file on a full disk: closing fails too."""
            raise OSError(28, "No space left on device")

    warnings: list[str] = []
    fleet = Fleet(n=1).boot_all()
    robot = fleet.robots[0]
    robot.agent._journal._trace = Trace(Full(), warnings.append)
    fleet.run_rounds(60)
    assert robot.agent.phase == "running" and warnings == ["the trace ends here: No space left on device"]


def test_the_trace_is_what_its_readers_rely_on() -> None:
    fleet = Fleet().boot_all()
    fleet.run_told(4)
    robot = fleet.robots[1]
    lines = [json.loads(line) for line in robot.file.getvalue().splitlines()]
    assert lines[0] == {
        "kind": "header",
        "format": "koord-trace/2",
        "app": "lineform",
        "applications": ["lineform"],
        "robot": "bert",
        "pid": 1,
        "n_sys": 5,
        "delta": 0.1,
        "program_hash": "00112233445566aa",
    }
    assert [p["phase"] for p in robot.trace("phase") if not p["detail"]] == ["starting", "joining"]
    rounds = robot.trace("round")
    assert [r["round"] for r in rounds] == [1, 2, 3, 4]
    assert set(rounds[0]) - {"counters"} == {
        *("kind", "time", "round", "event", "skipped", "fault", "sensors", "shared", "actuators", "late"),
        *("clock_bound", "locals", "copy", "application"),
    }
    assert rounds[0]["event"] == "TargetUpdate" and rounds[0]["shared"]["x"] == [-3.0, 2.5, 0.0]
    assert all(b["time"] - a["time"] == pytest.approx(0.1, abs=0.02) for a, b in pairwise(rounds))
    assert fleet.robots[0].trace("round")[0]["skipped"] == "no event enabled"


class Landing(FakePlatform):
    """Takes longer to come to rest than robots wait for one that has ended."""

    @property
    def stopped(self) -> bool:
        return self.stopping is not None and self.now - self.stopping >= 3.0


def test_a_normal_end_warns_of_nothing() -> None:
    fleet = Fleet(n=3, safety=Safety(peer_timeout=10))
    for pid in range(2):
        fleet.boot(pid, Landing(STARTS[pid]))
    fleet.boot(2)
    fleet.run_rounds(5)
    for robot in fleet.robots.values():
        robot.agent.end("SIGTERM: stopping safely")
    fleet.run(5.0)
    assert all(robot.agent.done for robot in fleet.robots.values())
    said = [line for robot in fleet.robots.values() for line in robot.lines]
    assert any("cleo does not count" in line for line in said)
    assert not [line for line in said if ": info:" not in line]
