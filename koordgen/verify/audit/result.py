"""Result of an audit for one property: the outcome in each round, the first violation, and unknown values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Of = Literal[
    "invariant", "guarantee", "initially", "assume", "contract", "well-defined", "axiom", "loop invariant", "guarantee"
]
Verdict = Literal["held", "violated", "no value", "unknown", "unchecked"]
Outcome = Literal["held", "violated", "no value", "unknown"]
WORST: tuple[Outcome, ...] = ("violated", "no value", "unknown", "held")
BEGIN, AFTER, END = "before init", "after its events", "at its end"


class ObservationTime(NamedTuple):
    """Time of an observation. Observations are ordered by time.

    `round`: number of the round; 0 for `init`.
    `end`: True at the round's end; False right after the round's events."""

    round: int
    end: bool

    def seconds(self, delta: float) -> float:
        """Return the time of the observation in seconds since round 1 began; 0 for `init`."""
        return max(0.0, (self.round - 1 + self.end) * delta)


class ValueRow(NamedTuple):
    """Row of a violation's table: values of one variable as text.

    `robot`: name of the robot that owns the variable; empty for an allwrite variable.
    `before`: value at the observation before the violation.
    `after`: value at the observation with the violation."""

    robot: str
    variable: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class AuditViolation:
    """First violation of a property.

    `where`: the time of the violation within the round, in words.
    `robots`: names of the robots for which the property was false.
    `bound`: values of the names that the formula's quantifiers bind.
    `read`: values that the evaluation of the formula read.
    `why`: the reason why the property had no value; empty if the property was false.
    `rows`: values of the variables that the property reads."""

    observation: ObservationTime
    where: str
    robots: tuple[str, ...]
    bound: tuple[str, ...]
    read: tuple[str, ...]
    why: str
    rows: tuple[ValueRow, ...]


class OutcomeSpan(NamedTuple):
    """Consecutive rounds in which a property had the same outcome, from `since` to `until` inclusive."""

    since: int
    until: int
    outcome: Outcome


@dataclass
class PropertyResult:
    """Result of one property.

    `unchecked`: the reason why the property can never be evaluated; empty for all other properties.
    `unseen`: whether the property is an assumption that may have been broken unnoticed, because a robot took part in
        the mission while values of its ports were unknown.
    `rounds`: number of rounds in which the property was evaluated; for an assumption, summed over all robots.
    `unknown`: number of rounds in which the property could not be evaluated, summed in the same way.
    `violated`: number of rounds in which the property was false or had no value, summed in the same way.
    `missing`: text about an unknown value and its cause -> number of rounds."""

    of: Of
    name: str
    line: int
    unchecked: str = ""
    unseen: bool = False
    rounds: int = 0
    unknown: int = 0
    violated: int = 0
    first: AuditViolation | None = None
    missing: dict[str, int] = field(default_factory=dict)
    spans: list[OutcomeSpan] = field(default_factory=list)

    @property
    def title(self) -> str:
        return f"{self.of} {self.name}" if self.name else self.of

    @property
    def verdict(self) -> Verdict:
        if self.first is not None:
            return "no value" if self.first.why and self.of != "contract" else "violated"
        if self.unchecked:
            return "unchecked"
        return "held" if self.rounds and not self.unseen else "unknown"

    def miss(self, first: int, of_each: int) -> None:
        """Count all rounds before the round `first` as unknown, since no trace records them.

        `of_each`: number of evaluations of the property in one round."""
        if self.unchecked:
            return
        self.unknown += first * of_each
        self.unseen = self.of == "assume"
        self.missing[f"rounds 0 to {first - 1}: no trace records them"] = first * of_each
        self.spans.append(OutcomeSpan(0, first - 1, "unknown"))

    def at(self, round_: int) -> Outcome:
        """Return the outcome of the property in a round; "unknown" if it was not evaluated in the round."""
        return next((span.outcome for span in self.spans if span.since <= round_ <= span.until), "unknown")

    def close(self, round_: int, outcomes: Sequence[tuple[Outcome, str]], of_each: bool) -> None:
        """Add the outcomes of the property in one round.

        `outcomes`: pairs of an outcome and a text about the unknown value.
        `of_each`: whether all outcomes count, as for an assumption with one outcome for each robot. Otherwise only the
            worst outcome counts."""
        if not outcomes:
            return
        worst = min(outcomes, key=lambda each: WORST.index(each[0]))
        for outcome, missing in outcomes if of_each else [worst]:
            self.rounds += outcome != "unknown"
            self.unknown += outcome == "unknown"
            self.violated += outcome in ("violated", "no value")
            if missing:
                self.missing[missing] = self.missing.get(missing, 0) + 1
        if self.spans and self.spans[-1].outcome == worst[0] and self.spans[-1].until == round_ - 1:
            self.spans[-1] = self.spans[-1]._replace(until=round_)
        else:
            self.spans.append(OutcomeSpan(round_, round_, worst[0]))
