"""A whole agent, with its rounds and its safety layer, over a quad that flies by a feed; one simulated clock."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.fixtures.fleet import Fleet
from benchmarks.fixtures.quad_rig import at
from koordgen.runtime.ops.checks import SURROUNDINGS
from koordgen.runtime.values.points import Point
from tests.quad.platform.fed import FedRig

MODES = pytest.mark.parametrize("mode", ["gps_input", "vision", "odometry"])


class InItsWorld:
    """The rig's platform; the world goes on whenever it is polled."""

    def __init__(self, rig: FedRig) -> None:
        self.rig = rig

    def poll(self, now: float) -> None:
        self.rig.pass_time(now - self.rig.now)
        self.rig.quad.poll(now)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rig.quad, name)


def flying(mode: str) -> tuple[FedRig, Fleet, Any]:
    """A fleet of one, in its mission and at its flight height."""
    rig, fleet = FedRig(mode), Fleet(n=1)
    rig.now = fleet._clocks[0].now()
    robot: Any = fleet.boot(0, InItsWorld(rig))  # type: ignore[arg-type]
    fleet.run(30.0, lambda: robot.agent.round > 20 and rig.body.position[2] > 1.3)
    assert robot.agent.phase == "running", robot.lines
    return rig, fleet, robot


@MODES
def test_a_silent_feed_holds_skips_and_lands(mode: str) -> None:
    rig, fleet, robot = flying(mode)
    rig.station, silent = None, fleet.time.time
    fleet.run(1.2)
    assert any("own position is 0.5 s old" in line for line in robot.lines)
    assert "own position" in (robot.records[-1].skipped or "")
    fleet.run(2.0, lambda: robot.agent.phase == "stopping")
    assert robot.agent.phase == "stopping" and fleet.time.time - silent < 2.2
    fleet.run(30.0, robot.done)
    assert robot.agent.status == SURROUNDINGS and rig.body.position[2] == 0.0 and not rig.body._on
    assert any("no fresh position has arrived on udp:0.0.0.0:47300 for 2.0 s" in line for line in robot.lines)


@MODES
def test_a_jump_lands(mode: str) -> None:
    rig, fleet, robot = flying(mode)
    rig.markers.moved, place = Point(0.0, 1.0, 0.0), at(rig)
    fleet.run(2.0, lambda: robot.agent.phase == "stopping")
    assert any("position source jumped" in line for line in robot.lines)
    assert abs(at(rig).y - place.y) < 0.2
    fleet.run(30.0, robot.done)
    assert robot.agent.status == SURROUNDINGS and rig.body.position[2] == 0.0


def test_a_short_gap_is_bridged() -> None:
    rig, fleet, robot = flying("vision")
    station, rig.station = rig.station, None
    fleet.run(0.25)
    rig.station = station
    fleet.run(3.0)
    assert robot.agent.phase == "running" and not any("own position" in line for line in robot.lines)
