"""Screening of properties: many observations of a fleet as arrays (see runtime/program/property.py).

A number or truth value is an array over (observations, first robot, second robot, ...), of length 1 where it does not
depend on them. A Point has its coordinates as first axis. Comparisons leave a relative MARGIN for rounding, so a
screened property surely holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koordgen.runtime.program.property import UNKNOWN
from koordgen.runtime.values.points import Point

MARGIN = 1e-9
MOST_AXES = 3  # axes of robots
Array = NDArray[Any]


class Batch:
    """Observations of one round, as arrays.

    `measured`: an array (observations, robots, 3) for each port that the simulator measures. `values`: values of the
    whole round, by name as in Truth."""

    def __init__(self, observations: int, n_sys: int, measured: Mapping[str, Array], values: Mapping[str, Any]) -> None:
        self.observations, self.n_sys = observations, n_sys
        self._measured, self._values = measured, values
        self._found: dict[tuple[str, int], Array] = {}

    def each(self, name: str, axis: int) -> Array:
        """Return a variable or port of each robot, along an axis.

        Raises ValueError or TypeError if one is unknown."""
        found = self._found.get((name, axis))
        if found is None:
            found = self._found[name, axis] = self._each(name, axis)
        return found

    def _each(self, name: str, axis: int) -> Array:
        if name in self._measured:
            return self._along(np.moveaxis(self._measured[name], 2, 0), axis)
        return self._along(_array(self._values[name]), axis)

    def _along(self, values: Array, axis: int) -> Array:
        """Reshape (..., observations, robots) so that robots have their own axis."""
        shape = [1] * MOST_AXES
        shape[axis] = self.n_sys
        return values.reshape(*values.shape[:-1], *shape)

    def one(self, name: str) -> Array:
        """Return the values of an allwrite variable."""
        return self._along(np.repeat(_array([self._values[name]]), self.n_sys, axis=-1), 0)

    def robot(self, axis: int) -> Array:
        return self._along(np.arange(self.n_sys)[None], axis)

    def point(self, *of: Any) -> Array:
        """Return a Point as an array, or one of its coordinates."""
        if len(of) == 1:
            return np.array([of[0].x, of[0].y, of[0].z]).reshape(3, 1, *[1] * MOST_AXES)
        return np.stack(np.broadcast_arrays(*[np.asarray(c, dtype=float) for c in of]))

    def distance(self, p: Array, q: Array) -> Array:
        d = p - q
        found: Array = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        return found

    def over(self, a: Any, b: Any) -> Array:
        """Return a > b, with a margin."""
        found: Array = a - b > MARGIN * (1 + np.abs(a) + np.abs(b))
        return found

    def apart(self, a: Any, b: Any) -> Array:
        return self.over(a, b) | self.over(b, a)

    def in_rect(self, p: Array, a: Array, b: Array) -> Array:
        lo, hi = np.minimum(a, b), np.maximum(a, b)
        return np.asarray((self.over(p, lo) & self.over(hi, p)).all(axis=0))

    def out_of_rect(self, p: Array, a: Array, b: Array) -> Array:
        lo, hi = np.minimum(a, b), np.maximum(a, b)
        return np.asarray((self.over(lo, p) | self.over(p, hi)).any(axis=0))

    def in_ball(self, p: Array, center: Array, radius: Any) -> Array:
        return self.over(radius, self.distance(p, center))

    def out_of_ball(self, p: Array, center: Array, radius: Any) -> Array:
        return self.over(self.distance(p, center), radius)

    def both(self, a: Any, b: Any) -> Any:
        return np.logical_and(a, b)

    def either(self, a: Any, b: Any) -> Any:
        return np.logical_or(a, b)

    def no(self, a: Any) -> Any:
        return np.logical_not(a)

    def every(self, axis: int, a: Any) -> Any:
        return np.all(self._whole(a), axis=axis + 1, keepdims=True)

    def some(self, axis: int, a: Any) -> Any:
        return np.any(self._whole(a), axis=axis + 1, keepdims=True)

    def _whole(self, a: Any) -> Array:
        return np.asarray(a).reshape(np.shape(a) or (1,) * (1 + MOST_AXES))

    def unsure_of(self, screening: Callable[[Any], Any]) -> list[tuple[int, int]]:
        """Return (observation, pid) of all pairs that a screening does not decide.

        Robots are on the first axis."""
        try:
            found = np.broadcast_to(screening(self), (self.observations, self.n_sys, *[1] * (MOST_AXES - 1)))
        except (ValueError, TypeError, LookupError, AttributeError):
            return [(k, pid) for k in range(self.observations) for pid in range(self.n_sys)]
        return [(int(k), int(pid)) for k, pid, *_ in np.argwhere(~found)]

    def unsure(self, screening: Callable[[Any], Any]) -> list[int]:
        """Return the observations that a screening does not decide; all of them if a value is unknown."""
        try:
            found = np.broadcast_to(np.asarray(screening(self)).reshape(-1), (self.observations,))
        except (ValueError, TypeError, LookupError, AttributeError):
            return list(range(self.observations))
        return [int(k) for k in np.flatnonzero(~found)]


def _array(values: Sequence[Any]) -> Array:
    """Return an array (1, robots), with coordinates in front for points.

    Raises ValueError if a value is unknown."""
    if UNKNOWN in values:
        raise ValueError
    if isinstance(values[0], Point):
        return np.array([[v.x, v.y, v.z] for v in values], dtype=float).T[:, None, :]
    if isinstance(values[0], bool):
        return np.array([values], dtype=bool)
    return np.array([values], dtype=float)
