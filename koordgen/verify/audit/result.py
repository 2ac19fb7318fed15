"""Result of an audit for one property: observations, violations and unknown rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Of = Literal["invariant", "initially", "assume", "contract", "well-defined", "axiom", "loop invariant"]
Verdict = Literal["held", "violated", "no value", "unknown", "unchecked"]
Outcome = Literal["held", "violated", "no value", "unknown"]
WORST: tuple[Outcome, ...] = ("violated", "no value", "unknown", "held")
BEGIN, AFTER, END = "before init", "after its events", "at its end"


class Observation(NamedTuple):
    """Time of an observation. Earlier observations compare as less.

    `round`: the round; 0 is `init`.
    `end`: False for right after the round's events, True for the round's end."""

    round: int
    end: bool

    def seconds(self, delta: float) -> float:
        """Return the fleet time in seconds since round 1 began; 0 for `init`."""
        return max(0.0, (self.round - 1 + self.end) * delta)


class ValueRow(NamedTuple):
    """Value of a variable at the previous observation and at this one, as text.

    `robot`: the robot that owns the variable; empty for an allwrite variable."""

    robot: str
    variable: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class AuditViolation:
    """First violation of a property.

    `where`: the time within the round, in words.
    `robots`: the robots for which the property was false.
    `bound`: the values of the formula's quantified names.
    `read`: the values that the formula read.
    `why`: the reason why the property had no value; empty if it was false.
    `rows`: the values of relevant variables before and after."""

    observation: Observation
    where: str
    robots: tuple[str, ...]
    bound: tuple[str, ...]
    read: tuple[str, ...]
    why: str
    rows: tuple[ValueRow, ...]


class OutcomeSpan(NamedTuple):
    """Consecutive rounds with the same outcome, from `since` to `until` inclusive."""

    since: int
    until: int
    outcome: Outcome


@dataclass
class PropertyResult:
    """Result of one property.

    `unchecked`: the reason why the property can never be evaluated; empty if it can.
    `unseen`: for an assumption: whether a robot may have broken it unnoticed, because the robot was in the model while
        its ports were unknown.
    `rounds`: number of rounds in which the property was evaluated; for an assumption, summed over all robots.
    `unknown`: number of rounds in which it could not be evaluated; for an assumption, summed over all robots.
    `missing`: unknown value with its cause -> number of rounds."""

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
        """Count all rounds before `first` as unknown, since no trace records them.

        `of_each`: number of evaluations in each round."""
        if self.unchecked:
            return
        self.unknown += first * of_each
        self.unseen = self.of == "assume"
        self.missing[f"rounds 0 to {first - 1}: no trace records them"] = first * of_each
        self.spans.append(OutcomeSpan(0, first - 1, "unknown"))

    def at(self, round_: int) -> Outcome:
        """Return the outcome of a round; "unknown" if the property was not evaluated then."""
        return next((span.outcome for span in self.spans if span.since <= round_ <= span.until), "unknown")

    def close(self, round_: int, outcomes: Sequence[tuple[Outcome, str]], of_each: bool) -> None:
        """Add the outcomes of one round.

        `outcomes`: pairs of an outcome and a text about the unknown value.
        `of_each`: whether each outcome counts on its own, as for an assumption with one outcome per robot. Otherwise
            only the worst one counts."""
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
