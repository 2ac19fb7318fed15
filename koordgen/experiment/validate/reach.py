"""Reachsets as they are asked for: of platforms of a fleet file at one offset, side by side."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

from koordgen.experiment.campaign.crew import Crew
from koordgen.experiment.campaign.store import replace
from koordgen.experiment.validate.draw import drawn
from koordgen.experiment.validate.probe import BadProbe, Probe, Start, Vector, platforms, sampled
from koordgen.experiment.validate.statistics import needed
from koordgen.experiment.validate.tube import EPSILON, GAMMA, Comparison, Reachset, compared, reached

PICTURE, TABLE = "reachsets.png", "reachsets.txt"
PARTS = 3  # of the samples: to learn of, to calibrate on, to check on


@dataclass(frozen=True)
class Asked:
    """What reachsets are asked for: a target at `offset` (m, ENU), and what is claimed of ways to it. `seconds` each
    way is looked at; None: as long as a slow robot needs, at half a metre a second and 4 s to come to rest."""

    offset: Vector
    epsilon: float = EPSILON
    gamma: float = GAMMA
    seed: int = 0
    start: Start = field(default_factory=Start)
    seconds: float | None = None
    robots: int = 16  # in one run; 1 where robots of a platform disturb one another

    @property
    def lasts(self) -> float:
        """Seconds."""
        return round(4 + 2 * math.hypot(*self.offset), 1) if self.seconds is None else self.seconds


def probes(fleet_file: str, names: Sequence[str], asked: Asked) -> list[Probe]:
    """A probe for each platform of that name in the fleet file; none named: for all. Raises BadProbe, Rejected,
    ManifestError."""
    known = platforms(fleet_file)
    if unknown := [name for name in names if name not in known]:
        raise BadProbe(f"{fleet_file} has no platform {unknown[0]!r}", f"there are: {', '.join(known)}")
    count = PARTS * needed(asked.epsilon, asked.gamma)
    wanted = [known[name] for name in names or known]
    return [Probe(p, asked.offset, count, asked.lasts, asked.start, asked.robots, asked.seed) for p in wanted]


def reachsets(
    fleet_file: str,
    names: Sequence[str],
    asked: Asked,
    crew: Crew,
    folder: Path,
    tell: Callable[[str], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> list[Reachset]:
    """One for each platform, in the order of `names`; their runs are carried out together, in a new folder, with the
    same starts for all. Raises BadProbe, Rejected, ManifestError, and what `campaign.drive.carry_out` raises."""
    found = sampled(probes(fleet_file, names, asked), crew, folder, tell, interrupted)
    return [reached(samples, asked.epsilon, asked.gamma) for samples in found]


def comparisons(found: Sequence[Reachset]) -> list[Comparison]:
    """Each two of them, of one offset."""
    return [compared(a, b) for a, b in combinations(found, 2)]


def written(found: Sequence[Reachset], folder: Path) -> list[Path]:
    """A JSON file for each, their picture, and the table that compares them. Raises OSError."""
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
    return [*files, drawn(found, folder / PICTURE)]
