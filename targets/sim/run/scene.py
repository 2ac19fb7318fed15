"""Simulation scene.

Bodies and devices of a scenario in one world, stepped together and checked for contacts."""

from __future__ import annotations

import importlib
import math
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.vehicle.datagrams import raw_clock
from targets.sim.autopilots.external import ExternalAutopilot
from targets.sim.autopilots.simple import SimpleCarDevice, SimpleQuadDevice
from targets.sim.base.bodies import BodyState, Device, DeviceContext, Vector
from targets.sim.base.degraded_actuators import DegradedActuators
from targets.sim.base.fault_state import FaultState
from targets.sim.base.fleets import own_settings
from targets.sim.base.ports import Loopback, Wiring
from targets.sim.base.scenario import BadScenario, Robot, Scenario
from targets.sim.physics.car import CarDynamics, SimulatedCar
from targets.sim.physics.first_order import SimpleCarBody, SimpleQuadrotor
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import Rigid, SimulatedWorld
from targets.sim.sensing.lidar import SETTING, SimulatedLidar
from targets.sim.sensing.station import SimulatedFeed, fed


class SceneBody(Protocol):
    """Methods of a body that the scene uses; devices use more of them."""

    rigid: Rigid

    def state(self) -> BodyState: ...


def _quadrotor(world: SimulatedWorld, robot: Robot, harness: Mapping[str, Any]) -> SceneBody:
    make = SimpleQuadrotor if robot.sim.fidelity == "simple" else SimulatedQuadrotor
    return make(world, robot.start.position, robot.start.yaw)


def _car(world: SimulatedWorld, robot: Robot, harness: Mapping[str, Any]) -> SceneBody:
    wheelbase = float(robot.settings.get("wheelbase", 0.33))
    max_steering = float(robot.settings.get("max_steering", 0.4))
    make = SimpleCarBody if robot.sim.fidelity == "simple" else SimulatedCar
    return make(world, robot.start.position, robot.start.yaw, wheelbase, max_steering, CarDynamics.of(harness))


# Names that a target's [simulation] table may use. Devices are imported only when a robot needs them.
BODIES: dict[str, Callable[[SimulatedWorld, Robot, Mapping[str, Any]], SceneBody]] = {
    "quadrotor": _quadrotor,
    "car": _car,
}
DEVICES: dict[str, str] = {
    "autopilot": "targets.sim.autopilots.autopilot:SimulatedAutopilot",
    "drive": "targets.sim.autopilots.drive:simulated",
}

# Devices of robots of fidelity `simple`, by their body.
SIMPLE: dict[str, Callable[[Any, DeviceContext], Device]] = {"quadrotor": SimpleQuadDevice, "car": SimpleCarDevice}

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Actor:
    """Simulated part of one robot: body, device and sensors."""

    robot: Robot
    body: SceneBody
    device: Device
    sensors: tuple[Device, ...]  # lidar and position feed, if the robot has settings for them
    fault_state: FaultState

    @property
    def devices(self) -> tuple[Device, ...]:
        return (self.device, *self.sensors)

    @property
    def overrides(self) -> dict[str, Any]:
        """Settings that override the robot's own, so that its agent finds the devices."""
        return {key: value for device in self.devices for key, value in device.overrides.items()}


@dataclass(frozen=True, slots=True)
class Closest:
    """Distance of two robots at a time: metres, seconds, pids."""

    distance: float = math.inf
    time: float = 0.0
    pids: tuple[int, int] = (0, 0)


@dataclass(slots=True)
class SeparationMonitor:
    """Separation and contacts of all robots, checked at every step.

    Separation is the distance in space between the robots' reference points, which are their positions. Times are those
    passed to `SimulationScene.step`."""

    min_separation: float
    closest: Closest = Closest()
    too_close: dict[tuple[int, int], Closest] = field(default_factory=dict)  # first time of each pair
    # pair of pids -> time of its first contact, s
    collisions: dict[tuple[int, int], float] = field(default_factory=dict)
    # pid, number of obstacle -> time of the first contact, s
    bumps: dict[tuple[int, int], float] = field(default_factory=dict)

    def look(self, time: float, positions: list[Vector]) -> None:
        if len(positions) < 2:
            return
        first, second = _pairs(len(positions))
        apart = np.array(positions)
        apart = apart[first] - apart[second]
        squares = np.einsum("ij,ij->i", apart, apart)
        nearest = int(squares.argmin())
        if (distance := math.sqrt(squares[nearest])) < self.closest.distance:
            self.closest = Closest(distance, time, (int(first[nearest]), int(second[nearest])))
        if distance < self.min_separation:
            for k in np.flatnonzero(squares < self.min_separation**2).tolist():
                pids = int(first[k]), int(second[k])
                self.too_close.setdefault(pids, Closest(math.sqrt(squares[k]), time, pids))


