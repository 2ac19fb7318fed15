"""Wind: a mean wind plus gusts, different for each body."""

from __future__ import annotations

import math

import numpy as np

from koordgen.runtime.trace.schema import Wind
from targets.sim.physics.rigid import Array


class Air:
    """Wind at each of `count` bodies.

    A gust is a first-order Gauss-Markov process, the longitudinal spectrum of Dryden's model (MIL-F-8785C), stepped
    exactly. The same seed gives the same gusts."""

    def __init__(self, wind: Wind, seed: int, count: int) -> None:
        self._dice = np.random.Generator(np.random.PCG64(seed))
        self._gusts = np.zeros((3, count))
        self.change(wind)

    def change(self, wind: Wind) -> None:
        """Change the wind. Gusts continue into those of the new wind."""
        self._wind = wind
        self._mean = np.array(wind.mean, dtype=float)[:, None]

    def step(self, seconds: float) -> Array | None:
        """Return the velocities (m/s) of the air at the bodies, (3, n) or (3, 1); None without wind."""
        wind = self._wind
        if wind.gust <= 0.0:
            return self._mean if any(wind.mean) else None
        kept = math.exp(-seconds / wind.correlation)
        self._gusts *= kept
        self._gusts += self._dice.standard_normal(self._gusts.shape) * (wind.gust * math.sqrt(1.0 - kept * kept))
        return self._mean + self._gusts
