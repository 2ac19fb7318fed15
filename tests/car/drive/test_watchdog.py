"""The watchdog as the process that it is, on a pseudo-terminal: whatever becomes of the agent, the car is braked.

These tests take real time, some tenths of a second each.
"""

from __future__ import annotations

import os
import select
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from koordgen.runtime.vehicle.platform import Unready
from targets.car.drive import vesc
from targets.car.drive.links import SerialLink
from targets.car.drive.watched import WatchdogProcess
from tests.terminal import terminal

ROOT = Path(__file__).parents[3]
BRAKE = vesc.encode(vesc.Brake(10.0))
GO = vesc.encode(vesc.SetErpm(4614.0))


class Line:
    """The motor controller's end of the cable: what came, and when."""

    def __init__(self, master: int, path: str) -> None:
        self.master, self.path = master, path
        self._decoder = vesc.Decoder()
        self.came: list[tuple[float, vesc.Message]] = []

    def watch(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0 and not until():
            if select.select([self.master], [], [], min(left, 0.02))[0]:
                data = os.read(self.master, 4096)
                now = time.monotonic()
                self.came += [(now, message) for message in self._decoder.feed(data)]

    def times(self, kind: type) -> list[float]:
        return [at for at, message in self.came if isinstance(message, kind)]

    def braked_after_driving(self) -> float:
        """Seconds from the last command to drive to the first to brake."""
        last = self.times(vesc.SetErpm)[-1]
        return next(at for at in self.times(vesc.Brake) if at > last) - last


@pytest.fixture
def line() -> Iterator[Line]:
    with terminal(30) as (master, path):
        yield Line(master, path)


class Agent:
    """Drives at 20 Hz, in this process."""

    def __init__(self, path: str) -> None:
        self.link = SerialLink(path)
        self.dog = WatchdogProcess()
        self.dog.hold(self.link.fileno(), BRAKE)

    def drive(self, line: Line, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.link.write(GO)
            self.dog.beat()
            line.watch(min(0.05, seconds))
            self.dog.poll()

    def begin(self, line: Line) -> Agent:
        end = time.monotonic() + 5.0
        while self.dog.trouble:
            assert time.monotonic() < end, self.dog.trouble
            self.drive(line, 0.05)
        return self

    def close(self) -> None:
        self.dog.close(standing=True)
        self.link.close()


@pytest.fixture
def agent(line: Line) -> Iterator[Agent]:
    made = Agent(line.path).begin(line)
    yield made
    made.close()


def test_an_agent_that_falls_silent_is_braked_for_within_a_fifth_of_a_second_at_20_hz(line: Line, agent: Agent) -> None:
    agent.drive(line, 0.5)
    assert not line.times(vesc.Brake), "it does not brake while commands come"
    line.watch(1.0)
    assert 0.13 < line.braked_after_driving() < 0.2
    assert 15 <= len(line.times(vesc.Brake)) <= 19
    line.came.clear()
    agent.drive(line, 0.5)
    assert not line.times(vesc.Brake), "it leaves the car to the agent again"
    (told,) = agent.dog.log_lines()
    assert told.startswith("the watchdog braked because no command had come for 0.1")
    line.watch(0.4)
    agent.drive(line, 0.2)
    assert not agent.dog.log_lines(), "not told again within 5 s"


def test_commands_are_no_later_for_it(line: Line, agent: Agent) -> None:
    late = []
    for _ in range(40):
        line.came.clear()
        sent = time.monotonic()
        agent.link.write(GO)
        agent.dog.beat()
        line.watch(0.05, lambda: bool(line.came))
        late.append(line.came[0][0] - sent)
        agent.dog.poll()
        time.sleep(0.02)
    assert statistics.median(late) < 0.002


def test_telling_it_of_a_command_takes_no_time(line: Line, agent: Agent) -> None:
    took = []
    for _ in range(100):
        began = time.perf_counter()
        agent.dog.beat()
        agent.dog.poll()
        took.append(time.perf_counter() - began)
        line.watch(0.005)
    assert statistics.median(took) < 0.001


def test_a_car_that_was_let_go_of_is_left_alone(line: Line, agent: Agent) -> None:
    agent.drive(line, 0.2)
    agent.dog.release()
    line.watch(0.4)
    assert not line.times(vesc.Brake)


def test_an_orderly_end_ends_it_at_once(line: Line, agent: Agent) -> None:
    agent.drive(line, 0.1)
    pid = agent.dog.pid
    agent.close()
    agent.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    line.watch(0.3)
    assert not line.times(vesc.Brake)


def test_an_end_while_the_car_drives_leaves_it_to_the_watchdog(line: Line, agent: Agent) -> None:
    agent.drive(line, 0.1)
    agent.dog.close(standing=False)
    line.watch(0.5)
    assert line.braked_after_driving() < 0.1 and len(line.times(vesc.Brake)) >= 8


def test_signals_for_the_agent_do_not_end_it(line: Line, agent: Agent) -> None:
    agent.drive(line, 0.1)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(agent.dog.pid, number)
    agent.drive(line, 0.3)
    assert not agent.dog.log_lines() and not agent.dog.trouble
    line.watch(0.3)
    assert line.braked_after_driving() < 0.2


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)])
def test_a_watchdog_that_dies_or_hangs_is_told_and_replaced(line: Line, agent: Agent, number: signal.Signals) -> None:
    agent.drive(line, 1.1)  # two are not begun within a second
    first = agent.dog.pid
    os.kill(first, number)
    begin = time.monotonic()
    troubles = set()
    while agent.dog.pid in (0, first) or agent.dog.trouble:
        agent.drive(line, 0.01)
        troubles.add(agent.dog.trouble)
        assert time.monotonic() - begin < 5.0
    assert troubles - {""}, "nothing is driven meanwhile"
    assert any("it is begun anew" in line for line in agent.dog.log_lines())
    line.watch(0.4)
    assert line.braked_after_driving() < 0.2
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


