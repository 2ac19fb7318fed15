"""Whole agents with monitors: what a violated property makes a robot do, and what one that is cut off still tells."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from koordgen.runtime.agent.machine import VIOLATED
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.points import Point
from tests.runtime.monitor.test_monitor import generated

# Robot 1 goes out of its yard and back, as robot 0 says.
TEXT = """\
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
  assume position' in Rect(position, target)
allread: int x[N_SYS]
allwrite: int turn
local: int count
Lead:
  pre: pid == 0
  eff:
    count += 1
    x[pid] = count
    turn = count
Follow:
  pre: pid == 1
  eff: Motion.target = Point(3 if 10 < x[0] < 40 else 0, 0, 0)
invariant Yard: forall i in ID: Motion.position[i].x <= 1
invariant Same: x[0] == turn
invariant Early: forall i in ID: x[i] < 30
"""
FOUND = generated(TEXT)


def started(n: int = 3, **monitors: str) -> Fleet:
    fleet = Fleet(n=n, conditions=Conditions(delay=0.001), program=FOUND.program)
    for pid in range(n):
        fleet.boot(pid, FakePlatform(Point(0.0, 2.0 * pid)), properties=FOUND, monitors=monitors)
    return fleet


def outcomes(fleet: Fleet, pid: int, name: str) -> list[tuple[str, int]]:
    return [(t["outcome"], t["round"]) for t in fleet.robots[pid].lines_of("monitor") if t["name"] == name]


def far(fleet: Fleet) -> float:
    return fleet.robots[1].platform.position.x


def test_each_robot_tells_what_it_knows() -> None:
    fleet = started()
    fleet.run_rounds(60)
    assert [o for o, _ in outcomes(fleet, 0, "Yard")] == ["unknown"]
    said = outcomes(fleet, 1, "Yard")
    assert [o for o, _ in said] == ["unknown", "violated", "unknown"] and 20 < said[1][1] < 30
    for pid in range(3):
        (held, _), (violated, round_) = outcomes(fleet, pid, "Early")
        assert (held, violated, round_) == ("held", "violated", 31), "all know the store at the same round"
        assert outcomes(fleet, pid, "Same") == [("held", 1)]
    told = next(line for line in fleet.robots[1].lines if "Yard" in line)
    assert "warning: invariant Yard (a.koord:19) is violated: i = 1 (bert): Motion.position[1] = (1" in told
    assert fleet.robots[1].agent.monitors.report()["counts"] == {"unknown": 1, "held": 2, "violated": 1}
    (trace,) = [t for t in fleet.robots[2].lines_of("monitor") if t["outcome"] == "violated"]
    assert (trace["of"], trace["name"], trace["line"], trace["age"], trace["action"]) == (
        "invariant", "Early", "a.koord:21", 0, "log"
    )  # fmt: skip


def test_hold_lasts_until_it_is_right_again_and_the_program_goes_on_meanwhile() -> None:
    fleet = started(Yard="hold")
    fleet.run_rounds(45)
    robot = fleet.robots[1]
    assert robot.held() and 1.0 < far(fleet) < 1.3
    assert robot.records[-1].event == "Follow", "its events go on"
    robot.platform.position = Point(0.5, 2.0)  # somebody carries it back
    fleet.run_rounds(60)
    assert not robot.held() and far(fleet) < 0.5
    assert [o for o, _ in outcomes(fleet, 1, "Yard")] == ["unknown", "violated", "unknown"]


DOES = {"land": "; it lands", "stop": "; it stops safely"}


@pytest.mark.parametrize("action", ["land", "stop"])
def test_land_and_stop_are_for_good(action: str) -> None:
    fleet = started(Yard=action)
    fleet.run_rounds(45)
    robot = fleet.robots[1]
    assert robot.agent.phase == "stopped" and robot.agent.status == VIOLATED and far(fleet) < 1.3
    phases = [(t["phase"], t["detail"]) for t in robot.lines_of("phase")]
    assert any(p == "stopping" and d.startswith("invariant Yard (a.koord:19) is violated: i = 1") for p, d in phases)
    assert any("properties: " in line and "violated: invariant Yard" in line for line in robot.lines)
    (told,) = [line for line in robot.lines if "Motion.position[1] = (1" in line]
    assert "error: invariant Yard (a.koord:19) is violated: i = 1" in told and told.endswith(DOES[action])
    assert any(line.endswith(": info: stopping") for line in robot.lines), "why was told just before"
    assert fleet.robots[0].agent.phase == "running"


def test_off_is_not_looked_at() -> None:
    fleet = started(Yard="off", default="stop")
    fleet.run_rounds(28)
    assert outcomes(fleet, 1, "Yard") == [] and far(fleet) > 1.2
    fleet.run_rounds(35)
    assert {robot.agent.phase for robot in fleet.robots.values()} <= {"stopping", "stopped"}, "Early stops all"


def test_who_is_cut_off_does_not_know_for_long() -> None:
    fleet = started()
    fleet.run_rounds(8)
    fleet.network.cut = lambda sender, receiver: 2 in (sender, receiver)
    fleet.run_rounds(40)
    told = outcomes(fleet, 2, "Same")
    assert told[0] == ("held", 1) and told[1][0] == "unknown" and 18 <= told[1][1] <= 22
    (unknown,) = [t for t in fleet.robots[2].lines_of("monitor") if t["name"] == "Same" and t["outcome"] == "unknown"]
    assert unknown["age"] == 11 and "11 rounds old" in unknown["why"]
    assert [o for o, _ in outcomes(fleet, 0, "Same")] == ["held"], "the others go on without it and know"


def test_what_raises_is_told_and_brings_nobody_down(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: Any) -> Any:
        raise RuntimeError("a mistake")

    fleet = started()
    fleet.run_rounds(5)
    monkeypatch.setattr("koordgen.runtime.monitor.monitor.Monitors._put", broken)
    fleet.run_rounds(10)
    lines = [line for line in fleet.robots[0].lines if "a monitor failed and is off: RuntimeError: a mistake" in line]
    assert len(lines) == 1 and fleet.robots[0].agent.phase == "running"


def test_a_program_without_properties_has_no_moments() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(3)
    assert all(
        robot.agent._rounds is not None and robot.agent._rounds.observation is None for robot in fleet.robots.values()
    )
