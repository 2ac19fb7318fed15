"""The car's platform against the simulated motor controller, over a real pseudo-terminal and loopback UDP.

These tests open devices; the world's clock is still the test's own, so that no second passes for a second.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from benchmarks.fixtures import car_scenes as scenes
from benchmarks.fixtures.car_checker import collisions
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Unready
from targets.car.base.settings import CarSettings
from targets.car.drive import vesc
from targets.car.drive.links import RealLinks
from targets.car.planning.curves import Curve
from targets.car.planning.planner import JUDGE, Plan, Wish, segments
from targets.car.platform.platform import Car
from targets.planning.process import Beside, Inside, made
from targets.planning.world import Scene
from targets.sim.autopilots.drive import TIMEOUT, Controller, SimulatedDrive, simulated
from targets.sim.autopilots.rover import SimulatedRover
from targets.sim.base.bodies import Device
from targets.sim.sensing.station import SimulatedFeed
from tests.car.platform.world import KEY, PHYSICS, OwnTime, TestBody, context, robot_settings
from tests.terminal import terminal


class Bench:
    """A body, its device and the agent's platform on one clock."""

    def __init__(self) -> None:
        self.body = TestBody(-1.0, 0.5, 0.3)
        self.device: Device = SimulatedDrive(self.body, context({}, 0.005))
        self.feed: Device = SimulatedFeed(self.body, context({}, 0.005), "position", lambda: self.now)
        self.overrides = {**self.device.overrides, **self.feed.overrides}
        self.car = Car(robot_settings(self.overrides), KEY, OwnTime(), Inside)
        self.ticks = 0

    @property
    def now(self) -> float:
        return self.ticks * PHYSICS

    def run(self, seconds: float, agent: bool = True, device: bool = True) -> None:
        for _ in range(round(seconds / PHYSICS)):
            self.ticks += 1
            if device:
                self.device.step(self.now)
            self.feed.step(self.now)
            self.body.step(PHYSICS)
            if agent and self.ticks % 4 == 0:
                self.car.poll(self.now)

    def begin(self) -> None:
        """The watchdog is a real process: until it answers, real time passes, too."""
        self.car.start(self.now)
        late = time.monotonic() + 10.0
        while not self.car.ready:
            assert time.monotonic() < late, self.car.progress
            self.run(0.05)
            time.sleep(0.01)

    def until(self, said: str, seconds: float) -> None:
        begin = self.now
        while said not in self.car.progress:
            assert self.now - begin < seconds, self.car.progress
            self.run(0.05)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.car.close()
    made.feed.close()
    made.device.close()
    made.device.close()


def test_a_mission_over_the_real_links(bench: Bench) -> None:
    bench.begin()
    bench.car.command({"Motion.target": Point(1.5, -0.5, 0.0)}, bench.now)
    bench.run(7.0)
    assert bench.car.sense(bench.now).values["Motion.reached"] is True
    truth = bench.body.truth
    assert abs(truth.x - 1.5) < 0.06 and abs(truth.y + 0.5) < 0.06
    bench.car.command({"Motion.target": Point(-3.0, 0.0, 0.0)}, bench.now)
    bench.run(4.0)
    assert abs(bench.body.truth.speed) > 0.3
    bench.car.stop(bench.now)
    bench.run(1.5)
    assert bench.car.stopped and abs(bench.body.truth.speed) < 0.01


def test_an_agent_that_dies_leaves_a_car_that_stops(bench: Bench) -> None:
    bench.begin()
    bench.car.command({"Motion.target": Point(5.0, 0.5, 0.0)}, bench.now)
    bench.run(2.0)
    assert bench.body.truth.speed > 0.5
    bench.car.close()
    bench.run(TIMEOUT + 0.6, agent=False)
    assert abs(bench.body.truth.speed) < 0.01


def test_a_vanished_device_is_unready_and_names_it(bench: Bench) -> None:
    bench.car.start(bench.now)
    bench.run(0.5)
    bench.device.close()
    with pytest.raises(Unready, match="/dev/pts"):
        for i in range(200):
            bench.car.poll(bench.now + i * 0.05)


def test_unplugged_while_driving_and_plugged_in_again_it_goes_on(bench: Bench, tmp_path: Path) -> None:
    name = tmp_path / "vesc"
    name.symlink_to(str(bench.device.overrides["drive"]).removeprefix("vesc:"))
    bench.car = Car(robot_settings({**bench.overrides, "drive": f"vesc:{name}"}), KEY, OwnTime(), Inside)
    bench.car.start(bench.now)
    bench.run(1.0)
    bench.car.command({"Motion.target": Point(1.5, 0.5, 0.0)}, bench.now)
    bench.run(1.5)
    assert bench.body.truth.speed > 0.5
    bench.device.close()
    name.unlink()
    bench.body.drive(0.0, 0.0)  # as the VESC's own time-out does
    bench.run(1.0, device=False)
    assert "is gone" in bench.car.progress and abs(bench.body.truth.speed) < 0.01
    bench.device = SimulatedDrive(bench.body, context({}, 0.005))
    name.symlink_to(str(bench.device.overrides["drive"]).removeprefix("vesc:"))
    bench.run(7.0)
    assert bench.car.sense(bench.now).values["Motion.reached"] is True
    lost, back = bench.car.log_lines()
    assert f"{name} is gone" in lost and back == f"the motor controller at {name} is there again"


