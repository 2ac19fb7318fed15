"""Sample: the content of one run's `windows.jsonl` (targets/sim/judging/windows.py)."""

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
FINISHED = ("completed", "stopped")  # outcomes of a mission that was observed to its end
HELD, VIOLATED, NO_VALUE, UNKNOWN, OUT, UNASKED = "hvnuo-"


@dataclass(frozen=True)
class SampledAssumption:
    """An assumption of the program: its module, its line, and its index in the run's records."""

    index: int
    module: str
    line: int


@dataclass
class AssumptionObservation:
    """Observation of one assumption on one robot in one run.

    `windows`: outcome -> number of windows.
    `first`: time of the first violation, in seconds since round 1.
    `worst`: the farthest breach in a violated window."""

    windows: Counter[str] = field(default_factory=Counter)
    first: float | None = None
    worst: BoxBreach | None = None
    breaches: Counter[str] = field(default_factory=Counter)  # kind of breach -> number of violated windows
    # kind of breach -> largest distance from the box in one window, in metres
    farthest: dict[str, float] = field(default_factory=dict)
    # kind of breach -> largest sum over consecutive windows, in metres
    together: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RunSample:
    """Sample: the observations of one run.

    `platforms`, `names`: the platform and the name of each robot, by pid.
    `far`: largest distance of a robot from its target while the robot was outside of the box, in metres, by pid.
    `reach`: largest distance of a robot from its target at any time, in metres, by pid."""

    run: int
    seed: int
    ended: str
    body: str
    names: tuple[str, ...]
    platforms: tuple[str, ...]
    assumptions: tuple[SampledAssumption, ...]
    unchecked: tuple[tuple[int, str], ...]  # (line, reason) of assumptions that cannot be evaluated
    seen: Mapping[tuple[int, int], AssumptionObservation]
    breaches: tuple[BoxBreach, ...]
    far: Mapping[int, float]
    reach: Mapping[int, float]

    def robots(self, platform: str) -> list[int]:
        """Return the pids of a platform."""
        return [pid for pid, own in enumerate(self.platforms) if own == platform]

    def of(self, assumption: int, platform: str) -> list[AssumptionObservation]:
        """Return the observations of an assumption on all robots of a platform."""
        return [self.seen[assumption, pid] for pid in self.robots(platform)]


def read(folder: Path, run: int) -> RunSample | None:
    """Read the sample in a run's folder; None if the run did not end regularly. Raises OSError."""
    try:
        with (folder / FILE).open(encoding="utf-8") as file:
            lines = [json.loads(line) for line in file]
        if lines[0]["format"] != FORMAT or "end" not in lines[-1]:
            return None
        return _sample(run, lines[0], lines[1:-1], lines[-1]["end"])
    except FileNotFoundError:
        return None
    except (ValueError, LookupError, TypeError):  # the file is cut off, or was not written by a run
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
    """Return the largest distance, in metres, of a platform's robots from their target in any run.

    If `outside`, only times count at which the robot was outside of the box. Returns 0 if there are no such times."""
    values = (
        (sample.far if outside else sample.reach).get(pid, 0.0) for sample in samples for pid in sample.robots(platform)
    )
    return max(values, default=math.nan)
