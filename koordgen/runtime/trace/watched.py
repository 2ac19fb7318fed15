"""What a robot's monitors look at and what they tell: a moment, one property and what is known of it, a change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import msgspec

from koordgen.runtime.config.settings import Action
from koordgen.runtime.program.property import UNKNOWN, Assumption, Known, Outcome, Property
from koordgen.runtime.values.points import transmissible

Of = Literal["invariant", "assume", "requires", "ensures", "loop invariant"]
FOR_GOOD = ("land", "stop")

# How much of a moment is certain: what is sensed; the robot's own variables, too; the shared store, too.
SENSED, OWN, SHARED = range(3)


class Moment(msgspec.Struct, frozen=True):
    """What a robot knows at the start of a round, before its event; `certain` says what of it. `sensed`: when the
    position was true (local time, None: never)."""

    round: int
    time: float
    certain: int
    sensed: float | None
    sensors: Mapping[str, Any]
    locals: Mapping[str, Any]
    shared: Mapping[str, Any]
    actuators: Mapping[str, Any]

    def value(self, name: str, place: int) -> Any:
        """What a property reads, of an allread variable all slots."""
        if place == SENSED:
            return self.sensors.get(name, UNKNOWN)
        if place == SHARED:
            return self.shared.get(name, UNKNOWN)
        return self.locals[name] if name in self.locals else self.actuators.get(name, UNKNOWN)

    def age(self, delta: float) -> int:
        """Whole rounds for which its sensors have not been new."""
        return 0 if self.sensed is None else max(0, int((self.time - self.sensed) / delta))


@dataclass(frozen=True, slots=True)
class Change:
    """A property's outcome, when it becomes another than `before` (None: nothing yet). `age`: rounds since the oldest
    value that it rests on was true; 0, this round's own reading. `line` is such as "app.koord:12"."""

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
        """The property, and where it stands."""
        return _word(self.of, self.name, self.line)


@dataclass(slots=True)
class Watched:
    """One property: `outcome` since round `since`, which was true at the start of round `true`. It `reads` these names,
    `needs` so much to be certain, and is `due` when something that it reads has become another. It is `acting` as long
    as it makes the robot do something."""

    of: Of
    name: str
    line: str
    action: Action
    what: Property | Assumption | None = None
    reads: frozenset[str] = frozenset()
    needs: int = SENSED
    senses: bool = False  # reads what grows old between two samples
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
        """The property, and where it stands."""
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
        """Another outcome in a round; None when it is none. `stale`: not because it was evaluated. What made the robot
        hold does so until it is evaluated and not violated."""
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
        """For the status, in plain values."""
        named = {"of": self.of, "name": self.name, "line": self.line, "outcome": self.outcome or "unknown"}
        age = max(0, round_ - self.true) if self.outcome else None
        return {**named, "since": self.since, "age": age, "why": self.why, "action": self.action}


def usable(value: Any) -> Any:
    """A sensor's value; UNKNOWN of one that no program may see."""
    return value if transmissible(value) else UNKNOWN


def _word(of: str, name: str, line: str) -> str:
    return f"{of} {name} ({line})" if name else f"{of} ({line})"
