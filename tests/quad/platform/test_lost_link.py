"""A whole agent whose link to the autopilot is lost in flight: what it says, what it does, how it goes on."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from benchmarks.fixtures.lineform import PROGRAM
from benchmarks.fixtures.quad_rig import Rig, at, settings
from koordgen.runtime.agent.machine import SURROUNDINGS, Agent
from koordgen.runtime.agent.records import MemoryStore
from koordgen.runtime.net.network import Conditions, MemoryNetwork
from koordgen.runtime.trace.writer import Trace
from koordgen.runtime.values.clock import SimulatedClock

LAND = 9


class Flown:
    """One robot in its mission, hovering; `lines` are what its agent tells."""

    def __init__(self) -> None:
        self.rig = Rig()
        self.lines: list[str] = []
        self.clock = SimulatedClock()
        self.clock.time = self.rig.now
        network = MemoryNetwork(self.clock, 1, Conditions())
        self.agent = Agent(
            PROGRAM, settings(), None, self.rig.quad, self.clock, network.transport(0),
            Trace(None, self.lines.append), lambda level, line: self.lines.append(line), bytes(8), MemoryStore(),
        )  # fmt: skip
        assert self.run(30.0, lambda: self.agent.phase == "running" and self.agent.round > 5), self.lines

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        end = self.rig.now + seconds
        while self.rig.now < end and not self.agent.done:
            self.rig.pass_time(0.025)
            self.clock.time = self.rig.now
            self.agent.poll(self.rig.now)
            if until():
                return True
        return False

    def said(self, *words: str) -> bool:
        return any(all(word in line for word in words) for line in self.lines)

    @property
    def landing(self) -> bool:
        assert self.rig.autopilot is not None
        return self.rig.autopilot.copter.mode == LAND


@pytest.fixture
def flown() -> Flown:
    return Flown()


def test_a_break_of_a_second_is_a_pause(flown: Flown) -> None:
    flown.rig.wire.cut = True
    flown.run(1.0)
    assert flown.said("own position is 0.5 s old", "nothing comes on udpin:127.0.0.1:14550; was flying")
    flown.rig.wire.cut = False
    flown.run(2.0)
    assert flown.said("own position is fresh again") and flown.agent.phase == "running" and flown.rig.quad.ready
    assert at(flown.rig).z > 1.0


def test_after_two_seconds_it_lands_for_good(flown: Flown) -> None:
    flown.rig.wire.cut = True
    flown.run(3.0)
    assert flown.agent.phase == "stopping" and not flown.landing
    assert flown.said("stopping: no own position for 2.", "on udpin:127.0.0.1:14550; was flying")
    flown.rig.wire.cut = False
    assert flown.run(1.5, lambda: flown.landing), "before its own failsafe does"
    flown.run(15.0)
    assert flown.agent.phase == "stopped" and flown.agent.status == SURROUNDINGS and at(flown.rig).z == 0.0


def test_a_link_that_stays_away_is_given_up_when_the_autopilot_has_landed_by_itself(flown: Flown) -> None:
    flown.rig.wire.cut = True
    cut = flown.rig.now
    assert flown.run(7.0, lambda: flown.landing) and 4.0 < flown.rig.now - cut < 5.2
    flown.run(60.0)
    assert flown.agent.done and flown.agent.status == SURROUNDINGS and 35.0 < flown.rig.now - cut < 45.0
    assert flown.said("the autopilot has fallen silent on udpin:127.0.0.1:14550 (30 s)")
    assert flown.said("the vehicle did not stop within 10 s")
    assert at(flown.rig).z == 0.0
