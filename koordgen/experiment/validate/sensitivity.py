"""Discrepancy function: learned upper bound of the distance between two paths, given the distance of their starts.

Source: C. Fan, B. Qi, S. Mitra, M. Viswanathan, "DryVR: Data-Driven Verification and Compositional Reasoning for
Automotive Systems" (CAV 2017). The bound is |x1(t) - x0(t)| <= K_j exp(g_j (t - t_j)) |x1(0) - x0(0)| on the segment
[t_j, t_j+1]. In the paper, K_j and g_j are learned from m >= ln(1/gamma)/epsilon sampled pairs of paths.

This module differs from the paper in two respects:

1. K_j and g_j are learned from one part of the samples. A second part determines a single factor on the bound. So the
   statistical claim is about one threshold, which needs fewer samples than a claim about many parameters.
2. A distance of starts below `resolution` counts as `resolution`. If starts are closer, the paths differ because of
   noise and the planner's choices, not because of the starts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 1e-9  # smallest gain of a bound; gains must be positive, because their logarithm is used


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Discrepancy function with J segments of time: bounds the distance of two paths by gain * distance of starts.

    `edges` (J + 1,): times at which segments begin or end, in seconds.
    `gains` (J + 1,): the gain at each edge. Between two edges, the gain's logarithm is linear in time.
    `resolution`: smaller distances of starts count as this distance.
    `factor`: calibrated factor on all gains."""

    edges: Array
    gains: Array
    resolution: float
    factor: float = 1.0

    @property
    def rates(self) -> Array:
        """Return the exponential growth rate of the gain in each segment, in 1/s."""
        found: Array = np.diff(np.log(self.gains)) / np.diff(self.edges)
        return found

    def gain(self, times: Array) -> Array:
        """Return the gain at `times` (T,): the bound of the paths' distance is this gain * distance of the starts."""
        found: Array = self.factor * np.exp(np.interp(times, self.edges, np.log(self.gains)))
        return found

    def beyond(self, times: Array, apart: Array, away: Array) -> Array:
        """Return for each of n pairs of paths the largest quotient of the paths' distance and its bound over time.

        A quotient above 1 means that the pair exceeds the bound.
        `apart` (n, T): distance of the two paths at `times`, in metres.
        `away` (n,): distance of the two starts."""
        ratio = apart / np.maximum(away, self.resolution)[:, None] / self.gain(times)
        found: Array = ratio.max(axis=1)
        return found


def learned(times: Array, paths: Array, starts: Array, segment: float) -> Discrepancy:
    """Learn a discrepancy function that bounds the distance of all pairs of the given paths.

    `paths` (n, T, d): the paths, in metres, at `times` (T,), in seconds.
    `starts` (n, f): features of the start of each path.
    `segment`: length of a segment in seconds.
    The resolution is the largest distance of a start from its nearest neighbour."""
    edges = np.linspace(times[0], times[-1], max(1, round((times[-1] - times[0]) / segment)) + 1)
    away = np.linalg.norm(starts[:, None] - starts[None], axis=-1)
    resolution = float(np.where(np.eye(len(away)) > 0, np.inf, away).min(axis=1).max())
    most = np.zeros(len(times))
    for k in range(len(paths) - 1):
        apart = np.linalg.norm(paths[k + 1 :] - paths[k], axis=-1)
        most = np.maximum(most, (apart / np.maximum(away[k, k + 1 :], resolution)[:, None]).max(axis=0))
    # The gain at an edge is the larger of the maxima in the two adjacent segments. So the interpolation between two
    # edges is never below the observed gains.
    held = [most[(times >= low) & (times <= high)].max() for low, high in pairwise(edges)]
    gains = np.maximum(np.maximum([held[0], *held], [*held, held[-1]]), LEAST)
    return Discrepancy(edges, gains, resolution)


def nearest(starts: Array, centres: Array) -> tuple[NDArray[np.intp], Array]:
    """Return for each of `starts` (n, f) the index of the nearest of `centres` (c, f), and the distance to it."""
    away = np.linalg.norm(starts[:, None] - centres[None], axis=-1)
    return away.argmin(axis=1), away.min(axis=1)


def calibrated(found: Discrepancy, times: Array, apart: Array, away: Array) -> Discrepancy:
    """Increase the factor of a discrepancy function until it bounds the distances of the given pairs of paths.

    `apart` (n, T): distance of the two paths of each pair at `times`, in metres.
    `away` (n,): distance of the two starts of each pair.
    The pairs must be independent of the paths from which the function was learned."""
    return replace(found, factor=found.factor * max(1.0, float(found.beyond(times, apart, away).max())))
