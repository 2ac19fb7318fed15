"""A whole agent, its bundle unchanged, on a pseudo-terminal and in real time: an extern function that does not end, a
process that is stopped or killed, an order to end."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from targets.car.base.settings import CarSettings
from targets.car.drive import vesc
from targets.sim.autopilots.drive import SimulatedDrive
from targets.sim.sensing.station import SimulatedFeed
from tests.car.platform.world import KEY, PHYSICS, TestBody, context

ROOT = Path(__file__).parents[3]
PROGRAM = """
using Motion:
  sensors: Point position
  actuators: Point target

local:
  int n = 0

extern fun think(float x) -> int

init:
  Motion.target = Point(5, 0, 0)

Think:
  pre: True
  eff:
    n = think(Motion.position.x)
"""
FUNCTIONS = """
def think(x: float) -> int:
    while STUCK and x > 0.3:
        pass
    return 1
"""
FLEET = """
delta: 2.0
origin: {latitude: 47.0, longitude: 8.0, altitude: 488.0}
geofence: {lo: [-6.0, -5.0, -0.5], hi: [6.0, 5.0, 4.0]}
robots:
  - name: bert
    target: car
    address: 127.0.0.1:47901
    start: {position: [0.0, 0.0, 0.0], yaw: 0.0}
"""


class Recorded(SimulatedDrive):
    """The simulated VESC, which notes what it was told and when."""

    def __init__(self, body: TestBody) -> None:
        super().__init__(body, context({}, 0.003))
        self.told: list[tuple[float, vesc.Message]] = []
        self._reader = vesc.Decoder()
        step = self._controller.step

        def note(received: bytes, now: float) -> bytes:
            self.told += [(time.monotonic(), message) for message in self._reader.feed(received)]
            return step(received, now)

        self._controller.step = note  # type: ignore[method-assign]

    def last_go(self) -> float:
        return max((at for at, m in self.told if isinstance(m, vesc.SetErpm)), default=0.0)


class Running:
    """The agent's process in a world that goes on in real time."""

    def __init__(self, folder: Path, stuck: bool) -> None:
        self.body = TestBody()
        self.drive = Recorded(self.body)
        self.feed = SimulatedFeed(self.body, context({}, 0.003), "position")
        (folder / "app.koord").write_text(PROGRAM)
        (folder / "app_functions.py").write_text(FUNCTIONS.replace("STUCK", str(stuck)))
        (folder / "fleet.yaml").write_text(FLEET)
        (folder / "fleet.key").write_bytes(KEY)
        (folder / "fleet.key").chmod(0o600)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        build = [sys.executable, "-m", "koordgen", "build", "app.koord", "--target", "car", "--fleet", "fleet.yaml"]
        subprocess.run(build, cwd=folder, env=environment, check=True, capture_output=True)
        body = {**self.drive.overrides, **self.feed.overrides}
        over = {"body": body, "state": None, "key_file": str(folder / "fleet.key"), "insecure": False}
        (folder / "over.json").write_text(json.dumps(over))
        command = [sys.executable, "build/app/bert", "--settings", "over.json"]
        self.log = folder / "log.txt"
        with self.log.open("wb") as log:
            self.agent = subprocess.Popen(command, cwd=folder, stderr=log, stdin=subprocess.DEVNULL)
        self._began = time.monotonic()
        self._ticks = 0

    def run(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            while self._ticks * PHYSICS < now - self._began:
                self._ticks += 1
                self.drive.step(self._ticks * PHYSICS)
                self.feed.step(self._ticks * PHYSICS)
                self.body.step(PHYSICS)
            time.sleep(0.002)

    def until_it_drives(self) -> None:
        end = time.monotonic() + 30.0
        while self.body.truth.x < 0.5:
            assert time.monotonic() < end and self.agent.poll() is None, self.log.read_text()[-2000:]
            self.run(0.05)

    def braked(self, since: float) -> float:
        """Seconds from the last command to drive before that time to the first to brake."""
        last = max(at for at, m in self.drive.told if isinstance(m, vesc.SetErpm) and at <= since)
        return min(at for at, m in self.drive.told if isinstance(m, vesc.Brake) and at > last) - last

    def close(self) -> None:
        self.agent.kill()
        self.agent.wait()
        self.feed.close()
        self.drive.close()


@pytest.fixture
def running(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Running]:
    made = Running(tmp_path, request.param)
    yield made
    made.close()


@pytest.mark.slow
@pytest.mark.parametrize("running", [True], indirect=True)
def test_an_extern_function_that_does_not_end_brakes_the_car(running: Running) -> None:
    """The agent itself ends the event half a round after its begin, here a second: the watchdog does not wait."""
    end = time.monotonic() + 40.0
    while not running.drive.told or running.body.truth.x < 0.31:
        assert time.monotonic() < end and running.agent.poll() is None, running.log.read_text()[-2000:]
        running.run(0.05)
    running.run(3.0)
    told = [(at, isinstance(m, vesc.Brake)) for at, m in running.drive.told if isinstance(m, vesc.SetErpm | vesc.Brake)]
    gaps = [(b - a, brake) for (a, _), (b, brake) in itertools.pairwise(told)]
    assert max(gap for gap, _ in gaps) < 0.2, "it was never without a command for longer"
    assert any(gap > 0.12 and brake for gap, brake in gaps), "the watchdog gave it one"
    log = running.log.read_text()
    assert "the watchdog braked" in log and "not finished by the round's publish deadline" in log, log[-3000:]


@pytest.mark.slow
@pytest.mark.parametrize("running", [False], indirect=True)
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_an_agent_that_is_stopped_or_killed_is_braked_for(running: Running, number: signal.Signals) -> None:
    running.until_it_drives()
    assert running.body.truth.speed > 0.3
    at = time.monotonic()
    running.agent.send_signal(number)
    running.run(1.2)
    assert running.braked(at) < 0.2 and abs(running.body.truth.speed) < 0.02
    if number == signal.SIGSTOP:
        running.agent.send_signal(signal.SIGCONT)
        running.run(1.5)
        assert "the watchdog braked" in running.log.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("running", [False], indirect=True)
def test_told_to_end_it_brakes_and_leaves_nothing_behind(running: Running) -> None:
    running.until_it_drives()
    running.agent.send_signal(signal.SIGTERM)
    end = time.monotonic() + 5.0
    while running.agent.poll() is None and time.monotonic() < end:
        running.run(0.05)
    assert running.agent.poll() == 0 and abs(running.body.truth.speed) < 0.02
    before = len(running.drive.told)
    running.run(0.3)
    assert len(running.drive.told) == before
    assert CarSettings().brake_current == next(m.current for _, m in running.drive.told if isinstance(m, vesc.Brake))
