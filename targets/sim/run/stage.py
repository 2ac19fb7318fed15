"""The stage: a scenario's bodies and devices in one world, stepped together and watched for what must not happen."""

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
from targets.sim.autopilots.simple import DirectCar, DirectQuad
from targets.sim.base.bodies import BodyState, Device, DeviceContext, Vector
from targets.sim.base.ports import Loopback, Wiring
from targets.sim.base.scenario import BadScenario, Robot, Scenario
from targets.sim.base.slowed import Slowed
from targets.sim.base.upset import Upset
from targets.sim.physics.car import Running, SimulatedCar
from targets.sim.physics.first_order import SimpleCar, SimpleQuadrotor
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import Rigid, World
from targets.sim.sensing.lidar import SETTING, SimulatedLidar
from targets.sim.sensing.station import SimulatedFeed, fed


class Body(Protocol):
    """What the stage needs of every body; devices know more."""

    rigid: Rigid

    def state(self) -> BodyState: ...


def _quadrotor(world: World, robot: Robot, harness: Mapping[str, Any]) -> Body:
    make = SimpleQuadrotor if robot.sim.fidelity == "simple" else SimulatedQuadrotor
    return make(world, robot.start.position, robot.start.yaw)


def _car(world: World, robot: Robot, harness: Mapping[str, Any]) -> Body:
    wheelbase = float(robot.settings.get("wheelbase", 0.33))
    max_steering = float(robot.settings.get("max_steering", 0.4))
    make = SimpleCar if robot.sim.fidelity == "simple" else SimulatedCar
    return make(world, robot.start.position, robot.start.yaw, wheelbase, max_steering, Running.of(harness))


# What a target's [simulation] table may name. Devices are imported when a robot needs them.
BODIES: dict[str, Callable[[World, Robot, Mapping[str, Any]], Body]] = {"quadrotor": _quadrotor, "car": _car}
DEVICES: dict[str, str] = {
    "autopilot": "targets.sim.autopilots.autopilot:SimulatedAutopilot",
    "drive": "targets.sim.autopilots.drive:simulated",
}

# ... and those of robots of fidelity `simple`, by their body.
SIMPLE: dict[str, Callable[[Any, DeviceContext], Device]] = {"quadrotor": DirectQuad, "car": DirectCar}

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Actor:
    """One robot's simulated half."""

    robot: Robot
    body: Body
    device: Device
    sensors: tuple[Device, ...]  # lidar and position feed, for robots that have a setting for them
    upset: Upset

    @property
    def devices(self) -> tuple[Device, ...]:
        return (self.device, *self.sensors)

    @property
    def overrides(self) -> dict[str, Any]:
        """What is laid over the robot's settings, so that its agent finds the devices."""
        return {key: value for device in self.devices for key, value in device.overrides.items()}


@dataclass(frozen=True, slots=True)
class Closest:
    """The separation of two robots at a time: metres, seconds, pids."""

    distance: float = math.inf
    time: float = 0.0
    pids: tuple[int, int] = (0, 0)


@dataclass(slots=True)
class Watch:
    """What was seen of all pairs of robots, at every step. Separation is the distance in space of the robots' reference
    points: those that they call their positions. Times are those that `Stage.step` was told."""

    min_separation: float
    closest: Closest = Closest()
    too_close: dict[tuple[int, int], Closest] = field(default_factory=dict)  # each pair's first time
    collisions: dict[tuple[int, int], float] = field(default_factory=dict)  # pair of pids -> the first time, s
    bumps: dict[tuple[int, int], float] = field(default_factory=dict)  # pid, number of obstacle -> the first time, s

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
    """All pairs of so many robots, the lower number first."""
    return np.triu_indices(count, 1)


