"""Verdicts about each assumption on each platform, from the samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from koordgen.experiment.validate.breach import BoxBreach
from koordgen.experiment.validate.samples import (
    FINISHED,
    HELD,
    NO_VALUE,
    OUT,
    UNKNOWN,
    VIOLATED,
    AssumptionObservation,
    RunSample,
    SampledAssumption,
)
from koordgen.experiment.validate.statistics import clopper_pearson, needed, shown_epsilon

Name = Literal["VALIDATED", "VIOLATED", "INCONCLUSIVE"]


@dataclass(frozen=True)
class ProbabilityBound:
    """Claim to validate: with confidence 1 - gamma a run violates with a probability below epsilon."""

    epsilon: float
    gamma: float

    @property
    def needed(self) -> int:
        """Return the number of runs without a violation that show the claim."""
        return needed(self.epsilon, self.gamma)


@dataclass(frozen=True)
class Case:
    """A violated window that can be run again: its run, seed, robot and time (s since round 1)."""

    run: int
    seed: int
    robot: str
    at: float
    breach: BoxBreach | None


@dataclass(frozen=True)
class RobotSummary:
    """One robot over all samples: violated runs, judged and violated windows."""

    name: str
    runs: int
    windows: int
    violated: int


@dataclass(frozen=True)
class AssumptionVerdict:
    """Verdict about one assumption on one platform.

    `runs`: samples in which it was judged; `violated`: those in which it was violated; `interval`: that of the
    probability that a run violates it; `windows` and `violated_windows`: sums over all samples. `worst`: the farthest
    breach, or the first violation. `epsilon`: the bound that this many runs without a violation would show; `wanted`:
    number of further runs needed. By kind of breach: violated windows, and distances outside of the box in metres, in
    one window (`farthest`) and in consecutive windows (`together`)."""

    assumption: SampledAssumption
    platform: str
    verdict: Name
    why: str
    runs: int
    violated: int
    interval: tuple[float, float]
    epsilon: float
    wanted: int
    windows: int
    violated_windows: int
    out_of_model: int
    worst: Case | None
    breaches: Mapping[str, int]
    farthest: Mapping[str, float]
    together: Mapping[str, float]
    robots: tuple[RobotSummary, ...]


def verdicts(samples: Sequence[RunSample], unfinished: int, bound: ProbabilityBound) -> list[AssumptionVerdict]:
    """Return the verdicts by assumption, then platform, in the order of program and fleet.

    `unfinished`: number of started runs without a sample. Empty without samples, since then not even the platforms are
    known."""
    if not samples:
        return []
    platforms = dict.fromkeys(samples[0].platforms)
    return [_of(a, platform, samples, unfinished, bound) for a in samples[0].assumptions for platform in platforms]


def _of(
    assumption: SampledAssumption, platform: str, samples: Sequence[RunSample], unfinished: int, bound: ProbabilityBound
) -> AssumptionVerdict:
    judged: list[tuple[RunSample, list[AssumptionObservation]]] = []
    total: Counter[str] = Counter()
    cut = unfinished
    for sample in samples:
        seen = sample.of(assumption.index, platform)
        windows = sum((one.windows for one in seen), Counter[str]())
        total += windows
        if windows[VIOLATED] or (sample.ended in FINISHED and windows[HELD]):
            judged.append((sample, seen))
        elif sample.ended not in FINISHED:
            cut += 1
    bad = sum(any(one.windows[VIOLATED] for one in seen) for _, seen in judged)
    wanted = max(0, bound.needed - len(judged))
    name, why = _said(bad, len(judged), total, cut, wanted)
    all_seen = [one for _, seen in judged for one in seen]
    counted = sum((one.breaches for one in all_seen), Counter[str]())
    return AssumptionVerdict(
        assumption, platform, name, why, len(judged), bad, clopper_pearson(bad, len(judged), bound.gamma),
        shown_epsilon(len(judged), bound.gamma), wanted, total[HELD] + total[VIOLATED], total[VIOLATED], total[OUT],
        _worst(judged, platform), dict(counted), _most([one.farthest for one in all_seen]),
        _most([one.together for one in all_seen]), _robots(judged, platform),
    )  # fmt: skip


def _said(bad: int, judged: int, total: Mapping[str, int], cut: int, wanted: int) -> tuple[Name, str]:
    if bad:
        return "VIOLATED", ""
    if total.get(NO_VALUE):
        return "INCONCLUSIVE", f"it had no value in {_windows(total[NO_VALUE])}: something in it failed"
    if cut:
        return (
            "INCONCLUSIVE",
            f"{cut} run{'s' * (cut != 1)} did not come to an end: what it would have shown is not known",
        )
    if not judged:
        unknown = f"; in {_windows(total[UNKNOWN])} it was not known" if total.get(UNKNOWN) else ""
        return "INCONCLUSIVE", f"it was never put to the test{unknown}"
    if wanted:
        return "INCONCLUSIVE", f"{wanted} more sample{'s' * (wanted != 1)} wanted"
    return "VALIDATED", ""


def _windows(count: int) -> str:
    return f"{count} window{'s' * (count != 1)}"


def _worst(judged: Sequence[tuple[RunSample, list[AssumptionObservation]]], platform: str) -> Case | None:
    cases = [
        Case(s.run, s.seed, s.names[pid], one.worst.at if one.worst else one.first, one.worst)
        for s, seen in judged
        for pid, one in zip(s.robots(platform), seen, strict=True)
        if one.first is not None
    ]
    return min(cases, key=lambda c: (-(c.breach.distance if c.breach else 0.0), c.run, c.at), default=None)


def _most(metres: Sequence[Mapping[str, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one in metres:
        for kind, distance in one.items():
            found[kind] = max(found.get(kind, 0.0), distance)
    return found


def _robots(judged: Sequence[tuple[RunSample, list[AssumptionObservation]]], platform: str) -> tuple[RobotSummary, ...]:
    if not judged:
        return ()
    first, _ = judged[0]
    found = []
    for place, pid in enumerate(first.robots(platform)):
        own = [seen[place].windows for _, seen in judged]
        violated = sum(w[VIOLATED] for w in own)
        windows = violated + sum(w[HELD] for w in own)
        found.append(RobotSummary(first.names[pid], sum(w[VIOLATED] > 0 for w in own), windows, violated))
    return tuple(found)
