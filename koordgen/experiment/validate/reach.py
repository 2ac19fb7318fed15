"""Reachsets of a fleet file's platforms on the way to a target at one offset: computed, compared and written."""

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
from koordgen.experiment.validate.probe import BadProbe, Probe, Start, Vector, collect_samples, platforms
from koordgen.experiment.validate.statistics import needed
from koordgen.experiment.validate.tube import EPSILON, GAMMA, Comparison, Reachset, compare, reachset_of

PICTURE, TABLE = "reachsets.png", "reachsets.txt"
PARTS = 3  # parts of the samples: the first for learning, the second for calibration, the third for the check


@dataclass(frozen=True)
class ReachsetRequest:
    """Request to compute reachsets of platforms from sampled paths.

    `offset`: position of the target relative to the nominal start (m, ENU).
    `epsilon`, `gamma`: with confidence 1 - gamma, at most a fraction epsilon of all paths leave a reachset.
    `start`: set of states from which the starts of paths are drawn.
    `seconds`: time for which each robot is observed. If None, it is the time that a robot needs for the offset at
        0.5 m/s, plus 4 s."""

    offset: Vector
    epsilon: float = EPSILON
    gamma: float = GAMMA
    seed: int = 0
    start: Start = field(default_factory=Start)
    seconds: float | None = None
    robots: int = 16  # number of robots in each simulation run; 1 if robots disturb each other

    @property
    def lasts(self) -> float:
        """Return the time for which each robot is observed, in seconds."""
        return round(4 + 2 * math.hypot(*self.offset), 1) if self.seconds is None else self.seconds


def probes(fleet_file: str, names: Sequence[str], asked: ReachsetRequest) -> list[Probe]:
    """Return the probes that sample the paths for reachsets, one for each platform in `names`.

    An empty `names` selects all platforms of the fleet file. Raises BadProbe, Rejected, ManifestError."""
    known = platforms(fleet_file)
    if unknown := [name for name in names if name not in known]:
        raise BadProbe(f"{fleet_file} has no platform {unknown[0]!r}", f"its platforms are: {', '.join(known)}")
    count = PARTS * needed(asked.epsilon, asked.gamma)
    wanted = [known[name] for name in names or known]
    return [Probe(p, asked.offset, count, asked.lasts, asked.start, asked.robots, asked.seed) for p in wanted]


def reachsets(
    fleet_file: str,
    names: Sequence[str],
    asked: ReachsetRequest,
    executor: Executor,
    folder: Path,
    report_progress: Callable[[str], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> list[Reachset]:
    """Compute the reachset of each platform in `names` from simulation runs, in the order of `names`.

    The runs of all platforms are executed together in a new folder. All platforms get equal random starts. Raises
    BadProbe, Rejected, ManifestError. Exceptions of `campaign.drive.execute_runs` are passed on."""
    found = collect_samples(probes(fleet_file, names, asked), executor, folder, report_progress, interrupted)
    return [reachset_of(samples, asked.epsilon, asked.gamma) for samples in found]


def comparisons(found: Sequence[Reachset]) -> list[Comparison]:
    """Compare each pair of reachsets. All reachsets must have the same offset from start to target."""
    return [compare(a, b) for a, b in combinations(found, 2)]


def write_files(found: Sequence[Reachset], folder: Path) -> list[Path]:
    """Write a JSON file for each reachset, a table that compares the reachsets, and a picture of all reachsets.

    The table is omitted for a single reachset. Return the files. Raises OSError."""
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
