"""What an audit has found of one property."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Of = Literal["invariant", "initially", "assume", "contract", "well-defined", "axiom", "loop invariant"]
Verdict = Literal["held", "violated", "no value", "unknown", "unchecked"]
Outcome = Literal["held", "violated", "no value", "unknown"]
WORST: tuple[Outcome, ...] = ("violated", "no value", "unknown", "held")
BEGIN, AFTER, END = "before init", "after its events", "at its end"


class Moment(NamedTuple):
    """Right after a round's events, or its end; round 0 is `init`. They are ordered."""

    round: int
    end: bool

    def seconds(self, delta: float) -> float:
        """Of fleet time since round 1 began; `init` counts as then."""
        return max(0.0, (self.round - 1 + self.end) * delta)


class Row(NamedTuple):
    """A variable of a robot (empty: nobody's), at the moment before and at the one told of."""

    robot: str
    variable: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class Violation:
    """`robots` are those that it was false for, `bound` and `read` what was looked at then, `why` the reason where it
    had no value. `where`: which of a round's moments, in words."""

    moment: Moment
    where: str
    robots: tuple[str, ...]
    bound: tuple[str, ...]
    read: tuple[str, ...]
    why: str
    rows: tuple[Row, ...]


class Span(NamedTuple):
    """Rounds `since` to `until`, both included, with one outcome."""

    since: int
    until: int
    outcome: Outcome


@dataclass
class Finding:
    """`rounds` at which it was told, `unknown` at which not; of an assumption those of all robots together. `missing`:
    what was not known, and why, with the number of rounds. `unchecked`: why it cannot be told at all. `unseen`: a robot
    may have broken this assumption, because it was in the model and its ports are unknown."""

    of: Of
    name: str
    line: int
    unchecked: str = ""
    unseen: bool = False
    rounds: int = 0
    unknown: int = 0
    violated: int = 0
    first: Violation | None = None
    missing: dict[str, int] = field(default_factory=dict)
    spans: list[Span] = field(default_factory=list)

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
        """Count rounds before `first`, which no trace records; `of_each`: number of windows that judge a round."""
        if self.unchecked:
            return
        self.unknown += first * of_each
        self.unseen = self.of == "assume"
        self.missing[f"rounds 0 to {first - 1}: no trace records them"] = first * of_each
        self.spans.append(Span(0, first - 1, "unknown"))

    def at(self, round_: int) -> Outcome:
        """The outcome of a round; unknown where it was not looked at."""
        return next((span.outcome for span in self.spans if span.since <= round_ <= span.until), "unknown")

    def close(self, round_: int, told: Sequence[tuple[Outcome, str]], of_each: bool) -> None:
        """A round is over; `told` are its moments, or its robots, with what was not known."""
        if not told:
            return
        worst = min(told, key=lambda each: WORST.index(each[0]))
        for outcome, missing in told if of_each else [worst]:
            self.rounds += outcome != "unknown"
            self.unknown += outcome == "unknown"
            self.violated += outcome in ("violated", "no value")
            if missing:
                self.missing[missing] = self.missing.get(missing, 0) + 1
        if self.spans and self.spans[-1].outcome == worst[0] and self.spans[-1].until == round_ - 1:
            self.spans[-1] = self.spans[-1]._replace(until=round_)
        else:
            self.spans.append(Span(round_, round_, worst[0]))
