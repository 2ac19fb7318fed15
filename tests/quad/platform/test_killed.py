"""A whole agent, a process of its own, that is killed in flight: what its autopilot does, and its successor."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from benchmarks.fixtures.quad_rig import ORIGIN, STEP, PointMass, settings
from targets.sim.autopilots.autopilot import SimulatedAutopilot
from targets.sim.base.bodies import DeviceContext
from tests.runtime.net.transports import free_ports

ROOT = Path(__file__).parents[3]
AGENT = """
import sys
from pathlib import Path
from koordgen.runtime.agent.process import main
from targets.quad.platform.platform import Quad
from benchmarks.fixtures.lineform import PROGRAM
sys.exit(main(PROGRAM, Quad, Path(sys.argv[1]), []))
"""
GUIDED, LAND = 4, 9


class World:
    """The autopilot and its body, at `pace` times the speed of the wall clock; 0: as fast as can be."""

    def __init__(self, folder: Path) -> None:
        self.body = PointMass()
        harness = {"boot": 0.2, "spool_up": 0.3}
        self.autopilot = SimulatedAutopilot(self.body, DeviceContext("alice", {}, harness, ORIGIN, 1, b""))
        self.copter = self.autopilot.copter
        self.now = 1000.0
        self.running: list[subprocess.Popen[bytes]] = []
        self._folder = folder / "alice"
        self._folder.mkdir()
        port, control = free_ports(2)
        plain = msgspec.to_builtins(settings(**self.autopilot.overrides, flight_height=0.6))
        plain |= {"insecure": True, "control": control, "trace": str(self._folder / "trace.jsonl")}
        plain["peers"] = [{"name": "alice", "host": "127.0.0.1", "port": port}]
        (self._folder / "settings.json").write_text(json.dumps(plain))

    def agent(self) -> subprocess.Popen[bytes]:
        """Start one, and wait until its mission runs."""
        (self._folder / "trace.jsonl").unlink(missing_ok=True)
        process = subprocess.Popen(
            [sys.executable, "-c", AGENT, str(self._folder)], stderr=subprocess.DEVNULL, cwd=ROOT
        )
        self.running.append(process)
        return process

    def in_mission(self) -> bool:
        trace = self._folder / "trace.jsonl"
        return trace.exists() and '"running"' in trace.read_text()

    def run(self, seconds: float, until: Callable[[], bool], pace: float = 1.0) -> bool:
        """Whether it came to hold within so many seconds of the world."""
        began, wall = self.now, time.monotonic()
        while self.now < began + seconds:
            if until():
                return True
            while pace == 0 or self.now < began + (time.monotonic() - wall) * pace:
                self.now += STEP
                self.body.step(STEP)
                self.autopilot.step(self.now)
                if pace == 0:
                    break
            if pace:
                time.sleep(0.005)
        return False


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    made = World(tmp_path)
    yield made
    for process in made.running:
        process.kill()
        process.wait()
    made.autopilot.close()


def kill(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


def test_killed_in_flight(world: World) -> None:
    """A successor that comes in time takes over in the air; without one the vehicle lands 5 s after the last
    heartbeat, where it is."""
    first = world.agent()
    assert world.run(25.0, world.in_mission) and world.copter.mode == GUIDED and world.body.position[2] > 0.3
    kill(first)
    modes: set[int] = set()
    heights: list[float] = []

    def taken_over() -> bool:
        modes.add(world.copter.mode)
        heights.append(world.body.position[2])
        return world.in_mission()

    second = world.agent()
    assert world.run(10.0, taken_over, pace=0.3)  # slowly: the successor's start takes as long as this host likes
    assert modes == {GUIDED} and min(heights) > 0.3 and world.copter.armed
    kill(second)
    world.run(0.1, lambda: False)  # what it sent is taken
    heard, place = world.copter.ground_station, world.body.position[:2]
    assert heard is not None and world.now - heard < 1.5
    assert world.run(7.0, lambda: world.copter.mode == LAND, pace=0)
    assert 5.0 < world.now - heard < 5.1
    assert world.run(10.0, lambda: not world.copter.armed, pace=0)
    assert world.body.position[2] == 0.0 and world.body.position[:2] == pytest.approx(place, abs=0.1)