def test_what_the_drive_setting_names_is_simulated() -> None:
    body = TestBody()
    for drive, kind in (("vesc:/dev/ttyACM0", SimulatedDrive), ("rover:udpin:0.0.0.0:14550", SimulatedRover)):
        device = simulated(body, context({"drive": drive}, 0.0))
        assert isinstance(device, kind) and str(device.overrides["drive"]).startswith(drive.partition(":")[0])
        device.close()


def test_a_missing_device_and_a_port_in_use_are_unready(bench: Bench) -> None:
    missing = Car(robot_settings({**bench.overrides, "drive": "vesc:/dev/koordgen-no-such"}), KEY)
    with pytest.raises(Unready, match=r"at /dev/koordgen-no-such: No such file or directory$") as error:
        missing.start(0.0)
    assert error.value.hint
    missing.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        position = f"udp:127.0.0.1:{other.getsockname()[1]}"
        taken = Car(robot_settings({**bench.overrides, "position": position}), KEY)
        with pytest.raises(Unready, match="cannot receive positions") as error:
            taken.start(0.0)
        assert "port" in error.value.hint
        taken.close()


@pytest.mark.parametrize("wrong", ["drive=can:0", "drive=vesc:", "position=udp:1234", "position=tcp:a:1"])
def test_settings_of_unknown_form_are_unready(bench: Bench, wrong: str) -> None:
    key, _, value = wrong.partition("=")
    car = Car(robot_settings({**bench.overrides, key: value}), KEY)
    with pytest.raises(Unready, match=r"is not a UDP address|is not understood"):
        car.start(0.0)
    car.close()


def test_the_device_survives_noise_and_a_deaf_agent(bench: Bench) -> None:
    device = bench.device.overrides["drive"].removeprefix("vesc:")
    line = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        for _ in range(200):
            os.write(line, os.urandom(50) + vesc.encode(vesc.AskValues()) * 20)  # never read
            bench.run(PHYSICS, agent=False)
        os.write(line, bytes(600))
        os.write(line, vesc.encode(vesc.SetErpm(4614.0)) + vesc.encode(vesc.SetServo(0.5304)))
        begin = time.monotonic()
        bench.run(0.2, agent=False)
        assert time.monotonic() - begin < 1.0, "a deaf agent blocks the world"
    finally:
        os.close(line)
    assert bench.body.asked[0] == pytest.approx(1.0)


def test_the_controller_turns_messages_into_motion_and_brakes_without_them() -> None:
    body = TestBody()
    controller = Controller(body, CarSettings())
    controller.step(vesc.encode(vesc.SetErpm(2307.0)) + vesc.encode(vesc.SetServo(0.5304 - 1.2135 * 0.2)), 1.0)
    assert body.asked == pytest.approx((0.5, 0.2), abs=1e-3)
    controller.step(vesc.encode(vesc.AskValues()), 1.4)
    assert body.asked[0] == pytest.approx(0.5)
    controller.step(vesc.encode(vesc.AskValues()), 1.51)
    assert body.asked == pytest.approx((0.0, 0.2), abs=1e-3), "asking is no command"
    controller.step(vesc.encode(vesc.SetErpm(2307.0)), 2.0)
    controller.step(vesc.encode(vesc.Brake(10.0)), 2.1)
    assert body.asked[0] == 0.0


def test_values_tell_the_speed_along_the_car() -> None:
    body = TestBody(0.0, 0.0, 2.0)
    controller = Controller(body, CarSettings())
    body.drive(-0.7, 0.0)
    body.step(5.0)
    (values,) = vesc.Decoder().feed(controller.step(vesc.encode(vesc.AskValues()), 0.0))
    assert isinstance(values, vesc.Values) and values.erpm == pytest.approx(-0.7 * 4614, abs=1)


def test_a_device_that_takes_nothing_blocks_nobody() -> None:
    with terminal() as (master, path):
        link = RealLinks().serial(path)
        written = [link.write(bytes(60)) for _ in range(2000)]
        assert written[0] == 60 and written[-1] == 0
        assert os.read(master, 60) == bytes(60)
        link.close()


def test_the_planner_answers_curves_from_its_own_process() -> None:
    place = scenes.world((Block(Point(3.4, 0.0, 0.0), Point(3.6, 5.5, 1.0)),))
    wish = msgspec.msgpack.encode(Wish(0.0, time_limit=0.5))
    beside = Beside("rrt-smoothed", place, 0.5, JUDGE)
    try:
        made(beside, time.sleep)
        path = beside.plan(Point(1.0, 4.0, 0.0), Point(6.0, 4.0, 0.0), Scene(), wish)
        told = beside.answer()
        assert len(path) > 2 and told is not None
        plan = msgspec.msgpack.decode(told.more, type=Plan)
        assert not collisions(place, segments(Curve(plan.start, plan.pieces)))
        assert beside.ask(Point(1.0, 4.0, 0.0), Point(1.5, 4.0, 0.0), Scene(), wish, 0.05)
        late = time.monotonic() + 5.0
        while (told := beside.answer()) is None:
            assert time.monotonic() < late
            time.sleep(0.002)
            beside.poll()
        assert told.path == (Point(1.0, 4.0, 0.0), Point(1.5, 4.0, 0.0)) and not beside.waiting
    finally:
        beside.close()
