"""The car's platform on a simulated clock, with links in memory: ready, holding, coming to rest."""

from __future__ import annotations

import re

import pytest

from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Platform
from targets.car.drive import vesc
from tests.car.platform.world import World, standing


def stopped(world: World) -> bool:
    return world.car.stopped


def test_it_becomes_ready_and_stands_before_any_command() -> None:
    world = World()
    platform: Platform = world.car
    assert platform.sense(0.0).time is None
    assert not platform.ready
    world.begin().run(1.0)
    assert world.value("reached") is True
    assert "no target" in platform.progress
    assert standing(world) and world.distance(0, 0) < 0.01
    sensed = platform.sense(world.now)
    assert sensed.time == pytest.approx(world.now, abs=0.06)
    ports = ("position", "pose", "velocity", "reached")
    both = {f"{module}.{port}" for module in ("Motion", "MotionWithScan") for port in ports}
    assert set(sensed.values) == both | {"MotionWithScan.pscan"}


def test_hold_stops_it_and_resume_takes_it_to_its_target() -> None:
    world = World().begin()
    world.go(4.0, 1.0)
    world.run(2.0)
    assert world.body.truth.speed > 0.7
    for _ in range(2):  # idempotent
        world.car.hold(True, world.now)
    world.run(1.0)
    held = world.body.truth
    assert standing(world) and world.car.progress == "holding"
    world.run(2.0)
    assert world.distance(held.x, held.y) < 0.005
    world.car.command({"Motion.target": Point(4.0, -1.0)}, world.now)
    world.run(1.0)
    assert world.distance(held.x, held.y) < 0.005, "a command does not end a hold"
    world.car.hold(False, world.now)
    world.run(8.0)
    assert world.distance(4.0, -1.0) < 0.06 and world.value("reached") is True


def test_rest_brakes_and_keeps_braking_whatever_comes() -> None:
    world = World().begin()
    world.go(5.0, 0.0)
    world.run(2.0)
    world.car.stop(world.now)
    assert not stopped(world)
    world.run(0.1)
    assert not stopped(world) and world.car.progress == "braking to rest"
    world.car.hold(False, world.now)
    world.go(5.0, 0.0)
    world.run(2.0)
    world.car.stop(world.now)
    assert stopped(world) and standing(world)
    at = world.body.truth
    sent: list[vesc.Message] = []
    for _ in range(20):
        world.physics(0.05)
        world.car.poll(world.now)
        sent += vesc.Decoder().feed(world.wire.to_drive)
    assert sum(isinstance(m, vesc.Brake) for m in sent) == 20
    assert not any(isinstance(m, vesc.SetErpm) for m in sent)
    assert world.distance(at.x, at.y) < 0.002


def test_check_looks_and_moves_nothing() -> None:
    world = World()
    found = {f.name: f for f in world.car.diagnose()}
    assert list(found) == ["drive", "watchdog", "position", "place", "limits", "controller", "planner"] and {
        f.state for f in found.values()
    } == {"ok"}
    assert "VESC firmware 6.5" in found["drive"].found and "supply 11.1 V" in found["drive"].found
    assert re.match("(49|50|51) Hz on ", found["position"].found)
    assert world.body.asked == (0.0, 0.0)
    assert world.wire.closed == 2  # one for each link
    world.car.close()
    world.begin()


def test_polling_more_often_does_not_command_more_often() -> None:
    world = World().begin()
    commands = 0
    for i in range(1000):
        world.wire.to_drive = b""
        world.car.poll(world.now + i / 1000)
        commands += sum(isinstance(m, vesc.Brake) for m in vesc.Decoder().feed(world.wire.to_drive))
    assert commands in (20, 21)
