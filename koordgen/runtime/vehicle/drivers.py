"""Drivers: Python classes of the user that serve modules which the target does not offer.

A driver has the methods `sense() -> dict` and `command(dict)`; the keys of both dictionaries are names of ports. It may
also have `call(port, args)` and `close()`. No method may block. If `sense` raises an exception or returns a value of a
wrong type, the robot skips its rounds until `sense` succeeds again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import msgspec

from koordgen.runtime.program.extern import ESCAPES
from koordgen.runtime.program.program import Program
from koordgen.runtime.values.points import Point, transmissible
from koordgen.runtime.vehicle.platform import Finding, Platform, Resumes, Sensed, Unready, Vitals, vitals

Drivers = Mapping[str, Callable[[], Any]]


def with_drivers(platform: Platform, program: Program, drivers: Drivers) -> Platform:
    """Return a platform that answers for each module in `drivers` by that module's driver.

    Raises Unready if a driver cannot be created."""
    return Driven(platform, program, drivers) if drivers else platform


def modules_of_drivers(platform: Platform) -> frozenset[str]:
    """Return the modules of the program that drivers serve."""
    return frozenset(platform.modules) if isinstance(platform, Driven) else frozenset()


class Driven:
    """Platform whose drivers serve some modules. Another platform serves all other modules."""

    def __init__(self, platform: Platform, program: Program, drivers: Drivers) -> None:
        self._platform = platform
        self._drivers: dict[str, Any] = {}
        self.period = platform.period
        try:
            for module, make in drivers.items():
                self._drivers[module] = make()
        except ESCAPES as error:
            self.close()
            raise Unready(f"the driver of {module} cannot be created: {_error_text(error)}") from None
        self._types = {
            p.name: p.type
            for p in program.ports
            if p.direction == "sensor" and p.name.partition(".")[0] in self._drivers
        }
        self._values: dict[str, Any] = dict.fromkeys(self._types)  # None: no value
        self._trouble = ""

    @property
    def modules(self) -> list[str]:
        """Modules of the program that drivers serve."""
        return list(self._drivers)

    def diagnose(self) -> list[Finding]:
        self._sample()
        names = ", ".join(f"{module} by {type(driver).__name__}" for module, driver in self._drivers.items())
        trouble = self._trouble
        hint = "check the driver's device and the driver's class"
        own = Finding("drivers", "fail", trouble, why=hint) if trouble else Finding("drivers", "ok", names)
        return [*self._platform.diagnose(), own]

    def start(self, now: float) -> None:
        self._platform.start(now)

    def poll(self, now: float) -> None:
        self._platform.poll(now)
        self._sample()

    @property
    def ready(self) -> bool:
        return self._platform.ready and not self._trouble

    @property
    def progress(self) -> str:
        return self._platform.progress if not self._platform.ready else self._trouble

    @property
    def stall(self) -> str:
        return self._platform.stall

    def sense(self, now: float) -> Sensed:
        sensed = self._platform.sense(now)
        return Sensed({**sensed.values, **self._values}, sensed.time)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        self._hand_on(actuators, now, self._platform.command)

    def resume(self, actuators: Mapping[str, Any], now: float) -> None:
        """Resume the commands of the time before a restart. Drivers receive all their commands again."""
        platform = self._platform
        self._hand_on(actuators, now, platform.resume if isinstance(platform, Resumes) else platform.command)

    def _hand_on(
        self, actuators: Mapping[str, Any], now: float, to: Callable[[Mapping[str, Any], float], None]
    ) -> None:
        own: dict[str, Any] = {}
        served: dict[str, dict[str, Any]] = {}
        for name, value in actuators.items():
            module, _, port = name.partition(".")
            if module in self._drivers:
                served.setdefault(module, {})[port] = value
            else:
                own[name] = value
        if own:
            to(own, now)
        for module, written in served.items():
            try:
                self._drivers[module].command(written)
            except ESCAPES as error:
                raise Unready(f"the driver of {module} refused a command: {_error_text(error)}") from None

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        module, _, name = port.partition(".")
        if module in self._drivers:
            return self._drivers[module].call(name, args)
        return self._platform.call(port, args)

    @property
    def vitals(self) -> Vitals:
        return vitals(self._platform)

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        self._platform.others(paths)

    def log_lines(self) -> list[str]:
        return self._platform.log_lines()

    def hold(self, on: bool, now: float) -> None:
        self._platform.hold(on, now)

    def stop(self, now: float) -> None:
        self._platform.stop(now)

    @property
    def stopped(self) -> bool:
        return self._platform.stopped

    def close(self) -> None:
        self._platform.close()
        for driver in self._drivers.values():
            with suppress(*ESCAPES):
                getattr(driver, "close", lambda: None)()

    def _sample(self) -> None:
        trouble = ""
        for module, driver in self._drivers.items():
            ports = [name for name in self._types if name.partition(".")[0] == module]
            try:
                sensed = driver.sense()
                for name in ports:
                    self._values[name] = self._typed(name, sensed[name.partition(".")[2]])
            except ESCAPES as error:
                trouble = f"the driver of {module} does not sense: {_error_text(error)}"
                self._values.update(dict.fromkeys(ports))
        self._trouble = trouble

    def _typed(self, name: str, value: Any) -> Any:
        typed = msgspec.convert(msgspec.to_builtins(value, builtin_types=(bytes,)), self._types[name])
        if not transmissible(typed):
            raise ValueError(f"{name} is {value!r}")
        return typed


def _error_text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
