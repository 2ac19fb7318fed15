"""Discrepancy function: learned bound of the distance between paths that begin close together.

C. Fan, B. Qi, S. Mitra, M. Viswanathan, "DryVR: Data-Driven Verification and Compositional Reasoning for Automotive
Systems" (CAV 2017): |x1(t) - x0(t)| <= K_j exp(g_j (t - t_j)) |x1(0) - x0(0)| on the segment [t_j, t_j+1]. The
logarithm of the bound is linear in t; it is learned as a separator from m >= ln(1/gamma)/epsilon sampled pairs of
paths.

Two things differ from the paper:

1. The shape (K_j, g_j) is learned from one part of the samples. The other part determines only one factor on the shape.
  So the statistical bound is that of a single threshold. A separator with many parameters would need more samples. 2. A
  distance of starts below `resolution` counts as `resolution`. Below it, noise and a planner's choices separate the
  paths, not the distance of their starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 1e-9  # smallest gain; gains must be positive, since their logarithm is taken


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Discrepancy function with J segments.

    `edges` (J + 1,): ends of the segments, in seconds.
    `gains` (J + 1,): the gain K at each edge. Between two edges, its logarithm is linear in time.
    `resolution`: smallest distance of starts that is distinguished.
    `factor`: multiplies all gains."""

    edges: Array
    gains: Array
    resolution: float
    factor: float = 1.0

    @property
    def rates(self) -> Array:
        """Return the growth rate g_j of each segment, in 1/s."""
        found: Array = np.diff(np.log(self.gains)) / np.diff(self.edges)
        return found

    def gain(self, times: Array) -> Array:
        """Return the gain K exp(g (t - t_j)) at `times` (T,). A gain has no unit."""
        found: Array = self.factor * np.exp(np.interp(times, self.edges, np.log(self.gains)))
        return found

    def beyond(self, times: Array, apart: Array, away: Array) -> Array:
        """Return for each of n pairs of paths the largest factor by which it exceeds the bound.

        A factor of 1 means that the pair reaches the bound.
        `away` (n,): distance of the starts.
        `apart` (n, T): distance of the paths at `times`, in metres."""
        ratio = apart / np.maximum(away, self.resolution)[:, None] / self.gain(times)
        found: Array = ratio.max(axis=1)
        return found


def learned(times: Array, ways: Array, starts: Array, segment: float) -> Discrepancy:
    """Learn the shape of a discrepancy function from all pairs of paths.

    `ways` (n, T, d): the paths, in metres, at `times` (T,), in seconds.
    `starts` (n, f): the starts of the paths.
    `segment`: length of a segment in seconds.
    The resolution becomes the largest distance between a start and its nearest neighbour."""
    edges = np.linspace(times[0], times[-1], max(1, round((times[-1] - times[0]) / segment)) + 1)
    away = np.linalg.norm(starts[:, None] - starts[None], axis=-1)
    resolution = float(np.where(np.eye(len(away)) > 0, np.inf, away).min(axis=1).max())
    most = np.zeros(len(times))
    for k in range(len(ways) - 1):
        apart = np.linalg.norm(ways[k + 1 :] - ways[k], axis=-1)
        most = np.maximum(most, (apart / np.maximum(away[k, k + 1 :], resolution)[:, None]).max(axis=0))
    # An edge gets the larger of the maxima in its two segments. So the line between two edges bounds all values between
    # them.
    held = [most[(times >= low) & (times <= high)].max() for low, high in pairwise(edges)]
    gains = np.maximum(np.maximum([held[0], *held], [*held, held[-1]]), LEAST)
    return Discrepancy(edges, gains, resolution)


def nearest(starts: Array, centres: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the nearest of `centres` (c, f) for each of `starts` (n, f).

    The result is the index of the nearest centre, and the distance to it."""
    away = np.linalg.norm(starts[:, None] - centres[None], axis=-1)
    return away.argmin(axis=1), away.min(axis=1)


def calibrated(found: Discrepancy, times: Array, apart: Array, away: Array) -> Discrepancy:
    """Return the function with the least factor >= 1 with which it bounds these pairs.

    The pairs must not be those from which the function was learned."""
    return replace(found, factor=found.factor * max(1.0, float(found.beyond(times, apart, away).max())))
