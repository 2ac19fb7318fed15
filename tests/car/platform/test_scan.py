"""A car under the name MotionWithScan: the same ports, and the scans of a lidar."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.scans import FIRST_SAMPLE_TIMEOUT, Sweep, encode, packed
from tests.car.platform.world import KEY, World


class Lidar:
    """Sends turns of two rays to a port that is the car's to bind."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = probe.getsockname()
        self.setting = f"udp:127.0.0.1:{self.address[1]}"
        self._sequence = 0

    def send(self) -> None:
        self._sequence += 1
        ranges = packed([1.0, 6.0], 6.0)
        sweep = Sweep("bert", 1, self._sequence, Point(self._sequence, 0.0, 0.0), 0.0, 3.0, 6.0, ranges)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(encode(sweep, KEY), self.address)


@pytest.fixture
def lidar() -> Lidar:
    return Lidar()


@pytest.fixture
def world(lidar: Lidar) -> Iterator[World]:
    made = World(scans=lidar.setting)
    yield made
    made.car.close()


def test_it_obeys_both_names_and_tells_both_the_same() -> None:
    world = World().begin()
    for module, x in (("MotionWithScan", 1.0), ("Motion", 2.0)):
        world.car.command({f"{module}.target": Point(x, 0.0, 0.0)}, world.now)
        world.run(6.0)
        assert world.distance(x, 0.0) < 0.12
    world.car.command({"MotionWithScan.path": (Point(1.0, 0.0, 0.0),)}, world.now)
    world.run(0.1)
    values = world.car.sense(world.now).values
    assert values["MotionWithScan.reached"] is False
    for port in ("position", "pose", "velocity", "reached"):
        assert values[f"MotionWithScan.{port}"] == values[f"Motion.{port}"]
    assert values["MotionWithScan.pscan"] == (), "a car without a lidar has no scans"
    assert len(world.car.call("MotionWithScan.planner", (Point(3.0, 0.0, 0.0), ()))) == 2


def test_it_is_ready_when_the_first_scan_has_come(world: World, lidar: Lidar) -> None:
    world.car.start(world.now)
    begun: list[bool] = []
    world.run(1.0, lambda: begun.append(world.car.ready))
    assert not any(begun)
    assert world.car.progress == f"waiting for scans on {lidar.setting}"
    lidar.send()
    lidar.send()
    world.run(0.05)
    assert world.car.ready
    ((_, first), (place, second)) = world.car.sense(world.now).values["MotionWithScan.pscan"]
    assert place == Point(2.0, 0.0, 0.0) and first == second and second.ranges == pytest.approx((1.0, 6.0), abs=1e-4)
    world.run(1.0)
    assert world.car.sense(world.now).values["MotionWithScan.pscan"] == ()
    assert world.car.ready, "a lidar that pauses is the program's to notice"


def test_a_lidar_that_never_speaks_ends_the_wait_and_lets_it_come_to_rest(world: World) -> None:
    world.car.start(world.now)
    with pytest.raises(Unready, match="waiting for scans"):
        world.run(FIRST_SAMPLE_TIMEOUT + 1.0)
    world.car.stop(world.now)
    world.run(1.0)
    assert world.car.stopped


def test_diagnosis_tells_of_scans(world: World, lidar: Lidar) -> None:
    found = world.car.diagnose()[-1]
    assert (found.name, found.state) == ("scans", "fail") and "waiting for scans" in found.found
    physics = world.wire.idle

    def idle(seconds: float) -> None:
        physics(seconds)
        lidar.send()

    world.wire.idle = idle
    assert world.car.diagnose()[-1] == Finding("scans", "ok", f"arrive on {lidar.setting}")
