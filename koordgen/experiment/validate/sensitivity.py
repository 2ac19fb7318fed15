"""How far apart two ways can get that began close together: a discrepancy function, learned from samples.

C. Fan, B. Qi, S. Mitra, M. Viswanathan, "DryVR: Data-Driven Verification and Compositional Reasoning for Automotive
Systems" (CAV 2017): |x1(t) - x0(t)| <= K_j exp(g_j (t - t_j)) |x1(0) - x0(0)| on the segment [t_j, t_j+1], its
logarithm a separator that is linear in t, learned from m >= ln(1/gamma)/epsilon sampled pairs. Two things differ here.
The shape (K_j, g_j) is made of one part of the samples, and one factor on it, alone, of others, because the bound is
that of a threshold: a separator with many parameters would need more samples. And distances of starts less than
`resolution` count as that: below it noise and a planner's choices part the ways, not the starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 1e-9  # a gain: its logarithm is taken


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """How far apart: `edges` (J + 1,) s are the segments' ends, `gains` (J + 1,) K at each of them; between two the
    logarithm is linear in time. `factor` multiplies all of them, `resolution` is in the starts' measure."""

    edges: Array
    gains: Array
    resolution: float
    factor: float = 1.0

    @property
    def rates(self) -> Array:
        """g_j of each segment, 1/s."""
        found: Array = np.diff(np.log(self.gains)) / np.diff(self.edges)
        return found

    def gain(self, times: Array) -> Array:
        """K exp(g (t - t_j)) at `times` (T,), without a unit."""
        found: Array = self.factor * np.exp(np.interp(times, self.edges, np.log(self.gains)))
        return found

    def beyond(self, times: Array, apart: Array, away: Array) -> Array:
        """Of pairs (n,) whose starts are `away` (n,) from one another and whose ways are `apart` (n, T) metres: the
        most by which each is over, as a factor; 1 is on the bound."""
        ratio = apart / np.maximum(away, self.resolution)[:, None] / self.gain(times)
        found: Array = ratio.max(axis=1)
        return found


def learned(times: Array, ways: Array, starts: Array, segment: float) -> Discrepancy:
    """The shape, of all pairs among `ways` (n, T, d) m at `times` (T,) s with `starts` (n, f); segments are `segment` s
    long. Its resolution is how far a start is from the nearest other, at most."""
    edges = np.linspace(times[0], times[-1], max(1, round((times[-1] - times[0]) / segment)) + 1)
    away = np.linalg.norm(starts[:, None] - starts[None], axis=-1)
    resolution = float(np.where(np.eye(len(away)) > 0, np.inf, away).min(axis=1).max())
    most = np.zeros(len(times))
    for k in range(len(ways) - 1):
        apart = np.linalg.norm(ways[k + 1 :] - ways[k], axis=-1)
        most = np.maximum(most, (apart / np.maximum(away[k, k + 1 :], resolution)[:, None]).max(axis=0))
    # The segments' ends have the most of both that meet there, so that the line between two is over all within.
    held = [most[(times >= low) & (times <= high)].max() for low, high in pairwise(edges)]
    gains = np.maximum(np.maximum([held[0], *held], [*held, held[-1]]), LEAST)
    return Discrepancy(edges, gains, resolution)


def nearest(starts: Array, centres: Array) -> tuple[NDArray[np.intp], Array]:
    """For each of `starts` (n, f) which of `centres` (c, f) is closest, and how far it is."""
    away = np.linalg.norm(starts[:, None] - centres[None], axis=-1)
    return away.argmin(axis=1), away.min(axis=1)


def calibrated(found: Discrepancy, times: Array, apart: Array, away: Array) -> Discrepancy:
    """With the least factor, from 1 on, at which it holds for these pairs, which are others than it was learned of."""
    return replace(found, factor=found.factor * max(1.0, float(found.beyond(times, apart, away).max())))
