"""What a robot's trace tells is enough to know what its events saw: own variables and its copy of the shared store."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet, Robot
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.clock import SimulatedClock
from koordgen.runtime.values.points import Point
from tests.runtime.replication.test_restarts import ENDLESS, SOON, kill


def followed(robot: Robot) -> int:
    """Goes through a trace beside the records of the same run; how many rounds of it saw the shared store."""
    records = {r.round: r for r in robot.records}
    own: dict[str, Any] = {}
    copy: dict[str, Any] = {}
    seen = 0
    pid = robot.agent._settings.pid
    for line in robot.lines_of("init", "round"):
        if line["kind"] == "init":
            own = dict(line["locals"])
            continue
        own |= line.get("restored", {}).get("locals", {})
        for name, value in line.get("copy", {}).items():
            if name == "x":
                copy["x"] = {**copy.get("x", {}), **{int(p): v for p, v in value.items()}}
            else:
                copy[name] = value
        frame = records[line["round"]].frame
        if frame is not None:
            seen += 1
            assert copy["last"] == frame.shared["last"]
            assert [copy["x"][p] for p in range(frame.n_sys)] == json.loads(msgspec.json.encode(frame.shared["x"]))
            assert own == frame.locals
        own |= line.get("locals", {})
        copy["last"] = line["shared"].get("last", copy.get("last"))
        if "x" in line["shared"] and copy:
            copy["x"][pid] = line["shared"]["x"]
    return seen


@pytest.mark.parametrize("seed", range(4))
def test_a_trace_tells_what_events_saw_whatever_happens(seed: int) -> None:
    conditions = Conditions(loss=0.1, delay=0.001, jitter=0.02, duplication=0.1)
    fleet = Fleet(n=3, seed=seed, conditions=conditions, program=ENDLESS, safety=SOON).boot_all()
    fleet.run(3.0)
    gone = kill(fleet, 1)
    fleet.run(1.5)
    fleet.boot(1)
    fleet.run(4.0)
    robots = [gone, *fleet.robots.values()]
    assert min(followed(robot) for robot in robots) >= 3
    assert fleet.robots[1].lines_of("round", with_="restored"), "it came back with what it had"
    assert not fleet.robots[1].trace("init") and len(gone.trace("init")) == 1


def test_only_what_has_changed_is_told() -> None:
    fleet = Fleet(n=3).boot_all()
    fleet.run_told(12)
    ends, middle = fleet.robots[0].trace("round"), fleet.robots[1].trace("round")
    assert set(middle[0]["copy"]) == {"x", "last"} and set(middle[0]["copy"]["x"]) == {"0", "1", "2"}
    assert all("copy" not in line or set(line["copy"]) == {"last"} for line in middle[1:]), "nobody else writes x"
    assert all(set(line["copy"]["x"]) == {"1"} for line in ends[1:]), "robot 1 does, in every round"
    assert [line["locals"] for line in middle[:3]] == [{"count": 1}, {"count": 2}, {"count": 3}]
    assert all("locals" not in line for line in ends)


def test_init_and_the_view_are_told() -> None:
    fleet = Fleet(n=3).boot_all()
    fleet.run_told(3)
    robot = fleet.robots[1]
    (init,) = robot.trace("init")
    assert init["shared"] == {"x": [-3.0, 2.5, 0.0], "last": 1} and init["locals"] == {"count": 0}
    assert init["actuators"] == {"Motion.target": [-3.0, 2.5, 0.0]} and not init["stopped"]
    assert [(v["number"], v["since"], v["members"]) for v in robot.trace("view")] == [(0, 1, [0, 0, 0])]


class TickingClock(SimulatedClock):
    """Clock of a real computer: it goes on while an agent works."""

    ticks = 0.0

    def now(self) -> float:
        self.ticks += 1e-6
        return super().now() + self.ticks


def test_init_is_recorded_after_the_phase_in_which_it_runs() -> None:
    """A merged trace is sorted by time, and each process in it begins with the phase `starting`."""
    fleet = Fleet(n=1, clocks=lambda _, base: TickingClock(base))
    robot = fleet.boot(0, FakePlatform(Point(0, 0, 0), ready_after=0.0))
    fleet.run(1)
    times = [record["time"] for record in robot.lines_of("phase", "init")]
    assert times == sorted(times) and len(times) > 3
