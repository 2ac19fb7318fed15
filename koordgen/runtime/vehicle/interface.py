"""Vehicle interface of an agent: sampled sensors, actuator variables, calls, and reasons to hold."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from koordgen.runtime.config.settings import Box
from koordgen.runtime.program.program import Program
from koordgen.runtime.program.runner import NO_SENSOR_VALUE
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Platform, Resumes, Sensed, Unready
from koordgen.runtime.vehicle.safety import clamped


class VehicleInterface:
    """Interface between a program and the platform of its robot.

    actuators: values that the program wrote last. The platform gets them clamped to the geofence.
    budget: seconds that a call of a callable port may take. Longer calls are counted, and the first is reported.
    avoid: name of the allread variable in which robots publish their paths; "" if the program has no such variable.
    pid: pid of this robot.
    clock: clock in seconds that measures how long calls take.
    members: robots that have the slots of `avoid`, in the order of the slots; empty: slot p belongs to robot p.
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
        members: Sequence[int] = (),
    ) -> None:
        self._platform = platform
        self._members = members
        self._avoid, self._pid, self._clock = avoid, pid, clock
        self._slots: tuple[Any, ...] = ()  # slots of `avoid` at the last call of `others`
        self._published: dict[int, tuple[Point, ...]] = {}  # pid -> path last passed to the platform
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
        """Initialise the actuators before `init`. Some start with the value of a sensor, so that the robot holds.

        Raises Unready if the target lacks a sensor port of the program."""
        for name in self._sensors:
            if name not in sensed.values:
                raise Unready(f"this target has no port {name}", "build the program for a target that offers this port")
        for port in self._actuators:
            if port.held in sensed.values:
                self.actuators[port.name] = sensed.values[port.held]
            elif port.unset is not None:
                self.actuators[port.name] = port.unset()

    def sensors(self, sensed: Sensed) -> dict[str, Any]:
        """Return the values of the program's sensors.

        A command can clear a sensor, such as "target reached". This sensor is true before the first command. After a
        command it is false until the platform has measured a position later than the command."""
        values = {name: sensed.values[name] for name in self._sensors}
        for name in self._clearable:
            since = self._cleared.get(name)
            if since is None:
                values[name] = True
            elif sensed.time is None or sensed.time <= since:
                values[name] = False
        return values

    def others(self, shared: Mapping[str, Any]) -> None:
        """Pass the paths that other robots published in the shared variables to the platform, if a path has changed.

        The agent calls this before each event."""
        slots = shared.get(self._avoid, ())
        if slots is self._slots:
            return
        self._slots = slots
        owned = zip(self._members or range(len(slots)), slots, strict=False)
        paths = ((pid, (slot,) if isinstance(slot, Point) else slot) for pid, slot in owned if pid != self._pid)
        published = {pid: path for pid, path in paths if path}
        if published != self._published:
            self._published = published
            self._platform.others(published)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        """Call a callable port within an event, and return the platform's answer.

        Raises the exceptions of the platform, and ValueError if the answer is invalid."""
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
        """Return port, arguments and answer of each call of a callable port since this method was called last."""
        if not self._calls:
            return ()
        found, self._calls = tuple(self._calls), []
        return found

    def command(self, written: Mapping[str, Any], now: float) -> None:
        """Pass the actuator values that an event wrote to the platform. Points are clamped to the geofence."""
        self._hand_on(written, now, self._platform.command)

    def _hand_on(self, written: Mapping[str, Any], now: float, to: Callable[[Mapping[str, Any], float], None]) -> None:
        if not written or self._retired:
            return
        self.actuators = {**self.actuators, **written}  # new dict: frames of earlier rounds refer to the old one
        for name in written:
            for sensor in self._clears.get(name, ()):
                self._cleared[sensor] = now
        inside, moved = clamped(self._fence, written)
        if moved and tuple(moved) != self._fenced:
            self._warn("; ".join(f"{n} = {written[n]} is outside the geofence, commanding {inside[n]}" for n in moved))
        self._fenced = tuple(moved)
        to(inside, now)

    def restore(self, actuators: Mapping[str, Any], now: float) -> None:
        """Restore the actuator values that this robot had before its rejoin.

        The platform receives only the values that differ from the present ones."""
        nothing = object()
        differing = {n: v for n, v in actuators.items() if self.actuators.get(n, nothing) != v}
        platform = self._platform
        self._hand_on(differing, now, platform.resume if isinstance(platform, Resumes) else platform.command)

    def hold(self, reason: str, on: bool, now: float) -> bool:
        """Add a reason to hold if `on`, otherwise remove it. The robot moves when no reason is left.

        Return True if the reasons changed."""
        if on == (reason in self._reasons) or self._retired:
            return False
        (self._reasons.add if on else self._reasons.discard)(reason)
        self._platform.hold(bool(self._reasons), now)
        return True

    def retire(self) -> None:
        """Block all further commands of the program, because the safe stop has begun."""
        self._retired = True


def unusable(sensors: Mapping[str, Any]) -> str | None:
    """Return a message about the first sensor without a finite value; None if programs may read all sensors."""
    for name, value in sensors.items():
        if not transmissible(value):
            why = "has no value" if value is None else "is not finite"
            return f"{NO_SENSOR_VALUE}: {name} {why}"
    return None
