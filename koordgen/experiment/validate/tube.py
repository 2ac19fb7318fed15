"""Reachsets: the positions that robots of a platform can have on the path to a target, as boxes over time.

A reachset is computed from sampled paths, following DryVR (sensitivity.py). The first part of the samples gives a tube
around all its paths. The tube is inflated by the distance that a path can have from the nearest sampled path, times a
factor. A second part of the samples calibrates the factor: it is the least factor that keeps all paths of this part in
the tube.

The factor is a single threshold, so `statistics.needed` bounds whole paths: with confidence 1 - gamma, at most a
fraction epsilon of all paths from random starts ever leave the tube. This is the holdout method (E. Dietrich,
R. Devonport, S. Tu, M. Arcak, "Data-Driven Reachability with Scenario Optimization and the Holdout Method",
arXiv:2504.06541, 2025). The claim is about the simulator and the drawn starts, not about real robots.

Frame: ENU, metres, with the origin at the nominal start. Times are in seconds since the target was commanded.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koordgen.experiment.validate.probe import Samples, Start, Vector
from koordgen.experiment.validate.sensitivity import Discrepancy, calibrated, learned, nearest
from koordgen.experiment.validate.statistics import needed

Array = NDArray[np.float64]
FORMAT = "koord-reachset/1"
EPSILON, GAMMA = 0.05, 0.05  # defaults of the options of `koordgen validate`
STEP = 0.05  # longest time that one box of a reachset covers, in seconds
SEGMENT = 0.25  # length of the segments of the discrepancy function, in seconds

# Weights in the distance of two starts: VELOCITY, in s, for velocities; HEADING, in m, for unit vectors of heading.
VELOCITY, HEADING = 1.0, 1.0

# Number of sampled paths that a reachset keeps for pictures, from the shortest path to the longest path.
SHOWN = 24
SLOW = 0.05  # a robot faster than this at the end of the observation counts as moving, in m/s
MOST_BOXES = 100  # largest number of boxes in the computation of a volume; more boxes are first joined


@dataclass(frozen=True)
class Observed:
    """Extreme values of all sampled paths. Distances are in metres.

    `overshoot`: largest distance beyond the target, in the direction from start to target; negative if none passed it.
    `lateral`: largest horizontal distance from the straight line between start and target.
    `excess`: largest distance outside the box from the robot's own start to the target.
    `moving`: fraction of the robots that still moved at the end of the observation."""

    overshoot: float
    lateral: float
    excess: float
    moving: float


@dataclass(frozen=True, eq=False)
class Reachset:
    """Reachset: J boxes that contain a robot's positions over time, on the way from its start to a target.

    While edges[k] <= t <= edges[k + 1], the robot is in the box from lower[k] to upper[k].

    `offset`: position of the target relative to the nominal start (m, ENU).
    `lower`, `upper` (J, 3): opposite corners of the boxes.
    `ahead` (J, 2): least and greatest horizontal position in the direction of the offset.
    `aside` (J, 2): least and greatest horizontal position to the left of the offset.
    `samples`: numbers of sampled paths for learning, for calibration and for the check.
    `covered`: fraction of the paths for the check that never left the boxes.
    `pairs_covered`: fraction of the paths for the check that satisfied the discrepancy function's bound.
    `inflated`: calibrated factor by which the boxes were inflated.
    `paths` (w, J + 1, 3): some sampled paths: the positions at the times `edges`."""

    platform: str
    target: str
    fidelity: str
    offset: Vector
    start: Start
    delta: float
    seed: int
    edges: Array
    lower: Array
    upper: Array
    ahead: Array
    aside: Array
    sensitivity: Discrepancy
    epsilon: float
    gamma: float
    samples: tuple[int, int, int]
    covered: float
    pairs_covered: float
    inflated: float
    observed: Observed
    paths: Array

    @property
    def overshoot(self) -> float:
        """Return the horizontal distance by which the reachset extends beyond the target, in metres.

        The distance is measured in the direction from start to target; negative if the reachset ends before the
        target."""
        return float(self.ahead.max() - math.hypot(*self.offset[:2]))

    @property
    def lateral(self) -> float:
        """Return the reachset's largest horizontal distance from the line between start and target, in metres."""
        return float(np.abs(self.aside).max())

    def json(self) -> dict[str, Any]:
        """Return the reachset as a JSON object, whose format is described in docs/reference/validate.md.

        Lengths and times in arrays are rounded to four decimals (m, s)."""
        found = {k: v for k, v in vars(self).items() if k not in _ARRAYS}
        found |= {k: np.round(getattr(self, k), 4).tolist() for k in _ARRAYS if k != "sensitivity"}
        own = self.sensitivity
        gains = {"edges": _listed(own.edges), "gains": _listed(own.gains), "rates": _listed(own.rates)}
        found |= {"start": asdict(self.start), "observed": asdict(self.observed)}
        found["sensitivity"] = {**gains, "resolution": own.resolution, "factor": own.factor}
        return {"format": FORMAT, **found}


