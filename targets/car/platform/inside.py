"""Car platform for a simulator that controls time, with a simulated watchdog that brakes if the agent is silent."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.vehicle.datagrams import DatagramLink
from koordgen.runtime.vehicle.simulator_services import Exchange, SimulatorServices, Stream
from targets.car.base.settings import FROM_DRIVE
from targets.car.drive.links import ByteLink, Nowhere
from targets.car.drive.rover import ConsoleTransport
from targets.car.drive.watchdog import LAST, LATE, PERIOD
from targets.car.drive.watched import OFTEN
from targets.car.platform.platform import Car
from targets.mavlink.inside import Direct
from targets.planning.process import bounded


def made(settings: Settings, key: bytes | None, inside: SimulatorServices) -> Car:
    """Return a car whose links, clock and planners belong to the simulator.

    `inside`: the services that the simulator offers."""
    return Car(settings, key, InsideLinks(inside), partial(bounded, inside), inside.now)


class InsideLinks:
    """Links in the simulator: implements `links.Links`."""

    def __init__(self, inside: SimulatorServices) -> None:
        self._inside = inside
        self._drive: Callable[[bytes], object] = lambda data: None  # writes the watchdog's brake command to the drive

    def serial(self, device: str) -> ByteLink:
        stream: Stream = self._inside.stream(device)
        self._drive = stream.write
        return stream

    def mavlink(self, url: str) -> ConsoleTransport:
        exchange: Exchange = self._inside.exchange(url)
        self._drive = exchange.send
        return Direct(exchange)

    def position(self, setting: str) -> DatagramLink:
        return Nowhere() if setting == FROM_DRIVE else self._inside.exchange(setting)

    def scans(self, setting: str) -> DatagramLink:
        return self._inside.exchange(setting)

    def watchdog(self) -> Watching:
        watching = Watching(self._inside.now, lambda data: self._drive(data))
        self._inside.beside(watching.step)
        return watching

    def wait(self, seconds: float) -> None:
        """Do nothing: only `diagnose` waits, and it does not run in simulators."""

    def remember(self, lag: float) -> None:
        """Do nothing: only `diagnose` reads the stored lag, and it does not run in simulators."""

    def remembered(self) -> float | None:
        return None


class Watching:
    """Simulated watchdog: implements `watched.Watch`.

    Like watchdog.py, it brakes if no command arrives for LATE seconds. Unlike watchdog.py, it brakes for LAST seconds
    even if the agent lives, answers at once, and runs until the simulation ends."""

    trouble = ""

    def __init__(self, clock: Callable[[], float], write: Callable[[bytes], object]) -> None:
        self._clock, self._write = clock, write
        self._brake: bytes | None = None
        self._due = self._end = math.inf
        self._commanded = -math.inf
        self._braking = False
        self._logged_at = -math.inf
        self._log_lines: list[str] = []

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        self._brake = brake

    def release(self) -> None:
        self._brake, self._due = None, math.inf

    def beat(self) -> None:
        self._commanded = self._clock()
        self._due, self._braking = self._commanded + LATE, False

    def poll(self) -> None:
        pass

    def step(self, now: float) -> None:
        """Run the watchdog at simulation time `now`: brake if commands are late."""
        if now < self._due or self._brake is None or now > self._commanded + LATE + LAST:
            return
        self._due = now + PERIOD
        if not self._braking:
            self._braking = True
            self._log(now)
        self._write(self._brake)

    def _log(self, now: float) -> None:
        if now - self._logged_at >= OFTEN:
            late = now - self._commanded
            self._log_lines.append(
                f"the watchdog braked because no command had come for {late:.2f} s: the agent was stuck"
            )
            self._logged_at = now

    def log_lines(self) -> list[str]:
        told, self._log_lines = self._log_lines, []
        return told

    def close(self, standing: bool) -> None:
        if standing:
            self.release()
