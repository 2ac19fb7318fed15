"""Discrepancy function: learned bound of the distance of paths that begin close together.

C. Fan, B. Qi, S. Mitra, M. Viswanathan, "DryVR: Data-Driven Verification and Compositional Reasoning for Automotive
Systems" (CAV 2017): |x1(t) - x0(t)| <= K_j exp(g_j (t - t_j)) |x1(0) - x0(0)| on the segment [t_j, t_j+1], its
logarithm a separator that is linear in t, learned from m >= ln(1/gamma)/epsilon sampled pairs. Two things differ here.
The shape (K_j, g_j) is learned from one part of the samples, and only one factor on it from the others, because the
bound is that of a threshold: a separator with many parameters would need more samples. And distances of starts below
`resolution` count as `resolution`: there, noise and a planner's choices separate the paths, not the starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 1e-9  # smallest gain, since its logarithm is taken


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Discrepancy function.

    `edges` (J + 1,): ends of the segments in s; `gains` (J + 1,): K at each of them, whose logarithm is linear in time
    in between. `factor` multiplies all gains; `resolution` is a distance of starts."""

    edges: Array
    gains: Array
    resolution: float
    factor: float = 1.0

    @property
    def rates(self) -> Array:
        """Return g_j of each segment in 1/s."""
        found: Array = np.diff(np.log(self.gains)) / np.diff(self.edges)
        return found

    def gain(self, times: Array) -> Array:
        """Return K exp(g (t - t_j)) at `times` (T,), without a unit."""
        found: Array = self.factor * np.exp(np.interp(times, self.edges, np.log(self.gains)))
        return found

    def beyond(self, times: Array, apart: Array, away: Array) -> Array:
        """Return for pairs (n,) by which factor they exceed the bound at most; 1 is on the bound.

        `away` (n,): distance of the starts; `apart` (n, T): distance of the paths in metres."""
        ratio = apart / np.maximum(away, self.resolution)[:, None] / self.gain(times)
        found: Array = ratio.max(axis=1)
        return found


def learned(times: Array, ways: Array, starts: Array, segment: float) -> Discrepancy:
    """Learn the shape of a discrepancy function from all pairs among `ways`.

    `ways` (n, T, d) in m at `times` (T,) in s have the starts `starts` (n, f). Segments are `segment` s long. The
    resolution is the largest distance of a start from its nearest neighbour."""
    edges = np.linspace(times[0], times[-1], max(1, round((times[-1] - times[0]) / segment)) + 1)
    away = np.linalg.norm(starts[:, None] - starts[None], axis=-1)
    resolution = float(np.where(np.eye(len(away)) > 0, np.inf, away).min(axis=1).max())
    most = np.zeros(len(times))
    for k in range(len(ways) - 1):
        apart = np.linalg.norm(ways[k + 1 :] - ways[k], axis=-1)
        most = np.maximum(most, (apart / np.maximum(away[k, k + 1 :], resolution)[:, None]).max(axis=0))
    # A segment's end has the larger value of the two segments there, so that the line in between bounds all values.
    held = [most[(times >= low) & (times <= high)].max() for low, high in pairwise(edges)]
    gains = np.maximum(np.maximum([held[0], *held], [*held, held[-1]]), LEAST)
    return Discrepancy(edges, gains, resolution)


def nearest(starts: Array, centres: Array) -> tuple[NDArray[np.intp], Array]:
    """Return for each of `starts` (n, f) the index of the closest of `centres` (c, f), and its distance."""
    away = np.linalg.norm(starts[:, None] - centres[None], axis=-1)
    return away.argmin(axis=1), away.min(axis=1)


def calibrated(found: Discrepancy, times: Array, apart: Array, away: Array) -> Discrepancy:
    """Return the function with the least factor >= 1 that holds for these pairs, new to it."""
    return replace(found, factor=found.factor * max(1.0, float(found.beyond(times, apart, away).max())))
