"""Robots of fidelity `simple`: their platforms on their bodies, from take-off to rest, and what crosses processes."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from koordgen.runtime.config.settings import Box, Origin, Peer, Settings
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Platform, Unready
from targets.car.platform.simple import SimpleCar as CarPlatform
from targets.planning.process import Inside
from targets.quad.platform.simple import SimpleQuad
from targets.sim.autopilots.simple import SimpleCarDevice, SimpleQuadDevice
from targets.sim.base.bodies import BodyCommand, DeviceContext
from targets.sim.base.fault_state import FaultState, PositioningFault
from targets.sim.physics.first_order import SimpleCarBody, SimpleQuadrotor
from targets.sim.physics.world import STEP, SimulatedWorld
from tests.sim.lockstep.lockstep import built, digest, ran, summary

ORIGIN = (47.0, 8.0, 400.0)
FLEET = {
    "delta": 0.1,
    "origin": {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0},
    "geofence": {"lo": [-6.0, -6.0, -0.5], "hi": [6.0, 6.0, 4.0]},
    "robots": [
        {"name": "ann", "target": "quad", "address": "127.0.0.1:47100", "start": {"position": [-2.0, 0.0, 0.0]}},
        {"name": "bea", "target": "car", "address": "127.0.0.1:47101", "start": {"position": [2.0, 0.0, 0.0]}},
        {"name": "cas", "target": "quad", "address": "127.0.0.1:47102", "start": {"position": [0.0, 3.0, 0.0]}},
    ],
    "sim": {"fidelity": "simple"},
}
FENCE = Box(Point(-4.0, -4.0, -0.5), Point(4.0, 4.0, 3.0))


class Rig:
    """A platform, its body and their clock."""

    def __init__(self, kind: str, start: tuple[float, float, float] = (0.0, 0.0, 0.0), **body: Any) -> None:
        self.world, self.fault_state = SimulatedWorld(), FaultState()
        context = DeviceContext("alice", body, {"position_noise": 0.002}, ORIGIN, 7, b"", fault_state=self.fault_state)
        peers = (Peer("alice", "127.0.0.1", 1),)
        settings = Settings(
            app="map", robot="alice", pid=0, delta=0.1, peers=peers, origin=Origin(*ORIGIN), geofence=FENCE, body=body
        )
        self.device: SimpleQuadDevice | SimpleCarDevice
        self.platform: Platform
        if kind == "quad":
            flyer = SimpleQuadrotor(self.world, start, 0.0)
            self.device = device = SimpleQuadDevice(flyer, context)
            self.platform = SimpleQuad(settings, None, device, planning=Inside)
            self.body: SimpleQuadrotor | SimpleCarBody = flyer
        else:
            self.body = car = SimpleCarBody(self.world, start, 0.0, 0.33, 0.4)
            self.device = driven = SimpleCarDevice(car, context)
            self.platform = CarPlatform(settings, None, driven, planning=Inside)
        self.platform.hold(False, 0.0)
        self.platform.start(0.0)

    def run(self, seconds: float, polled: bool = True) -> None:
        for _ in range(round(seconds / STEP)):
            self.device.step(self.world.time)
            self.world.step()
            if polled and self.world.steps % 12 == 0:
                self.platform.poll(self.world.time)

    def sensed(self, port: str) -> Any:
        return self.platform.sense(self.world.time).values[f"Motion.{port}"]

    def ready(self) -> bool:
        return self.platform.ready

    def stopped(self) -> bool:
        return self.platform.stopped

    def close(self) -> None:
        self.platform.close()
        self.device.close()
        self.world.close()


@pytest.fixture
def quad() -> Iterator[Rig]:
    made = Rig("quad", flight_height=1.2, max_speed=1.0)
    yield made
    made.close()


@pytest.fixture
def car() -> Iterator[Rig]:
    made = Rig("car")
    yield made
    made.close()


def up(rig: Rig) -> None:
    rig.run(5.0)
    assert rig.ready(), rig.platform.progress


def test_a_quad_takes_off_before_it_is_ready(quad: Rig) -> None:
    quad.run(0.5)
    assert not quad.ready() and quad.platform.progress == "climbing"
    quad.run(4.5)
    assert quad.ready()
    assert quad.body.state().position == pytest.approx((0.0, 0.0, 1.2), abs=0.06)


def test_a_quad_that_is_held_stays_on_the_ground() -> None:
    rig = Rig("quad")
    rig.platform.hold(True, 0.0)
    rig.run(2.0)
    assert rig.world.grounded(rig.body.rigid) and not rig.ready()
    rig.platform.stop(rig.world.time)
    rig.run(0.1)
    assert rig.stopped()
    rig.close()


def test_a_quad_goes_to_its_target_at_its_speed_and_says_when_it_stands_there(quad: Rig) -> None:
    up(quad)
    quad.platform.command({"Motion.target": Point(3.0, 1.0, 2.0)}, quad.world.time)
    fastest, reached = 0.0, None
    began = quad.world.time
    while reached is None and quad.world.time < began + 15.0:
        quad.run(0.05)
        fastest = max(fastest, math.hypot(*quad.body.state().velocity))
        reached = quad.world.time - began if quad.sensed("reached") else None
    assert reached is not None and 3.0 < reached < 8.0
    assert 0.9 < fastest < 1.03
    assert math.dist(quad.body.state().position, (3.0, 1.0, 2.0)) < 0.15
    assert quad.sensed("position").z == pytest.approx(2.0, abs=0.1)


def test_a_quad_stays_in_the_fence_and_at_its_flight_height(quad: Rig) -> None:
    up(quad)
    quad.platform.command({"Motion.target": Point(40.0, 0.0, 0.2)}, quad.world.time)
    quad.run(12.0)
    x, _, z = quad.body.state().position
    assert 3.7 < x < 4.0 and z == pytest.approx(1.2, abs=0.05)


def test_a_quad_pauses_and_goes_on(quad: Rig) -> None:
    up(quad)
    quad.platform.command({"Motion.path": (Point(1.0, 0.0, 1.5), Point(1.0, 3.0, 1.5))}, quad.world.time)
    quad.run(1.5)
    quad.platform.hold(True, quad.world.time)
    quad.run(2.0)
    paused = quad.body.state().position
    quad.run(1.0)
    assert math.dist(paused, quad.body.state().position) < 0.02 and not quad.sensed("reached")
    quad.platform.hold(False, quad.world.time)
    quad.run(8.0)
    assert quad.sensed("reached")
    assert math.dist(quad.body.state().position, (1.0, 3.0, 1.5)) < 0.1


def test_a_quad_lands_to_rest(quad: Rig) -> None:
    up(quad)
    quad.platform.stop(quad.world.time)
    quad.run(1.0)
    assert not quad.stopped()
    quad.run(4.0)
    assert quad.stopped() and quad.world.grounded(quad.body.rigid)


def test_a_landing_quad_whose_simulator_has_ended_is_not_waited_for(quad: Rig) -> None:
    up(quad)
    quad.fault_state.positioning = PositioningFault(dropout=1.0)  # not a word any more
    quad.run(30.0)
    quad.platform.stop(quad.world.time)
    quad.run(8.0)
    with pytest.raises(Unready, match="the simulator has sent no vehicle state"):
        quad.run(4.0)


def test_a_quad_whose_agent_falls_silent_stops_and_then_lands(quad: Rig) -> None:
    up(quad)
    quad.platform.command({"Motion.target": Point(3.0, 0.0, 1.5)}, quad.world.time)
    quad.run(1.5)
    quad.run(1.5, polled=False)
    assert math.hypot(*quad.body.state().velocity) < 0.02 and quad.body.state().position[2] > 1.0
    quad.run(9.0, polled=False)
    assert quad.world.grounded(quad.body.rigid)


def test_a_quad_that_does_not_know_where_it_is_waits(quad: Rig) -> None:
    up(quad)
    quad.platform.command({"Motion.target": Point(3.0, 0.0, 1.5)}, quad.world.time)
    quad.run(1.0)
    quad.fault_state.positioning = PositioningFault(dropout=1.0)
    quad.run(1.5)
    assert math.hypot(*quad.body.state().velocity) < 0.02
    told = quad.platform.sense(quad.world.time).time
    assert told is not None and quad.world.time - told > 1.0
    quad.fault_state.positioning = PositioningFault()
    quad.run(6.0)
    assert quad.sensed("reached") and quad.body.state().position[0] > 2.8


def test_a_car_goes_to_its_target_and_rests(car: Rig) -> None:
    car.run(0.5)
    assert car.ready(), car.platform.progress
    car.platform.command({"Motion.target": Point(2.0, 1.0, 0.0)}, car.world.time)
    car.run(8.0)
    assert car.sensed("reached"), car.platform.progress
    assert math.dist(car.body.state().position, (2.0, 1.0, 0.0)) < 0.12
    assert car.sensed("pose").position == car.sensed("position")
    car.platform.stop(car.world.time)
    car.run(1.0)
    assert car.stopped()


def test_a_car_whose_agent_falls_silent_brakes(car: Rig) -> None:
    car.run(0.5)
    car.platform.command({"Motion.target": Point(3.0, 0.0, 0.0)}, car.world.time)
    car.run(2.0)
    assert math.hypot(*car.body.state().velocity) > 0.5
    car.run(1.0, polled=False)
    assert math.hypot(*car.body.state().velocity) < 0.01


def test_what_comes_from_another_process_is_obeyed_only_when_it_is_sound(quad: Rig) -> None:
    obey, encode = quad.device._execute, msgspec.msgpack.encode
    for bad in (b"", b"\xff", encode(["close", []]), encode(["fly", [1.0]]), encode(["fly", [math.nan] * 4]),
                encode(["state", []]), encode(["motors", [1.0, 2.0]])):  # fmt: skip
        obey(bad)
    assert math.hypot(*quad.body.state().velocity) == 0.0
    obey(encode(BodyCommand("motors", (1.0,))))
    obey(encode(BodyCommand("fly", (0.0, 0.0, 1.0, 0.0))))
    quad.run(1.0, polled=False)
    assert quad.body.state().position[2] > 0.1


@pytest.mark.slow
def test_a_mixed_fleet_of_both_fidelities_runs_in_lockstep_and_repeats(tmp_path: Path) -> None:
    bundle = built(tmp_path, "lineform")
    file = bundle / "scenario.json"
    scenario = json.loads(file.read_text())
    for robot in scenario["robots"][:3]:
        robot["sim"] = {"fidelity": "simple"}
    file.write_text(json.dumps(scenario))
    for k in range(2):
        assert ran(bundle, tmp_path / str(k), 2.0, hashing=str(k)) == 0
    assert digest(tmp_path / "0") == digest(tmp_path / "1")
    assert summary(tmp_path / "0")["verdict"] == "held"


@pytest.mark.slow
def test_in_real_time_its_agent_is_a_process_of_its_own(tmp_path: Path) -> None:
    """A quad and a car; what is killed is begun anew by a fault, and finds its body again."""
    bundle = built(tmp_path, "lineform", json.dumps(FLEET))
    script = tmp_path / "faults.json"
    script.write_text(json.dumps({"events": [{"at": 1.0, "crash": "bea"}, {"at": 1.5, "restart": "bea"}]}))
    command = [sys.executable, str(bundle), "--duration", "6", "--out", str(tmp_path / "out"), "--quiet"]
    done = subprocess.run([*command, "--scenario", str(script)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert min(robot["rounds"] for robot in summary(tmp_path / "out")["robots"]) > 10