_ARRAYS = ("edges", "lower", "upper", "ahead", "aside", "paths", "sensitivity")


def _listed(values: Array) -> list[float]:
    return [float(f"{v:.6g}") for v in values]


def from_json(value: dict[str, Any]) -> Reachset:
    """Return the reachset that a JSON object encodes. Raises ValueError if the object encodes no reachset."""
    try:
        if value["format"] != FORMAT:
            raise ValueError(f"the format is {value['format']!r}, but {FORMAT!r} is expected")
        own = {k: v for k, v in value.items() if k != "format"}
        own |= {k: np.array(own[k], dtype=float) for k in _ARRAYS if k != "sensitivity"}
        gains = {k: v for k, v in own["sensitivity"].items() if k != "rates"}
        gains |= {k: np.array(gains[k], dtype=float) for k in ("edges", "gains")}
        own |= {"sensitivity": Discrepancy(**gains), "observed": Observed(**own["observed"])}
        start = {**own["start"], "after": tuple(own["start"]["after"])}
        own |= {"start": Start(**start), "offset": tuple(own["offset"]), "samples": tuple(own["samples"])}
        found = Reachset(**own)
        if not len(found.edges) == len(found.lower) + 1 == len(found.upper) + 1 or found.lower.shape[1:] != (3,):
            raise ValueError(f"{len(found.edges)} edges do not fit boxes of shape {found.lower.shape}")
        return found
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the JSON object is no reachset: {type(error).__name__}: {error}") from None


def features(starts: Array) -> Array:
    """Map starts (n, 7) to points (n, 8), so that the distance of two starts is a Euclidean distance.

    The coordinates are position (m), weighted velocity, and heading as a weighted unit vector."""
    yaw = starts[:, 6:7]
    return np.hstack([starts[:, :3], VELOCITY * starts[:, 3:6], HEADING * np.cos(yaw), HEADING * np.sin(yaw)])


@dataclass(frozen=True, eq=False)
class Tube:
    """Tube around sampled paths: J boxes with `a` axes between the times `edges`, and their coverage of new paths."""

    edges: Array
    lower: Array
    upper: Array
    sensitivity: Discrepancy
    inflated: float
    covered: float
    pairs_covered: float


def tube(times: Array, paths: Array, starts: Array, each: int, step: float, axes: Array) -> Tube:
    """Learn a tube of boxes that contains sampled paths, calibrate it, and check it with new paths.

    `paths` (n, T, d): the paths at evenly spaced `times` (T,).
    `starts` (n, f): features of the start of each path.
    `each`: number of paths for the check, and number of paths for calibration. The last `each` paths are for the check,
        the `each` paths before them for calibration, and all other paths for learning.
    `step`: time that one box covers, in seconds.
    `axes` (d, a): unit vectors along which boxes extend.
    Raises ValueError if there are too few paths."""
    first = len(paths) - 2 * each
    if first < 2:
        raise ValueError(f"{len(paths)} samples are too few; at least {2 * each + 2} are needed")
    found = learned(times, paths[:first], starts[:first], SEGMENT)
    along = paths @ axes
    low, high = along[:first].min(axis=0), along[:first].max(axis=0)
    radius = found.gain(times) * found.resolution
    held, checked = slice(first, first + each), slice(first + each, None)
    apart, away = _pairs(paths[held], starts[held], paths[:first], starts[:first])
    out = np.maximum(np.maximum(low - along[held], along[held] - high), 0.0).max(axis=2)
    inflated = float((out / radius).max())
    low, high = low - (inflated * radius)[:, None], high + (inflated * radius)[:, None]
    inside = ((low <= along[checked]) & (along[checked] <= high)).all(axis=(1, 2))
    sure = calibrated(found, times, apart, away)
    fresh = sure.beyond(times, *_pairs(paths[checked], starts[checked], paths[:first], starts[:first])) <= 1
    edges, lower, upper = _boxes(times, low, high, step)
    return Tube(edges, lower, upper, sure, inflated, float(inside.mean()), float(fresh.mean()))