class Stage:
    """Owns world, bodies and devices; `close` gives all of them back. The same scenario, seed and commands give the
    same motion. `check` the scenario before."""

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        key: bytes,
        wiring: Wiring | None = None,
        clock: Clock = raw_clock,
    ) -> None:
        """`wiring` is how agents are reached, `clock` the one by which they stamp what arrives. Raises BadScenario,
        contacts.NoEngine, and contacts.NoWindow when a window is asked for where there is none."""
        world = scenario.world
        self.world = World(world.wind, world.floor_friction, seed, scenario.gui, scenario.engine)
        self.actors: list[Actor] = []
        self.watch = Watch(scenario.number("min_separation", 0.0))
        self.spent = 0.0  # host seconds on devices
        try:
            for obstacle in scenario.obstacles:
                self.world.obstacle(obstacle)
            for robot in scenario.robots:
                self.actors.append(_actor(self.world, scenario, robot, seed, key, wiring or Loopback(), clock))
        except BaseException:
            self.close()
            raise
        self._devices = [device for actor in self.actors for device in actor.devices]

    def step(self, at: float) -> list[BodyState]:
        """One physics step; the states before it. `at` stamps what the watch sees."""
        now = self.world.time
        states = [actor.body.state() for actor in self.actors]
        self.watch.look(at, [state.position for state in states])
        began = time.perf_counter()
        for device in self._devices:
            device.step(now)
        self.spent += time.perf_counter() - began
        self.world.step()
        touched = self.world.touched()  # bodies came in the order of their pids
        for pair in sorted(touched.bodies):
            self.watch.collisions.setdefault(pair, at)
        for bump in sorted(touched.obstacles):
            self.watch.bumps.setdefault(bump, at)
        return states

    def standing(self, pid: int) -> bool:
        """Whether a robot is on the floor and does not move."""
        body = self.actors[pid].body
        return self.world.grounded(body.rigid) and math.hypot(*body.state().velocity) < 0.1

    def close(self) -> None:
        for actor in self.actors:
            for device in actor.devices:
                device.close()
        self.world.close()


def device_class(name: str) -> Callable[[Any, DeviceContext], Device]:
    """The class behind a device's name. Raises BadScenario, or ImportError when a package is missing."""
    if name not in DEVICES:
        raise BadScenario(f"no simulated device {name!r}", f"there are: {', '.join(sorted(DEVICES))}")
    module, _, member = DEVICES[name].partition(":")
    found: Callable[[Any, DeviceContext], Device] = getattr(importlib.import_module(module), member)
    return found


def check(scenario: Scenario) -> None:
    """Whether there is a body and a device for every robot, and no body is in contact where it starts. Raises as
    `device_class`."""
    for robot in scenario.robots:
        if robot.body not in BODIES:
            raise BadScenario(f"no simulated body {robot.body!r}", f"there are: {', '.join(sorted(BODIES))}")
        device_class(robot.device)
        if robot.external and (robot.body, robot.sim.fidelity) != ("quadrotor", "full"):
            raise BadScenario(
                f"{robot.name}: an external autopilot flies quads of fidelity full only",
                "say `fidelity: full`, or `autopilot: simulated`, in its `sim:`",
            )
    _check_contacts(scenario)


def _check_contacts(scenario: Scenario) -> None:
    """In a world of its own, for one step: what touches then did so at the start."""
    world = World(engine=scenario.engine)
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
    world: World, scenario: Scenario, robot: Robot, seed: int, key: bytes, wiring: Wiring, clock: Clock
) -> Actor:
    make = device_class(robot.device)
    origin = scenario.origin
    harness: Mapping[str, Any] = scenario.harness
    body = BODIES[robot.body](world, robot, harness)
    own_seed = random.Random(f"{seed}/{robot.pid}").getrandbits(32)
    place = (origin.latitude, origin.longitude, origin.altitude)
    upset = Upset()
    context = DeviceContext(robot.name, robot.settings, harness, place, own_seed, key, wiring, upset,
                            scenario.application_id)  # fmt: skip
    slowed = Slowed(body, upset, lambda: world.time)
    if robot.sim.fidelity == "simple":
        make = SIMPLE[robot.body]
    device = ExternalAutopilot(slowed, context, robot.pid) if robot.external else make(slowed, context)
    sensors: list[Device] = [SimulatedLidar(world, body, context, robot.sim.lidar)] if SETTING in robot.settings else []
    setting = fed(robot.settings)
    if setting and robot.sim.fidelity != "simple":  # such a robot knows where it is
        sensors.append(SimulatedFeed(body, context, setting, clock))
    return Actor(robot, body, device, tuple(sensors), upset)
