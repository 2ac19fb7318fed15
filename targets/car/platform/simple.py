"""Platform of a car without a motor controller, on a simulated vehicle that follows commanded speed and steering.

It serves simulations of fidelity `simple`. Estimator, planner, controller, geofence and safe stop are those of the real
car.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.values.points import Point, Pose
from koordgen.runtime.vehicle.platform import Finding
from koordgen.runtime.vehicle.simulator_services import SimulatorServices
from targets.car.control.mpc import Command
from targets.car.drive.drive import Drive
from targets.car.drive.links import Links, Nowhere
from targets.car.planning.avoidance import MakePlanning
from targets.car.platform.inside import InsideLinks
from targets.car.platform.platform import Car
from targets.planning.process import Beside, bounded


class CarTruth(Protocol):
    """State of the simulated car: position (m) and velocity (m/s) of the rear axle's middle, yaw (rad); local ENU."""

    @property
    def position(self) -> tuple[float, float, float]: ...

    @property
    def velocity(self) -> tuple[float, float, float]: ...

    @property
    def yaw(self) -> float: ...


class Driver(Protocol):
    """Interface of a simulated car. The car drives on with the last command."""

    def state(self) -> CarTruth | None:
        """Return the car's state; None if its position is unknown now."""
        ...

    def drive(self, speed: float, steering: float) -> None: ...

    def brake(self, deceleration: float) -> None: ...


class BodyDrive:
    """Drive of a simulated car: implements `drive.Drive`. Like a rover, it reports the car's pose."""

    heard = True
    fault = blocked = doubt = ""
    about = "a simple one"
    battery = None

    def __init__(self, body: Driver, braking: float) -> None:
        self._body, self._braking = body, braking
        self.asked = 0.0  # last commanded speed, m/s
        self._fixes: list[tuple[Pose, float]] = []

    def read(self, now: float) -> float | None:
        seen = self._body.state()
        if seen is None:
            return None
        x, y, _ = seen.position
        self._fixes.append((Pose(Point(x, y, 0.0), seen.yaw), now))
        return seen.velocity[0] * math.cos(seen.yaw) + seen.velocity[1] * math.sin(seen.yaw)

    def ask(self, now: float) -> None:
        """Do nothing: the simulated car reports its state unasked."""

    def checks(self, now: float) -> list[Finding]:
        """Return no checks, because a simulated car has no parameters."""
        return []

    def fixes(self) -> Sequence[tuple[Pose, float]]:
        told, self._fixes = self._fixes, []
        return told

    def go(self, command: Command, speed: float | None, now: float) -> None:
        self.asked = command.speed
        self._body.drive(command.speed, command.steering)

    def brake(self, now: float) -> None:
        self._body.brake(self._braking)

    def log_lines(self) -> list[str]:
        return []

    def close(self, standing: bool) -> None:
        self._body.brake(self._braking)


class SimpleCar(Car):
    """Platform of a simulated car: implements koordgen.runtime.vehicle.platform.Platform.

    `links`: used only for lidar scans."""

    def __init__(
        self,
        settings: Settings,
        key: bytes | None,
        body: Driver,
        links: Links | None = None,
        planning: MakePlanning = Beside,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        super().__init__(settings, key, links, planning, clock)
        self._body = body

    def diagnose(self) -> list[Finding]:
        """Return one result that is always ok, because a simulated car has nothing to check."""
        return [Finding("body", "ok", "a simple one")]

    def _open(self) -> tuple[Drive, Nowhere]:
        self._lidar.open()
        drive, nowhere = BodyDrive(self._body, self._settings.braking), Nowhere()
        self._drive, self._datagrams = drive, nowhere
        return drive, nowhere


def inside(settings: Settings, key: bytes | None, surroundings: SimulatorServices, body: Driver) -> SimpleCar:
    """Return the platform for a simulator that controls time. `surroundings`: the services that it offers."""
    return SimpleCar(settings, key, body, InsideLinks(surroundings), partial(bounded, surroundings), surroundings.now)