def _pairs(paths: Array, starts: Array, centres: Array, at: Array) -> tuple[Array, Array]:
    """Pair each path of `paths` with the path of `centres` that has the nearest start.

    Return for each pair the distance of the two paths over time, and the distance of the two starts."""
    which, away = nearest(starts, at)
    return np.linalg.norm(paths - centres[which], axis=2), away


def _boxes(times: Array, low: Array, high: Array, step: float) -> tuple[Array, Array, Array]:
    """Join boxes at single times into boxes that each cover a time step. Return the times at which steps begin or end.

    `low`, `high` (T, d): lower and upper corner of the box at each time.
    `step`: duration of a time step in seconds.
    Also return the lower and the upper corners of the joined boxes."""
    stride = max(1, round(step / (times[1] - times[0])))
    first = np.arange(0, len(times) - 1, stride)
    last = np.minimum(first + stride, len(times) - 1)
    spans = [slice(a, b + 1) for a, b in zip(first, last, strict=True)]
    lower = np.array([low[span].min(axis=0) for span in spans])
    upper = np.array([high[span].max(axis=0) for span in spans])
    return times[np.append(first, last[-1])], lower, upper


def reachset_of(samples: Samples, epsilon: float = EPSILON, gamma: float = GAMMA) -> Reachset:
    """Compute a reachset from the sampled paths of a probe. Raises ValueError if there are too few samples."""
    probe, each = samples.probe, needed(epsilon, gamma)
    platform = probe.platform
    step = platform.delta / math.ceil(platform.delta / STEP)
    u, left = above(probe.offset)
    axes = np.vstack([np.eye(3), u, left]).T
    found = tube(samples.times, samples.positions, features(samples.starts), each, step, axes)
    count = len(samples.positions)
    farthest = np.argsort((samples.positions @ u).max(axis=1))
    shown = farthest[np.linspace(0, count - 1, min(SHOWN, count)).round().astype(int)]
    ahead, aside = (np.stack([found.lower[:, k], found.upper[:, k]], axis=1) for k in (3, 4))
    at = np.minimum(np.searchsorted(samples.times, found.edges - 1e-9), len(samples.times) - 1)
    return Reachset(
        platform.name, platform.target, platform.fidelity, probe.offset, probe.start, platform.delta, probe.seed,
        found.edges, found.lower[:, :3], found.upper[:, :3], ahead, aside, found.sensitivity, epsilon, gamma,
        (count - 2 * each, each, each), found.covered, found.pairs_covered, found.inflated, _observed(samples),
        samples.positions[shown][:, at],
    )  # fmt: skip


def above(offset: Vector) -> tuple[Array, Array]:
    """Return two horizontal unit vectors: in the direction of `offset`, and to the left of this direction."""
    x, y = np.array(offset[:2]) / math.hypot(*offset[:2])
    return np.array([x, y, 0.0]), np.array([-y, x, 0.0])


def _observed(samples: Samples) -> Observed:
    paths, offset = samples.positions, np.array(samples.probe.offset)
    u, left = above(samples.probe.offset)
    corner = paths[:, :1]
    low, high = np.minimum(corner, offset), np.maximum(corner, offset)
    out = np.maximum(low - paths, paths - high).max()
    back = round(0.1 / (samples.times[1] - samples.times[0]))
    speed = np.linalg.norm(paths[:, -1] - paths[:, -1 - back], axis=1) / 0.1
    ahead = float((paths @ u).max() - math.hypot(*offset[:2]))
    return Observed(ahead, float(np.abs(paths @ left).max()), max(0.0, float(out)), float((speed > SLOW).mean()))


