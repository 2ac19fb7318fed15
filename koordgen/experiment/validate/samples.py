"""Samples of a validation: each sample holds the observations of assumptions and of motion in one simulation run.

A sample is read from a run's `windows.jsonl`, which targets/sim/judging/windows.py writes. A window is one round of one
robot.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from koordgen.experiment.validate.breach import BoxBreach, ConsecutiveBreaches, kind

FORMAT, FILE = "koord-windows/1", "windows.jsonl"
FINISHED = ("completed", "stopped")  # values of `ended` of a run that was simulated to its end
HELD, VIOLATED, NO_VALUE, UNKNOWN, OUT, UNASKED = "hvnuo-"


@dataclass(frozen=True)
class SampledAssumption:
    """Assumption that a Koord program makes about a module.

    `index`: place of the assumption in the lists of `windows.jsonl`.
    `line`: line of the assumption in the program."""

    index: int
    module: str
    line: int


@dataclass
class AssumptionObservation:
    """Observation of one assumption on one robot in one run. A window is one round of the robot.

    `windows`: result of the assumption -> number of windows with this result.
    `first`: time of the first violation, in seconds since round 1; None without a violation.
    `worst`: the violated window in which the robot was farthest outside the box from its position to its target."""

    windows: Counter[str] = field(default_factory=Counter)
    first: float | None = None
    worst: BoxBreach | None = None
    breaches: Counter[str] = field(default_factory=Counter)  # kind of breach -> number of violated windows

    # kind of breach -> largest distance in one window, in metres, from the box that the assumption allows
    farthest: dict[str, float] = field(default_factory=dict)
    # kind of breach -> largest sum of breaches over consecutive windows, in metres
    together: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RunSample:
    """Sample: observations of all robots in one simulation run.

    `ended`: how the run ended, such as "completed".
    `names`, `platforms`: name and platform of each robot, by pid.
    `seen`: (index of the assumption, pid) -> observation.
    `reach`: pid -> largest distance in metres of the robot from its target.
    `far`: like `reach`, but only of the times when the robot was outside the box from its position to its target."""

    run: int
    seed: int
    ended: str
    body: str
    names: tuple[str, ...]
    platforms: tuple[str, ...]
    assumptions: tuple[SampledAssumption, ...]
    unchecked: tuple[tuple[int, str], ...]  # (line, reason) of each assumption that cannot be evaluated
    seen: Mapping[tuple[int, int], AssumptionObservation]
    breaches: tuple[BoxBreach, ...]
    far: Mapping[int, float]
    reach: Mapping[int, float]

    def robots(self, platform: str) -> list[int]:
        """Return the pids of the robots that belong to a platform."""
        return [pid for pid, own in enumerate(self.platforms) if own == platform]

    def of(self, assumption: int, platform: str) -> list[AssumptionObservation]:
        """Return the observations of one assumption, one for each robot of a platform in the order of pids."""
        return [self.seen[assumption, pid] for pid in self.robots(platform)]


def read(folder: Path, run: int) -> RunSample | None:
    """Read the sample of run number `run` from the run's folder.

    Returns None if `windows.jsonl` is missing, incomplete or invalid. Raises OSError if it cannot be read."""
    try:
        with (folder / FILE).open(encoding="utf-8") as file:
            lines = [json.loads(line) for line in file]
        if lines[0]["format"] != FORMAT or "end" not in lines[-1]:
            return None
        return _sample(run, lines[0], lines[1:-1], lines[-1]["end"])
    except FileNotFoundError:
        return None
    except (ValueError, LookupError, TypeError):  # the file is incomplete, or has another format
        return None


def _sample(run: int, head: Mapping[str, Any], rows: Iterable[Mapping[str, Any]], ended: str) -> RunSample:
    assumptions = tuple([SampledAssumption(k, a["module"], a["line"]) for k, a in enumerate(head["assumptions"])])
    robots = head["robots"]
    seen = {(a.index, pid): AssumptionObservation() for a in assumptions for pid in range(len(robots))}
    breaches: list[BoxBreach] = []
    far: dict[int, float] = {}
    reach: dict[int, float] = {}
    in_a_row: dict[int, ConsecutiveBreaches] = {}
    for row in rows:
        pid, at = row["pid"], round((row["round"] - 1) * head["delta"], 6)
        breach = _breach(row, at, in_a_row.setdefault(pid, ConsecutiveBreaches())) if "out" in row else None
        if breach is None:
            in_a_row.pop(pid, None)
        else:
            breaches.append(breach)
            far[pid] = max(far.get(pid, 0.0), row["far"])
        if "reach" in row:
            reach[pid] = max(reach.get(pid, 0.0), row["reach"])
        for index, came in enumerate(row["came"]):
            _note(seen[index, pid], came, at, breach)
    return RunSample(
        run, head["seed"], ended, head["body"], tuple(r["name"] for r in robots),
        tuple(r["platform"] for r in robots), assumptions, tuple((u["line"], u["why"]) for u in head["unchecked"]),
        seen, tuple(breaches), far, reach,
    )  # fmt: skip


def _breach(row: Mapping[str, Any], at: float, before: ConsecutiveBreaches) -> BoxBreach:
    start, target, moving, out, then = (tuple(row[key]) for key in ("start", "target", "velocity", "out", "then"))
    return before.add(row["pid"], at, out, kind(start, target, moving, out, then))


def _note(seen: AssumptionObservation, came: str, at: float, breach: BoxBreach | None) -> None:
    seen.windows[came] += 1
    if came != VIOLATED:
        return
    seen.first = at if seen.first is None else seen.first
    if breach is not None:
        seen.breaches[breach.kind] += 1
        seen.farthest[breach.kind] = max(seen.farthest.get(breach.kind, 0.0), breach.distance)
        seen.together[breach.main] = max(seen.together.get(breach.main, 0.0), breach.together)
        if seen.worst is None or breach.distance > seen.worst.distance:
            seen.worst = breach


def margin(samples: Iterable[RunSample], platform: str, *, outside: bool) -> float:
    """Return the largest distance in metres of a platform's robots from their targets, over all samples.

    If `outside` is true, only those times count when a robot was outside the box from its position to its target; 0 if
    no robot ever was. Returns NaN if no sample has a robot of the platform."""
    values = (
        (sample.far if outside else sample.reach).get(pid, 0.0) for sample in samples for pid in sample.robots(platform)
    )
    return max(values, default=math.nan)
