"""Result of an audit about one property: observations, violations and unknown rounds."""

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
    """Time of an observation: right after a round's events, or at its end; round 0 is `init`.

    Times are ordered."""

    round: int
    end: bool

    def seconds(self, delta: float) -> float:
        """Return the fleet time in seconds since round 1 began; 0 for `init`."""
        return max(0.0, (self.round - 1 + self.end) * delta)


class ValueRow(NamedTuple):
    """Value of a variable at the previous and at this observation.

    `robot` is empty for an allwrite variable."""

    robot: str
    variable: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class AuditViolation:
    """First violation of a property.

    `robots`: those for which it was false; `bound` and `read`: the values that its formula used; `why`: the reason if
    it had no value. `where`: the time within the round, in words."""

    observation: Observation
    where: str
    robots: tuple[str, ...]
    bound: tuple[str, ...]
    read: tuple[str, ...]
    why: str
    rows: tuple[ValueRow, ...]


class OutcomeSpan(NamedTuple):
    """Rounds from `since` to `until`, both included, with one outcome."""

    since: int
    until: int
    outcome: Outcome


@dataclass
class PropertyResult:
    """Result of one property.

    `rounds`: number of rounds in which it was evaluated; `unknown`: in which it was not; for an assumption, summed over
    all robots. `missing`: unknown values with their cause, and the number of rounds. `unchecked`: the reason why it can
    never be evaluated. `unseen`: a robot may have broken this assumption, because it was in the model while its ports
    were unknown."""

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
        """Count rounds before `first`, which no trace records; `of_each`: number of evaluations in each round."""
        if self.unchecked:
            return
        self.unknown += first * of_each
        self.unseen = self.of == "assume"
        self.missing[f"rounds 0 to {first - 1}: no trace records them"] = first * of_each
        self.spans.append(OutcomeSpan(0, first - 1, "unknown"))

    def at(self, round_: int) -> Outcome:
        """Return the outcome of a round; unknown if it was not evaluated."""
        return next((span.outcome for span in self.spans if span.since <= round_ <= span.until), "unknown")

    def close(self, round_: int, outcomes: Sequence[tuple[Outcome, str]], of_each: bool) -> None:
        """Add the outcomes of one round, by observation or by robot, with the unknown values."""
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
