"""A quad under the name MotionWithScan: the same ports, and the scans of a lidar."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from itertools import count

import pytest

from benchmarks.fixtures.quad_rig import Rig
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Unready
from koordgen.runtime.vehicle.scans import FIRST_SAMPLE_TIMEOUT, Sweep, encode, packed


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def rig(port: int) -> Iterator[Rig]:
    made = Rig(scans=f"udp:127.0.0.1:{port}")
    yield made
    made.quad.close()


def send(port: int, sequence: int = 1) -> None:
    sweep = Sweep("alice", 1, sequence, Point(1.0, -2.0, 1.5), 0.0, 3.0, 6.0, packed([1.0, 6.0], 6.0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(encode(sweep, None), ("127.0.0.1", port))


def test_it_obeys_both_names_and_tells_both_the_same() -> None:
    rig = Rig()
    rig.fly()
    for actuators in (
        {"MotionWithScan.target": Point(2.0, -2.0, 1.5)},
        {"MotionWithScan.path": (Point(2.0, -1.0, 1.5), Point(3.0, -1.0, 1.5))},
        {"Motion.target": Point(2.0, -2.0, 1.5)},
    ):
        rig.quad.command(actuators, rig.now)
        values = rig.quad.sense(rig.now).values
        assert values["MotionWithScan.reached"] is values["Motion.reached"] is False
        assert rig.run(12.0, rig.reached), actuators
    values = rig.quad.sense(rig.now).values
    for name in ("position", "velocity", "reached"):
        assert values[f"MotionWithScan.{name}"] == values[f"Motion.{name}"]
    assert values["MotionWithScan.pscan"] == (), "a quad without a lidar has no scans"
    assert len(rig.quad.call("MotionWithScan.planner", (Point(3.0, 0.0, 1.5), ()))) == 2


def test_it_is_ready_when_the_first_scan_has_come(rig: Rig, port: int) -> None:
    rig.quad.start(rig.now)
    assert not rig.run(20.0, lambda: rig.quad.ready)
    assert f"waiting for scans on udp:127.0.0.1:{port}" in rig.quad.progress
    send(port)
    assert rig.run(0.2, lambda: rig.quad.ready)
    ((place, scan),) = rig.quad.sense(rig.now).values["MotionWithScan.pscan"]
    assert place == Point(1.0, -2.0, 1.5) and scan.ranges == pytest.approx((1.0, 6.0), abs=1e-4)


def test_a_lidar_that_never_speaks_ends_the_wait_and_lets_it_land(rig: Rig) -> None:
    rig.quad.start(rig.now)
    with pytest.raises(Unready, match="waiting for scans"):
        rig.run(FIRST_SAMPLE_TIMEOUT + 1.0)
    rig.quad.stop(rig.now)
    assert rig.run(30.0, lambda: rig.quad.stopped), rig.progress
    assert rig.body.position[2] < 0.1


def test_diagnosis_tells_of_scans(rig: Rig, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    found = rig.quad.diagnose()[-1]
    assert (found.name, found.state) == ("scans", "fail") and "waiting for scans" in found.found
    pass_time, sequence = rig.pass_time, count(1)

    def lidar(seconds: float) -> None:
        pass_time(seconds)
        send(port, next(sequence))

    monkeypatch.setattr(rig, "pass_time", lidar)
    assert rig.agent(scans=f"udp:127.0.0.1:{port}").diagnose()[-1] == Finding(
        "scans", "ok", f"arrive on udp:127.0.0.1:{port}"
    )
