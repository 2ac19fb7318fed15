"""Vehicle interface of an agent: sampled sensors, actuator variables, calls, and reasons to hold."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.program.program import Program
from koordgen.runtime.program.runner import NO_SENSOR_VALUE
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Platform, Resumes, Sensed, Unready
from koordgen.runtime.vehicle.safety import clamped


class VehicleInterface:
    """Interface between program and platform.

    actuators: values last written by the program; the platform gets them clamped to the geofence.
    budget: seconds that a call of a port may take; longer calls are counted and reported.
    avoid: the allread variable in which robots publish their paths; "": none.
    pid: pid of this robot.
    clock: returns the time in seconds, to measure calls.
    """

    def __init__(
        self,
        program: Program,
        platform: Platform,
        fence: Box,
        budget: float,
        warn: Callable[[str], None],
        avoid: str = "",
        pid: int = 0,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._platform = platform
        self._avoid, self._pid, self._clock = avoid, pid, clock
        self._slots: tuple[Any, ...] = ()  # slots of `avoid` at the last call of `others`
        self._published: dict[int, tuple[Point, ...]] = {}  # paths passed on
        self._fence = fence
        self._budget = budget
        self._warn = warn
        self._sensors = tuple(p.name for p in program.ports if p.direction == "sensor")
        self._clears = program.clears
        self._clearable = {sensor for cleared in self._clears.values() for sensor in cleared}
        self._actuators = tuple(p for p in program.ports if p.direction == "actuator")
        self._callables = {p.name: p.type for p in program.ports if p.direction == "callable"}
        self._cleared: dict[str, float] = {}  # sensor -> time when a command last cleared it
        self._fenced: tuple[str, ...] = ()
        self._reasons: set[str] = set()
        self._retired = False
        self._calls: list[tuple[str, tuple[Any, ...], Any]] = []
        self.actuators: dict[str, Any] = {}
        self.slow_calls = 0

    def begin(self, sensed: Sensed) -> None:
        """Initialise the actuators before `init`: some get the value of a sensor, so that the robot holds.

        Raises Unready if the target lacks a port."""
        for name in self._sensors:
            if name not in sensed.values:
                raise Unready(f"this target has no port {name}", "build the program for a target that offers it")
        for port in self._actuators:
            if port.held in sensed.values:
                self.actuators[port.name] = sensed.values[port.held]
            elif port.unset is not None:
                self.actuators[port.name] = port.unset()

    def sensors(self, sensed: Sensed) -> dict[str, Any]:
        """Return the program's sensor values.

        A sensor that commands clear is true before any command. After one it is false until the platform has measured a
        position later than the command."""
        values = {name: sensed.values[name] for name in self._sensors}
        for name in self._clearable:
            since = self._cleared.get(name)
            if since is None:
                values[name] = True
            elif sensed.time is None or sensed.time <= since:
                values[name] = False
        return values

    def others(self, shared: Mapping[str, Any]) -> None:
        """Pass the other robots' published paths from the shared store to the platform, if they have changed.

        Called before an event."""
        slots = shared.get(self._avoid, ())
        if slots is self._slots:
            return
        self._slots = slots
        paths = (
            (pid, (slot,) if isinstance(slot, Point) else slot) for pid, slot in enumerate(slots) if pid != self._pid
        )
        published = {pid: path for pid, path in paths if path}
        if published != self._published:
            self._published = published
            self._platform.others(published)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Call a callable port within an event.

        Raises what the platform raises; ValueError for an invalid answer."""
        began = self._clock()
        found = self._platform.call(port, args)
        took = self._clock() - began
        if took > self._budget:
            self.slow_calls += 1
            if self.slow_calls == 1:
                self._warn(f"{port} took {took * 1e3:.0f} ms, beyond its budget of {self._budget * 1e3:.0f} ms")
        answer = msgspec.convert(found, self._callables[port])
        if not transmissible(answer):
            raise ValueError(f"{port} returned a value that is not finite")
        self._calls.append((port, args, answer))
        return answer

    def calls(self) -> tuple[tuple[str, tuple[Any, ...], Any], ...]:
        """Return the calls since the last call of this method: port, arguments, answer."""
        if not self._calls:
            return ()
        found, self._calls = tuple(self._calls), []
        return found

    def command(self, written: Mapping[str, Any], now: float) -> None:
        """Pass an event's writes to the platform; Points are clamped to the geofence."""
        self._hand_on(written, now, self._platform.command)

    def _hand_on(self, written: Mapping[str, Any], now: float, to: Callable[[Mapping[str, Any], float], None]) -> None:
        if not written or self._retired:
            return
        self.actuators = {**self.actuators, **written}  # a new dictionary, because frames of earlier rounds refer to it
        for name in written:
            for sensor in self._clears.get(name, ()):
                self._cleared[sensor] = now
        inside, moved = clamped(self._fence, written)
        if moved and tuple(moved) != self._fenced:
            self._warn("; ".join(f"{n} = {written[n]} is outside the geofence, commanding {inside[n]}" for n in moved))
        self._fenced = tuple(moved)
        to(inside, now)

    def restore(self, actuators: Mapping[str, Any], now: float) -> None:
        """Restore the actuator values of this robot's state before a rejoin.

        Send the platform those that differ.
        """
        nothing = object()
        differing = {n: v for n, v in actuators.items() if self.actuators.get(n, nothing) != v}
        platform = self._platform
        self._hand_on(differing, now, platform.resume if isinstance(platform, Resumes) else platform.command)

    def hold(self, reason: str, on: bool, now: float) -> bool:
        """Add or remove a reason to hold; the robot moves when no reason is left. Return True on a change."""
        if on == (reason in self._reasons) or self._retired:
            return False
        (self._reasons.add if on else self._reasons.discard)(reason)
        self._platform.hold(bool(self._reasons), now)
        return True

    def retire(self) -> None:
        """Block all further commands of the program: the safe stop has begun."""
        self._retired = True


def unusable(sensors: Mapping[str, Any]) -> str | None:
    """Return the first sensor whose value no program may read, as text, or None."""
    for name, value in sensors.items():
        if not transmissible(value):
            why = "has no value" if value is None else "is not finite"
            return f"{NO_SENSOR_VALUE}: {name} {why}"
    return None
