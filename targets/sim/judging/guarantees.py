"""Step guarantees of exported variables, judged on the writes of a run.

A step guarantee is reflexive and transitive, because the prover shows that. So if it is false between two states of a
run, one of the writes between them broke it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.property import UNKNOWN, Properties, Property, judged
from koordgen.runtime.trace.schema import Violation
from targets.sim.judging.judge import JudgedProperty
from targets.sim.trace.truth import SharedWrite, Truth


class WatchedApplication(NamedTuple):
    """Application of a fleet, with its properties. `number`: see FleetProgram.applications."""

    fleet: FleetProgram
    number: int
    properties: Properties

    @property
    def name(self) -> str:
        """Name of the application; "" if the fleet has only one."""
        return self.fleet.applications[self.number].name if self.fleet.is_composed else ""

    @property
    def members(self) -> tuple[int, ...]:
        """Robots that run the application, by their pids in the fleet."""
        return self.fleet.applications[self.number].members

    @classmethod
    def only(cls, found: Properties, robots: int) -> WatchedApplication:
        """Return the only application of a fleet."""
        return cls(FleetProgram.alone(found.program, robots), 0, found)


class StepGuarantees:
    """Step guarantees of the variables that an application exports. `variables`: these variables.

    `watched`: all properties of the application. `names`: names of all robots. Each write of a round is judged if the
    records of all instances are there. If a record is missing, the writes or their order are unknown, and the round is
    not judged. The next complete round is then judged as one step: from the last known value to that round's end."""

    def __init__(
        self, watched: Sequence[JudgedProperty], found: Properties, of: WatchedApplication, names: tuple[str, ...]
    ) -> None:
        self._guarantees = [(w, _variable(w.what)) for w in watched if w.is_step and isinstance(w.what, Property)]
        self.variables = frozenset([variable for _, variable in self._guarantees])
        self._known = found.fleet(len(of.members), None)
        self._of, self._names = of, names
        self._last: dict[str, Any] | None = None  # values at the end of the last round that was judged
        self._is_next = False  # whether `_last` has the values of the round before the present one

    def judge(self, truth: Truth, at: float, removed: Collection[int]) -> Iterator[Violation]:
        """Judge the round that `truth` has applied last, which began at a time. Yield the new violations.

        `init` need not keep step guarantees. `removed`: numbers of the instances of removed robots."""
        if not self._guarantees:
            return
        if not truth.lacking.issubset(removed):
            self._is_next = False
            return
        now = {name: truth.value(name) for name in self.variables}
        if self._last is not None:
            changes = truth.changes if self._is_next else [SharedWrite(n, self._last[n], now[n], -1, "") for n in now]
            for watched, variable in self._guarantees:
                yield from self._judged(watched, [change for change in changes if change.variable == variable], at)
        self._last, self._is_next = now, True

    def _judged(self, watched: JudgedProperty, changes: Sequence[SharedWrite], at: float) -> Iterator[Violation]:
        """Judge one guarantee at the changes of its variable in a round. Yield its first violation."""
        for change in changes:
            if watched.decided or _is_unknown(change.before) or _is_unknown(change.after):
                continue
            self._known.put({change.variable: change.before, f"{change.variable}'": change.after})
            outcome, why = judged(watched.what.holds, self._known)
            names = tuple([self._names[robot] for robot in self._of.members])
            by, writers = self._writer(change)
            if violation := watched.note(outcome, at, why, self._known, names, False, by, writers):
                yield violation
        if not changes and not watched.decided:
            watched.observations += 1  # an unchanged variable keeps a reflexive guarantee

    def _writer(self, change: SharedWrite) -> tuple[str, tuple[str, ...]]:
        """Return the step that made a change, as text, and its robot."""
        if change.instance < 0:
            return "by writes of several rounds, not all of which were recorded", ()
        instance = self._of.fleet.instances[change.instance]
        name = self._names[instance.robot]
        of = f"{self._of.fleet.applications[instance.application].name} on " if self._of.fleet.is_composed else ""
        return f"by {change.event} of {of}{name}", (name,)


def _variable(guarantee: Property) -> str:
    """Return the variable that a step guarantee compares."""
    return next(name.removesuffix("'") for name in guarantee.reads)


def _is_unknown(value: Any) -> bool:
    return value is UNKNOWN or (isinstance(value, list) and UNKNOWN in value)
