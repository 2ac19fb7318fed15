"""Verdicts of a validation: whether simulation runs kept an assumption, for each assumption and each platform."""

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
    """Claim to validate: with confidence 1 - gamma, a run violates an assumption with a probability below epsilon."""

    epsilon: float
    gamma: float

    @property
    def needed(self) -> int:
        """Return how many runs without a violation are needed to show the claim."""
        return needed(self.epsilon, self.gamma)


@dataclass(frozen=True)
class Case:
    """Violation of an assumption in a simulation run, which the user can repeat.

    `run`: number of the run.
    `seed`: seed of the run.
    `robot`: name of the robot.
    `at`: start of the violated round, in seconds since round 1.
    `breach`: the robot's motion outside the box from its position to its target; None if it stayed in the box."""

    run: int
    seed: int
    robot: str
    at: float
    breach: BoxBreach | None


@dataclass(frozen=True)
class RobotSummary:
    """Summary of one robot over all runs: number of violated runs, of judged windows and of violated windows.

    A window is one round of the robot."""

    name: str
    runs: int
    windows: int
    violated: int


@dataclass(frozen=True)
class AssumptionVerdict:
    """Verdict of a validation about one assumption on one platform. A window is one round of one robot.

    `runs`: number of runs in which the assumption was judged.
    `violated`: number of runs in which the assumption was violated.
    `interval`: confidence interval of the probability that a run violates the assumption.
    `epsilon`: upper bound of this probability that `runs` runs without a violation would show.
    `wanted`: number of further runs that are needed to validate the assumption.
    `windows`, `violated_windows`: numbers of judged and of violated windows in all runs.
    `out_of_model`: number of windows that do not count, because the robot had left the model.
    `worst`: the violation with the farthest breach, or the first violation if no robot left its box.
    `breaches`: kind of breach -> number of violated windows.
    `farthest`: kind of breach -> largest distance of a robot from its box in one window, in metres.
    `together`: kind of breach -> largest sum of breaches over consecutive windows, in metres."""

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
    """Return one verdict for each assumption of the program and each platform of the fleet, in this order.

    `unfinished`: number of runs that were started but did not finish. If no run finished, the list is empty, because
        the platforms are read from the samples of finished runs."""
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
    name, why = _decided(bad, len(judged), total, cut, wanted)
    all_seen = [one for _, seen in judged for one in seen]
    counted = sum((one.breaches for one in all_seen), Counter[str]())
    return AssumptionVerdict(
        assumption, platform, name, why, len(judged), bad, clopper_pearson(bad, len(judged), bound.gamma),
        shown_epsilon(len(judged), bound.gamma), wanted, total[HELD] + total[VIOLATED], total[VIOLATED], total[OUT],
        _worst(judged, platform), dict(counted), _most([one.farthest for one in all_seen]),
        _most([one.together for one in all_seen]), _robots(judged, platform),
    )  # fmt: skip


def _decided(bad: int, judged: int, total: Mapping[str, int], cut: int, wanted: int) -> tuple[Name, str]:
    if bad:
        return "VIOLATED", ""
    if total.get(NO_VALUE):
        return "INCONCLUSIVE", f"it had no value in {_windows(total[NO_VALUE])}: its evaluation failed"
    if cut:
        return (
            "INCONCLUSIVE",
            f"{cut} run{'s' * (cut != 1)} did not come to an end, so violations may have been missed",
        )
    if not judged:
        unknown = f"; in {_windows(total[UNKNOWN])} it was not known" if total.get(UNKNOWN) else ""
        return "INCONCLUSIVE", f"the assumption was never put to the test{unknown}"
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