@lru_cache(maxsize=8)
def _pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of `count` robots, the lower number first."""
    return np.triu_indices(count, 1)


class SimulationScene:
    """Owner of world, bodies and devices; `close` frees them.

    The same scenario, seed and commands give the same motion. Call `check` for the scenario before."""

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        key: bytes,
        wiring: Wiring | None = None,
        clock: Clock = raw_clock,
    ) -> None:
        """Create world, bodies and devices.

        `wiring` connects devices to agents. `clock` is the agents' clock, which stamps measurements. Raises
        BadScenario, contacts.NoEngine, and contacts.NoWindow if a window is requested but not available."""
        world = scenario.world
        self.world = SimulatedWorld(world.wind, world.floor_friction, seed, scenario.gui, scenario.engine)
        self.actors: list[Actor] = []
        self.watch = SeparationMonitor(scenario.number("min_separation", 0.0))
        self.spent = 0.0  # host seconds spent on devices
        try:
            for obstacle in scenario.obstacles:
                self.world.obstacle(obstacle)
            for robot, own in zip(scenario.robots, own_settings(scenario), strict=True):
                self.actors.append(_actor(self.world, scenario, robot, own, seed, key, wiring or Loopback(), clock))
        except BaseException:
            self.close()
            raise
        self._devices = [device for actor in self.actors for device in actor.devices]

    def step(self, at: float) -> list[BodyState]:
        """Simulate one physics step. Return the states before it.

        `at` is the time stamp for the separation monitor."""
        now = self.world.time
        states = [actor.body.state() for actor in self.actors]
        self.watch.look(at, [state.position for state in states])
        began = time.perf_counter()
        for device in self._devices:
            device.step(now)
        self.spent += time.perf_counter() - began
        self.world.step()
        touched = self.world.touched()  # bodies were added in the order of pids
        for pair in sorted(touched.bodies):
            self.watch.collisions.setdefault(pair, at)
        for bump in sorted(touched.obstacles):
            self.watch.bumps.setdefault(bump, at)
        return states

    def standing(self, pid: int) -> bool:
        """Return whether a robot stands still on the floor."""
        body = self.actors[pid].body
        return self.world.grounded(body.rigid) and math.hypot(*body.state().velocity) < 0.1

    def close(self) -> None:
        for actor in self.actors:
            for device in actor.devices:
                device.close()
        self.world.close()


def device_class(name: str) -> Callable[[Any, DeviceContext], Device]:
    """Return the class of a device by its name.

    Raises BadScenario, or ImportError if a package is missing."""
    if name not in DEVICES:
        raise BadScenario(f"no simulated device {name!r}", f"there are: {', '.join(sorted(DEVICES))}")
    module, _, member = DEVICES[name].partition(":")
    found: Callable[[Any, DeviceContext], Device] = getattr(importlib.import_module(module), member)
    return found


def check(scenario: Scenario) -> None:
    """Check that each robot has a body and a device, and that no body is in contact at its start.

    Raises the exceptions of `device_class`, and BadScenario."""
    for robot in scenario.robots:
        if robot.body not in BODIES:
            raise BadScenario(f"no simulated body {robot.body!r}", f"there are: {', '.join(sorted(BODIES))}")
        device_class(robot.device)
        if robot.external and (robot.body, robot.sim.fidelity) != ("quadrotor", "full"):
            raise BadScenario(
                f"{robot.name}: an external autopilot flies quads of fidelity full only",
                "set `fidelity: full` or `autopilot: simulated` in its `sim:`",
            )
    _check_contacts(scenario)


def _check_contacts(scenario: Scenario) -> None:
    """Check contacts at the start, by one step in a world of its own."""
    world = SimulatedWorld(engine=scenario.engine)
    try:
        for obstacle in scenario.obstacles:
            world.obstacle(obstacle)
        for robot in scenario.robots:
            BODIES[robot.body](world, robot, scenario.harness)
        world.step()
        touched = world.touched()
    finally:
        world.close()
    hint = "give it another start in the fleet file"
    names = [robot.name for robot in scenario.robots]
    for first, second in sorted(touched.bodies):
        raise BadScenario(f"{names[second]} starts in contact with {names[first]}", hint)
    for pid, number in sorted(touched.obstacles):
        raise BadScenario(f"{names[pid]} starts in contact with obstacle {number}", hint)


def _actor(
    world: SimulatedWorld, scenario: Scenario, robot: Robot, own: tuple[str, int], seed: int, key: bytes,
    wiring: Wiring, clock: Clock,
) -> Actor:  # fmt: skip
    """Return the simulated part of a robot. `own`: name and application id that its agent expects in datagrams."""
    make = device_class(robot.device)
    origin = scenario.origin
    harness: Mapping[str, Any] = scenario.harness
    body = BODIES[robot.body](world, robot, harness)
    own_seed = random.Random(f"{seed}/{robot.pid}").getrandbits(32)
    place = (origin.latitude, origin.longitude, origin.altitude)
    fault_state = FaultState()
    name, application_id = own
    context = DeviceContext(name, robot.settings, harness, place, own_seed, key, wiring, fault_state, application_id)
    slowed = DegradedActuators(body, fault_state, lambda: world.time)
    if robot.sim.fidelity == "simple":
        make = SIMPLE[robot.body]
    device = ExternalAutopilot(slowed, context, robot.pid) if robot.external else make(slowed, context)
    sensors: list[Device] = [SimulatedLidar(world, body, context, robot.sim.lidar)] if SETTING in robot.settings else []
    setting = fed(robot.settings)
    if setting and robot.sim.fidelity != "simple":  # a simple robot needs no position feed
        sensors.append(SimulatedFeed(body, context, setting, clock))
    return Actor(robot, body, device, tuple(sensors), fault_state)
