"""Judgement of one property: its first violation and its verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from koordgen.runtime.monitor.monitor import evidence
from koordgen.runtime.program.property import Assumption, Known, Outcome, Properties, Property, Trail, judged
from koordgen.runtime.trace.schema import Found, Verdict, Violation
from targets.sim.trace.store_names import qualified_name

Of = Literal["invariant", "guarantee", "initially", "assume"]


@dataclass(slots=True)
class JudgedProperty:
    """One property and its result so far.

    `at`: time of its first violation or missing value. `left`: time when the property became unknown,
    because a robot left the model. Times are of the run's clock."""

    of: Of
    name: str
    line: str
    what: Property | Assumption
    moving: bool  # reads positions of bodies, and so changes between rounds
    found: Properties
    n: int
    application: str = ""  # name of the application; "": the fleet has only one
    outcome: Literal["violated", "no value"] | None = None
    at: float = 0.0
    left: float | None = None
    robots: tuple[str, ...] = ()
    detail: str = ""
    observations: int = 0  # number of observations at which the property had a value
    unknown: int = 0  # number of observations at which the property was unknown

    @property
    def decided(self) -> bool:
        return self.outcome is not None

    @property
    def is_step(self) -> bool:
        """True of a guarantee that compares the values before and after a write."""
        return isinstance(self.what, Property) and self.what.is_step

    @property
    def screening(self) -> Callable[[Any], Any] | None:
        return self.what.screening

    def note(
        self, outcome: Outcome, at: float, why: str, known: Known, names: tuple[str, ...], lost: bool,
        by: str = "", writers: tuple[str, ...] = (),
    ) -> Violation | None:  # fmt: skip
        """Record the outcome of an observation. Return a violation the first time the property does not hold.

        `lost`: a robot was out of the model. The violation names the robots that made the property false, and the
        values read. `by`, `writers`: the step that made a guarantee false, as text, and its robot."""
        if outcome == "unknown":
            self.unknown += 1
            self.detail = self.detail or why
            self.left = at if lost and self.left is None else self.left
            return None
        self.observations += 1
        if outcome == "held":
            return None
        trail: Trail = []
        holds: Callable[[Known], bool]
        if isinstance(self.what, Assumption):
            again, holds = self.found.step(self.n, trail), self.what.holds_of_calls
        else:
            again, holds = self.found.fleet(self.n, trail), self.what.holds
        again.copy_from(known)
        judged(holds, again)
        self.at, self.outcome = at, outcome
        self.robots, self.detail = evidence(trail, names, why, known.pid)
        if by:
            self.robots, self.detail = writers, "; ".join(filter(None, (self.detail, by)))
        word = " ".join(filter(None, (self.of, qualified_name(self.application, self.name))))
        verb = "has no value" if why else "does not hold"
        text = f"{word} {verb}: {self.detail}" if self.detail else f"{word} {verb}"
        return Violation(at, "property", self.robots, text, self.name, self.line, application=self.application)

    def verdict(self, at: float, zero: float | None, lost: str) -> Verdict:
        """Return the verdict at the mission's end.

        `zero`: time when round 1 began. `lost`: names of robots that have left the model."""
        word: Found
        since: float | None = None
        if self.outcome is not None:
            word, since, detail = self.outcome, self.at, self.detail
        elif self.left is not None:
            word, since = "out of model", self.left
            detail = f"{lost or 'a robot'} had left the model; until then it held"
        elif not self.observations:
            word, detail = "unchecked", f"not known: {self.detail}" if self.unknown else "it was never observed"
        else:
            word, detail = (
                "held",
                f"at {self.unknown} more observations not known: {self.detail}" if self.unknown else "",
            )
        since = None if since is None or zero is None else round(since - zero, 6)
        robots, seen = self.robots, self.observations
        return Verdict(at, self.of, self.name, self.line, word, since, robots, detail, seen, self.application)


def all_of(found: Properties, n: int, application: str = "") -> list[JudgedProperty]:
    """Return all properties and assumptions that can be evaluated, for `n` robots that run an application."""
    source = found.program.source
    measured = {*found.measured, *(f"{name}'" for name in found.measured)}
    properties = [
        JudgedProperty(
            p.kind, p.name, f"{source}:{p.line}", p, bool(measured.intersection(p.reads)), found, n, application
        )
        for p in found.properties
    ]
    assumptions = [
        JudgedProperty(
            "assume", a.module, f"{source}:{a.line}", a, bool(measured.intersection(a.reads)), found, n, application
        )
        for a in found.assumptions
    ]
    return [*properties, *assumptions]