def test_one_that_cannot_be_started_is_told_and_nothing_may_be_driven(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    dog = WatchdogProcess()
    link = SerialLink(line.path)
    dog.hold(link.fileno(), BRAKE)
    dog.beat()
    dog.poll()
    assert dog.trouble == "waiting for the watchdog"
    assert "cannot be started" in dog.log_lines()[0]
    dog.close(standing=True)
    link.close()


# An agent in a process of its own: a platform's drive, commanded at 20 Hz, that gets stuck in the way it is told.
STUCK = """
import ctypes, sys, time
from koordgen.runtime.values.geodesy import LocalFrame
from targets.car.drive.drive import opened
from targets.car.drive.links import RealLinks
from targets.car.control.mpc import Command
from targets.car.base.settings import CarSettings

drive = opened(CarSettings(drive="vesc:" + sys.argv[1]), RealLinks(), LocalFrame(47.0, 8.0, 488.0))
begin = time.monotonic()
while time.monotonic() - begin < 0.5 or drive.blocked:
    drive.read(time.monotonic())
    drive.go(Command(1.0, 0.0), None, time.monotonic())
    time.sleep(0.05)
print("stuck", flush=True)
how = sys.argv[2]
if how == "loop":
    while True:
        pass
elif how == "gil":
    ctypes.PyDLL(None).sleep(60)  # C code that never lets go of the interpreter
elif how == "raise":
    raise SystemExit(3)
time.sleep(60)
"""


@pytest.mark.parametrize(
    "how",
    [
        pytest.param("loop", marks=pytest.mark.slow),
        "stop",
        "kill",
        pytest.param("gil", marks=pytest.mark.slow),
        pytest.param("raise", marks=pytest.mark.slow),
        pytest.param("group", marks=pytest.mark.slow),
    ],
)
def test_an_agent_that_is_stuck_stopped_or_dead_is_braked_for(line: Line, how: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", STUCK, line.path, how]
    agent = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, start_new_session=True)
    try:
        assert agent.stdout is not None
        answers = vesc.encode(vesc.Version(6, 5)) + vesc.encode(vesc.Values(0.0, 11.1))
        end = time.monotonic() + 15.0
        while not select.select([agent.stdout], [], [], 0)[0]:
            assert time.monotonic() < end and agent.poll() is None
            os.write(line.master, answers)
            line.watch(0.05)
        match how:
            case "stop":
                os.kill(agent.pid, signal.SIGSTOP)
            case "kill":
                os.kill(agent.pid, signal.SIGKILL)
            case "group":
                os.killpg(agent.pid, signal.SIGKILL)
        line.watch(1.0)
        assert line.braked_after_driving() < 0.2
        assert len(line.times(vesc.Brake)) > 10
        if agent.poll() is not None:
            SerialLink(line.path).close()  # its successor need not wait
            line.watch(2.0)
            before = len(line.came)
            line.watch(0.3)
            assert len(line.came) == before, "it ends two seconds after the agent"
    finally:
        agent.kill()
        agent.communicate()


def test_two_agents_cannot_have_one_device(line: Line, agent: Agent) -> None:
    with pytest.raises(Unready, match="another program has it"):
        SerialLink(line.path)