@dataclass(frozen=True)
class Figures:
    """Sizes of one reachset, in m, m^2 and m^3.

    `area`, `volume`: size of the union of all boxes.
    `area_delta`, `volume_delta`: size of the union of the boxes during one round; the maximum over all times.
    `overshoot`: horizontal distance by which the reachset extends beyond the target.
    `lateral`: largest horizontal distance from the line between start and target."""

    area_delta: float
    area: float
    volume_delta: float
    volume: float
    overshoot: float
    lateral: float


@dataclass(frozen=True)
class Comparison:
    """Comparison of the reachsets of two platforms for targets at the same offset."""

    platforms: tuple[str, str]
    offset: Vector
    figures: tuple[Figures, Figures]

    def json(self) -> dict[str, Any]:
        return asdict(self)

    def text(self) -> str:
        """Return the comparison as a text table, with a row for each size and a column for each platform."""
        a, b = map(asdict, self.figures)
        rows = [f"{'':22}{self.platforms[0]:>12}{self.platforms[1]:>12}"]
        rows += [f"{_LABELS[key]:22}{a[key]:12.3f}{b[key]:12.3f}" for key in _LABELS]
        return "\n".join(rows) + "\n"


_LABELS = {
    "area_delta": "area in a delta, m^2",
    "area": "area, m^2",
    "volume_delta": "volume in a delta, m^3",
    "volume": "volume, m^3",
    "overshoot": "beyond the target, m",
    "lateral": "to a side, m",
}


def figures(found: Reachset) -> Figures:
    """Compute the sizes of a reachset from boxes. Their axes: along the offset, to the left of it, z."""
    lower = np.stack([found.ahead[:, 0], found.aside[:, 0], found.lower[:, 2]], axis=1)
    upper = np.stack([found.ahead[:, 1], found.aside[:, 1], found.upper[:, 2]], axis=1)
    window = max(1, round(found.delta / (found.edges[1] - found.edges[0])))
    starts = range(max(1, len(lower) - window + 1))
    areas = [union(lower[k : k + window, :2], upper[k : k + window, :2]) for k in starts]
    volumes = [union(lower[k : k + window], upper[k : k + window]) for k in starts]
    area = union(lower[:, :2], upper[:, :2])
    return Figures(max(areas), area, max(volumes), union(*_fewer(lower, upper)), found.overshoot, found.lateral)


def compare(a: Reachset, b: Reachset) -> Comparison:
    """Compare two reachsets. Raises ValueError if their offsets differ."""
    if a.offset != b.offset:
        raise ValueError(f"the offsets differ: {a.platform} moved by {a.offset}, {b.platform} by {b.offset}")
    return Comparison((a.platform, b.platform), a.offset, (figures(a), figures(b)))


def _fewer(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Join consecutive boxes into their smallest common box, so that at most MOST_BOXES boxes remain."""
    cuts = np.arange(0, len(lower), math.ceil(len(lower) / MOST_BOXES))
    return np.minimum.reduceat(lower, cuts), np.maximum.reduceat(upper, cuts)


def union(lower: Array, upper: Array) -> float:
    """Return the area (d = 2) or volume (d = 3) of the union of J boxes.

    `lower`, `upper` (J, d): corners of the boxes. The faces of all boxes form a grid; the cells that a box covers are
    added up."""
    faces = [np.unique(np.concatenate([lower[:, k], upper[:, k]])) for k in range(lower.shape[1])]
    filled = np.zeros([len(f) - 1 for f in faces], dtype=bool)
    for low, high in zip(lower, upper, strict=True):
        filled[tuple(slice(*np.searchsorted(f, (a, b))) for f, a, b in zip(faces, low, high, strict=True))] = True
    cells: Array = filled.astype(float)
    for face in reversed(faces):
        cells = cells @ np.diff(face)
    return float(cells)
