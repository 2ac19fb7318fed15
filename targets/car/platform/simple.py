"""A car without a motor controller: the ports of a car over a body that drives as it is told, for simulators, of
fidelity `simple`. All else is the car's own: estimator, planner, controller, geofence, rest.
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


class Seen(Protocol):
    """What is known of a body: position (m) and velocity (m/s) of the middle of the rear axle, ENU, and yaw (rad)."""

    @property
    def position(self) -> tuple[float, float, float]: ...

    @property
    def velocity(self) -> tuple[float, float, float]: ...

    @property
    def yaw(self) -> float: ...


class Driver(Protocol):
    """The body. It goes on with what it was asked for last."""

    def state(self) -> Seen | None:
        """None: its position is not known now."""
        ...

    def drive(self, speed: float, steering: float) -> None: ...

    def brake(self, deceleration: float) -> None: ...


class BodyDrive:
    """Implements `drive.Drive`; knows where the car is, as a rover does."""

    heard = True
    fault = blocked = doubt = ""
    about = "a simple one"
    battery = None

    def __init__(self, body: Driver, braking: float) -> None:
        self._body, self._braking = body, braking
        self.asked = 0.0  # see Drive
        self._fixes: list[tuple[Pose, float]] = []

    def read(self, now: float) -> float | None:
        seen = self._body.state()
        if seen is None:
            return None
        x, y, _ = seen.position
        self._fixes.append((Pose(Point(x, y, 0.0), seen.yaw), now))
        return seen.velocity[0] * math.cos(seen.yaw) + seen.velocity[1] * math.sin(seen.yaw)

    def ask(self, now: float) -> None:
        """It tells without being asked."""

    def checks(self, now: float) -> list[Finding]:
        """See Drive: it has no settings."""
        return []

    def fixes(self) -> Sequence[tuple[Pose, float]]:
        told, self._fixes = self._fixes, []
        return told

    def go(self, command: Command, speed: float | None, now: float) -> None:
        self.asked = command.speed
        self._body.drive(command.speed, command.steering)

    def brake(self, now: float) -> None:
        self._body.brake(self._braking)

    def news(self) -> list[str]:
        return []

    def close(self, standing: bool) -> None:
        self._body.brake(self._braking)


class SimpleCar(Car):
    """Implements koordgen.runtime.vehicle.platform.Platform. `links` are asked for scans alone."""

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
        """See Platform: there is nothing to look at."""
        return [Finding("body", "ok", "a simple one")]

    def _open(self) -> tuple[Drive, Nowhere]:
        self._lidar.open()
        drive, nowhere = BodyDrive(self._body, self._settings.braking), Nowhere()
        self._drive, self._datagrams = drive, nowhere
        return drive, nowhere


def inside(settings: Settings, key: bytes | None, surroundings: SimulatorServices, body: Driver) -> SimpleCar:
    """In a simulator that owns time; see koordgen.runtime.vehicle.simulator_services."""
    return SimpleCar(settings, key, body, InsideLinks(surroundings), partial(bounded, surroundings), surroundings.now)
