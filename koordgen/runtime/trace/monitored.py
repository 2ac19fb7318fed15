"""Data of a robot's monitors: an observation, a monitored property, and a change of its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from koordgen.runtime.config.settings import Action
from koordgen.runtime.program.property import UNKNOWN, Assumption, Known, Outcome, Property
from koordgen.runtime.values.points import transmissible

Of = Literal["invariant", "guarantee", "assume", "requires", "ensures", "loop invariant"]
FOR_GOOD = ("land", "stop")

# Parts of an observation that are committed. SENSED: sensor values; OWN: also the robot's own variables; SHARED: also
# the shared variables.
SENSED, OWN, SHARED = range(3)


class Observation(msgspec.Struct, frozen=True):
    """A robot's knowledge at the start of a round, before its event.

    committed: parts that are committed: SENSED, OWN or SHARED.
    sensed: local time at which the robot's position was measured; None before the first measurement.
    """

    round: int
    time: float
    committed: int
    sensed: float | None
    sensors: Mapping[str, Any]
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]

    def value(self, name: str, place: int) -> Any:
        """Return the value of a variable or port that a property reads. An allread variable returns all its slots."""
        if place == SENSED:
            return self.sensors.get(name, UNKNOWN)
        if place == SHARED:
            return self.shared.get(name, UNKNOWN)
        return self.locals[name] if name in self.locals else self.actuators.get(name, UNKNOWN)

    def age(self, delta: float) -> int:
        """Return the age of the sensor values in whole rounds of `delta` seconds."""
        return 0 if self.sensed is None else max(0, int((self.time - self.sensed) / delta))


@dataclass(frozen=True, slots=True)
class Change:
    """Change of a monitored property's verdict.

    `before`: the previous verdict; None for the first verdict. `outcome`: the new verdict.
    `age`: age in rounds of the oldest value that the property read; 0 for values of this round.
    `line`: place of the property, such as "app.koord:12"."""

    time: float
    round: int
    of: Of
    name: str
    line: str
    outcome: Outcome
    age: int
    why: str
    action: Action
    before: Outcome | None

    @property
    def word(self) -> str:
        """Return kind, name and line of the property."""
        return _word(self.of, self.name, self.line)


@dataclass(slots=True)
class MonitoredProperty:
    """A property that a robot monitors.

    outcome: present verdict, unchanged since round `since`.
    true: last round for whose start the verdict was confirmed.
    reads: names of the values that the property reads.
    needs: committed parts of an observation (SENSED, OWN or SHARED) that the property needs.
    due: True if a value that the property reads has changed, so the property must be evaluated.
    acting: True while the property's violation makes the robot hold, land or stop.
    """

    of: Of
    name: str
    line: str
    action: Action
    what: Property | Assumption | None = None
    reads: frozenset[str] = frozenset()
    needs: int = SENSED
    senses: bool = False  # the property reads sensors, whose values age between samples
    due: bool = True
    outcome: Outcome | None = None
    why: str = ""
    since: int = 0
    true: int = 0
    overruns: int = 0
    violations: int = 0
    acting: bool = False

    @property
    def word(self) -> str:
        """Return kind, name and line of the property."""
        return _word(self.of, self.name, self.line)

    @property
    def holds(self) -> Callable[[Known], bool]:
        match self.what:
            case Assumption(goals=goals):
                return self.what.holds_of_calls if goals else self.what.holds
            case Property():
                return self.what.holds
            case None:
                raise LookupError(f"nothing evaluates {self.of} {self.name}")

    def become(self, outcome: Outcome, why: str, round_: int, time: float, stale: bool = False) -> Change | None:
        """Set the verdict of the property in a round. Return the change of the verdict, or None if it stays the same.

        `stale`: True if the property was not evaluated. A property that makes the robot hold stops doing so only when
        it is evaluated and not violated."""
        before = self.outcome
        if outcome == before:
            return None
        self.outcome, self.why, self.since = outcome, why, round_
        if outcome == "violated":
            self.violations += 1
            self.acting = self.action in ("hold", *FOR_GOOD)
        elif outcome != "no value" and not stale:
            self.acting = self.acting and self.action != "hold"
        age = max(0, round_ - self.true)
        return Change(time, round_, self.of, self.name, self.line, outcome, age, why, self.action, before)

    def report(self, round_: int) -> dict[str, Any]:
        """Return the property and its verdict as JSON values for the status answer."""
        named = {"of": self.of, "name": self.name, "line": self.line, "outcome": self.outcome or "unknown"}
        age = max(0, round_ - self.true) if self.outcome else None
        return {**named, "since": self.since, "age": age, "why": self.why, "action": self.action}


def usable(value: Any) -> Any:
    """Return a sensor value, or UNKNOWN if no program may read the value."""
    return value if transmissible(value) else UNKNOWN


def _word(of: str, name: str, line: str) -> str:
    return f"{of} {name} ({line})" if name else f"{of} ({line})"
