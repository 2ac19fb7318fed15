"""A car without PyBullet: the kinematic bicycle with lagging servo and motor, and links that open no device."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from koordgen.runtime.config.settings import Box, Origin, Peer, Settings
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.datagrams import DatagramLink
from koordgen.runtime.vehicle.feed import Sample, encode
from koordgen.runtime.vehicle.platform import Unready
from koordgen.runtime.vehicle.scans import listen_for_scans
from targets.car.base.bicycle import BicycleState, advance
from targets.car.base.settings import decode
from targets.car.drive.links import RealLinks
from targets.car.drive.rover import ConsoleTransport
from targets.car.drive.watched import Unwatched
from targets.car.platform.platform import Car
from targets.planning.process import Inside
from targets.sim.autopilots.drive import Controller
from targets.sim.base.bodies import BodyState, DeviceContext
from targets.sim.sensing.station import BaseStation

KEY = bytes(range(32))
FENCE = Box(Point(-6.0, -5.0, -0.5), Point(6.0, 5.0, 4.0))
PHYSICS = 1 / 240


class TestBody:
    """targets.sim.base.bodies.Car: first-order motor and servo, exact arcs between."""

    __test__ = False

    def __init__(self, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, lag: float = 0.1) -> None:
        self.wheelbase = 0.33
        self.truth = BicycleState(x, y, yaw)
        self.asked = (0.0, 0.0)
        self._lag = lag

    def drive(self, speed: float, steering: float) -> None:
        self.asked = (speed, steering)

    def brake(self, deceleration: float) -> None:
        self.asked = (0.0, self.asked[1])

    def state(self) -> BodyState:
        s = self.truth
        velocity = (s.speed * math.cos(s.yaw), s.speed * math.sin(s.yaw), 0.0)
        rate = s.speed * math.tan(s.steering) / self.wheelbase
        return BodyState((s.x, s.y, 0.0), velocity, s.yaw, rate)

    def step(self, seconds: float) -> None:
        share = 1.0 - math.exp(-seconds / self._lag)
        s = self.truth
        speed = s.speed + share * (self.asked[0] - s.speed)
        steering = s.steering + share * (self.asked[1] - s.steering)
        self.truth = advance(replace(s, speed=speed, steering=steering), seconds, self.wheelbase)


class Wire:
    """Both links at once, in memory."""

    def __init__(self) -> None:
        self.to_drive = b""
        self.to_agent = b""
        self.datagrams: deque[bytes] = deque()
        self.closed = 0
        self.unplugged = False
        self.idle: Callable[[float], None] = lambda seconds: None
        self.lag: float | None = None  # what was remembered

    def serial(self, device: str) -> Wire:
        self._plugged()
        return self

    def _plugged(self) -> None:
        if self.unplugged:
            raise Unready("/dev/ttyACM0 is gone", "check its cable")

    def mavlink(self, url: str) -> ConsoleTransport:
        raise Unready("these links have no autopilot")

    def position(self, setting: str) -> Wire:
        return self

    def scans(self, setting: str) -> DatagramLink:
        return listen_for_scans(setting)

    def watchdog(self) -> Unwatched:
        return Unwatched()

    def fileno(self) -> int:
        return -1

    def wait(self, seconds: float) -> None:
        self.idle(seconds)

    def remember(self, lag: float) -> None:
        self.lag = lag

    def remembered(self) -> float | None:
        return self.lag

    def read(self) -> bytes:
        self._plugged()
        data, self.to_agent = self.to_agent, b""
        return data

    def write(self, data: bytes) -> int:
        self._plugged()
        self.to_drive += data
        return len(data)

    def receive(self) -> bytes | None:
        return self.datagrams.popleft() if self.datagrams else None

    def close(self) -> None:
        self.closed += 1


class OwnTime(RealLinks):
    """Real links of a car on a clock of the test's own: a watchdog lives by the real one, and would brake."""

    def watchdog(self) -> Unwatched:
        return Unwatched()


class World:
    """One car in its world, on a clock of its own."""

    def __init__(self, body: TestBody | None = None, noise: float = 0.005, **settings: Any) -> None:
        self.body = body if body is not None else TestBody()
        self.wire = Wire()
        self.car = Car(robot_settings(settings), KEY, self.wire, Inside)
        self.controller: Controller | None = Controller(self.body, decode(settings))
        self.station: BaseStation | None = BaseStation(self.body, context(settings, noise))
        self.now = 0.0
        self._ticks = 0
        self.wire.idle = self.physics

    def physics(self, seconds: float) -> None:
        """Let the world go on without the agent."""
        for _ in range(round(seconds / PHYSICS)):
            self._ticks += 1
            self.now = self._ticks * PHYSICS
            if self.controller is not None:
                received, self.wire.to_drive = self.wire.to_drive, b""
                self.wire.to_agent += self.controller.step(received, self.now)
            if self.station is not None and (datagram := self.station.sample(self.now, self.now)) is not None:
                self.wire.datagrams.append(datagram)
            self.body.step(PHYSICS)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Run world and agent; `each` is called after every poll, 20 times a second."""
        for _ in range(round(seconds / self.car.period)):
            self.physics(self.car.period)
            self.car.poll(self.now)
            if each is not None:
                each()

    def begin(self) -> World:
        """Start the agent and run until it is ready."""
        self.car.start(self.now)
        self.run(0.5)
        assert self.car.ready, self.car.progress
        return self

    def go(self, x: float, y: float) -> None:
        self.car.command({"Motion.target": Point(x, y, 0.7)}, self.now)

    def distance(self, x: float, y: float) -> float:
        return math.hypot(self.body.truth.x - x, self.body.truth.y - y)

    def value(self, port: str) -> Any:
        return self.car.sense(self.now).values[f"Motion.{port}"]


class NoLinks(Wire):
    """Links of which one cannot be opened."""

    def serial(self, device: str) -> Wire:
        raise Unready("cannot open it", "plug it in")


def context(settings: Mapping[str, Any], noise: float) -> DeviceContext:
    return DeviceContext("bert", settings, {"position_noise": noise}, (47.0, 8.0, 488.0), 7, KEY)


def robot_settings(body: Mapping[str, Any]) -> Settings:
    """The settings of the robot that the tests drive."""
    peer = Peer("bert", "127.0.0.1", 47101)
    return Settings(
        "app", "bert", 0, 0.1, (peer,), Origin(47.0, 8.0, 488.0), FENCE, body=dict(body), planner_budget=0.2
    )


def datagram(x: float, y: float, yaw: float, sequence: int) -> bytes:
    return encode(Sample("bert", 2, sequence, 0.0, Pose(Point(x, y, 0.0), yaw)), KEY)


def standing(world: World) -> bool:
    return abs(world.body.truth.speed) < 0.02
