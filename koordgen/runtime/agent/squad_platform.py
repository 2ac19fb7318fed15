"""Platform of an outer robot: its sensors are expressions over the inner store, its commands are writes to it.

Frames and units are those of the inner program, which the outer program shares: local ENU, metres."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Sensed

PERIOD = 0.05  # seconds between two polls of the outer robot


class InnerFleet(Protocol):
    """The inner fleet as its host sees it."""

    def values(self) -> tuple[Mapping[str, Any], float]:
        """Return the values of the provided sensors, and the local time (s) at which robots have measured them."""
        ...

    def trouble(self) -> str:
        """Return the reason why the inner store is not current; "" if it is."""
        ...

    def stop(self, why: str) -> None:
        """Stop all inner robots safely."""
        ...

    @property
    def stopped(self) -> bool:
        """True once the host itself has stopped safely."""
        ...


class SquadPlatform:
    """Platform of one outer robot on its present host. Implements Platform.

    touch: function that is called when there is a new command to write.
    """

    def __init__(self, squad: Squad, inner: InnerFleet, touch: Callable[[], int]) -> None:
        self.period = PERIOD
        self._variables, self._inner, self._touch = squad.actuators, inner, touch
        actuators = [p for p in squad.program.ports if p.direction == "actuator"]
        self._holding = {p.name: p.held for p in actuators if p.held}  # actuator -> sensor by which the robot holds
        self._clears = squad.program.clears
        self._commands: dict[str, Any] = {}  # what the outer program wants
        self._wanted: dict[str, Any] = {}  # what the inner fleet is to do: the same, or to hold
        self._versions: dict[str, int] = {}  # actuator -> version of the record with its value, until it is committed
        self._held = self._stopping = False

    def diagnose(self) -> list[Finding]:
        return []

    def start(self, now: float) -> None:
        pass

    def poll(self, now: float) -> None:
        pass

    @property
    def ready(self) -> bool:
        return not self._lacking

    @property
    def progress(self) -> str:
        return self._lacking

    @property
    def _lacking(self) -> str:
        """Reason why the inner fleet cannot serve now; "" if it can."""
        absent = [name for name, value in self._inner.values()[0].items() if value is None]
        return self._inner.trouble() or (f"{', '.join(absent)} has no value yet" if absent else "")

    @property
    def stall(self) -> str:
        return ""

    def sense(self, now: float) -> Sensed:
        """Return the sensors' values. A sensor that a command clears is false until the command is committed."""
        values, time = self._inner.values()
        cleared = {sensor for name in self._versions for sensor in self._clears.get(name, ())}
        return Sensed({**values, **dict.fromkeys(cleared, False)}, time)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        self._commands.update(actuators)
        self._want(self._held)

    def hold(self, on: bool, now: float) -> None:
        if on != self._held:
            self._want(on)

    def _want(self, held: bool) -> None:
        """Write the commands, or the values by which the robot holds. Commands without such a value stay."""
        self._held = held
        wanted = dict(self._commands)
        if held:
            values = self._inner.values()[0]
            wanted.update({n: values[s] for n, s in self._holding.items() if values.get(s) is not None})
        changed = [name for name, value in wanted.items() if name not in self._wanted or self._wanted[name] != value]
        self._wanted.update(wanted)
        if changed:
            version = self._touch()
            self._versions.update(dict.fromkeys(changed, version))

    def writes(self) -> dict[str, Any]:
        """Return variable of the inner program -> value, of all commands that are not committed yet."""
        return {self._variables[name]: self._wanted[name] for name in self._versions}

    def committed(self, version: int) -> None:
        """Note that the record with this version is committed, and with it all earlier commands."""
        self._versions = {name: v for name, v in self._versions.items() if v > version}

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        raise LookupError(f"a squad does not serve {port}")

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        pass

    def log_lines(self) -> list[str]:
        return []

    def stop(self, now: float) -> None:
        if not self._stopping:
            self._stopping = True
            self._inner.stop("the outer robot stops safely")

    @property
    def stopped(self) -> bool:
        return self._stopping and self._inner.stopped

    def close(self) -> None:
        pass
