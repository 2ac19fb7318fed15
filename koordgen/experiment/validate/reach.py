"""Reachsets of the platforms of a fleet file for one offset, side by side."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from koordgen.experiment.campaign.executor import Executor
from koordgen.experiment.campaign.store import replace
from koordgen.experiment.validate.draw import draw_reachsets
from koordgen.experiment.validate.probe import BadProbe, Probe, Start, Vector, platforms, take_samples
from koordgen.experiment.validate.statistics import needed
from koordgen.experiment.validate.tube import EPSILON, GAMMA, Comparison, Reachset, compare, reachset_of

PICTURE, TABLE = "reachsets.png", "reachsets.txt"
PARTS = 3  # The samples are divided into this many parts: for learning, for calibration, and for the check.


@dataclass(frozen=True)
class ReachsetRequest:
    """Request for reachsets.

    `offset`: the target relative to the nominal start (m, ENU).
    `seconds`: duration of the observation of each path. If None, it is the time that a robot with half a metre per
        second needs, and 4 s to stop."""

    offset: Vector
    epsilon: float = EPSILON
    gamma: float = GAMMA
    seed: int = 0
    start: Start = field(default_factory=Start)
    seconds: float | None = None
    robots: int = 16  # number of robots in one run; 1 if robots of a platform disturb one another

    @property
    def lasts(self) -> float:
        """Return the duration of the observation of each path, in seconds."""
        return round(4 + 2 * math.hypot(*self.offset), 1) if self.seconds is None else self.seconds


def probes(fleet_file: str, names: Sequence[str], asked: ReachsetRequest) -> list[Probe]:
    """Return a probe for each named platform of the fleet file; for all platforms if none is named.

    Raises BadProbe, Rejected, ManifestError."""
    known = platforms(fleet_file)
    if unknown := [name for name in names if name not in known]:
        raise BadProbe(f"{fleet_file} has no platform {unknown[0]!r}", f"there are: {', '.join(known)}")
    count = PARTS * needed(asked.epsilon, asked.gamma)
    wanted = [known[name] for name in names or known]
    return [Probe(p, asked.offset, count, asked.lasts, asked.start, asked.robots, asked.seed) for p in wanted]


def reachsets(
    fleet_file: str,
    names: Sequence[str],
    asked: ReachsetRequest,
    executor: Executor,
    folder: Path,
    tell: Callable[[str], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> list[Reachset]:
    """Return one reachset per platform, in the order of `names`.

    The runs of all platforms are executed together in a new folder, with the same starts for all platforms. Raises
    BadProbe, Rejected, ManifestError, and what `campaign.drive.execute_runs` raises."""
    found = take_samples(probes(fleet_file, names, asked), executor, folder, tell, interrupted)
    return [reachset_of(samples, asked.epsilon, asked.gamma) for samples in found]


def comparisons(found: Sequence[Reachset]) -> list[Comparison]:
    """Return the comparison of each pair of reachsets. All of them must have the same offset."""
    return [compare(a, b) for a, b in combinations(found, 2)]


def write_files(found: Sequence[Reachset], folder: Path) -> list[Path]:
    """Write a JSON file for each reachset, a picture of all, and the table that compares them.

    Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for one in found:
        file = folder / f"{re.sub(r'[^a-z0-9]+', '-', one.platform.lower()).strip('-')}.json"
        replace(file, json.dumps(one.json()) + "\n")
        files.append(file)
    tables = [comparison.text() for comparison in comparisons(found)]
    if tables:
        replace(folder / TABLE, "\n".join(tables))
        files.append(folder / TABLE)
    return [*files, draw_reachsets(found, folder / PICTURE)]
