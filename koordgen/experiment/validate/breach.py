"""Kinds of breaches: the manner in which a robot left the box between its position and its target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Kind = Literal["overshoot", "across", "away", "drift"]
Vector = tuple[float, float, float]

SLOW = 0.05  # speed in m/s below which a robot counts as standing
EXPLANATIONS: dict[Kind, str] = {
    "overshoot": "along its motion, past its target or not yet braked: inertia",
    "across": "across the line to its target: a curve, around an obstacle or of a body that cannot turn on the spot",
    "away": "away from its target under power: it turns round",
    "drift": f"it stands (below {SLOW:g} m/s) and drifts about its place",
}


@dataclass(frozen=True)
class BoxBreach:
    """Breach: the farthest position outside of the box within one window.

    A window's box extends from the robot's position at the window's start to its target.

    `at`: start of the window, in seconds since round 1.
    `out`: vector from the box to the farthest position (m, local ENU).
    `together`: length in metres of the sum of these vectors over this window and the breached windows directly before
        it.
    `main`: kind of the farthest breach among these windows."""

    pid: int
    at: float
    out: Vector
    kind: Kind
    together: float
    main: Kind

    @property
    def distance(self) -> float:
        """Return the distance from the box in metres."""
        return math.hypot(*self.out)


class ConsecutiveBreaches:
    """Consecutive windows of one robot in which it was outside of the box."""

    def __init__(self) -> None:
        self._sum: Vector = (0.0, 0.0, 0.0)
        self._farthest = 0.0
        self._main: Kind = "drift"

    def add(self, pid: int, at: float, out: Vector, kind: Kind) -> BoxBreach:
        """Add the next window, and return its breach."""
        self._sum = self._sum[0] + out[0], self._sum[1] + out[1], self._sum[2] + out[2]
        if (distance := math.hypot(*out)) > self._farthest:
            self._farthest, self._main = distance, kind
        return BoxBreach(pid, at, out, kind, math.hypot(*self._sum), self._main)


def kind(start: Vector, target: Vector, before: Vector, out: Vector, then: Vector) -> Kind:
    """Return the kind of a breach.

    `start`, `before`: position and velocity at the window's start.
    `out`: vector from the box to the farthest position.
    `then`: velocity at the farthest position.
    Vertical motion differs from horizontal motion, so only x and y are used, unless the robot left the box mainly in z.
    """
    if math.hypot(*then) < SLOW:
        return "drift"
    axes = (2,) if abs(out[2]) > math.hypot(out[0], out[1]) else (0, 1)
    way = [target[k] - start[k] for k in axes]
    left = [out[k] for k in axes]
    length, far = math.hypot(*way), math.hypot(*left)
    along = sum(w * e for w, e in zip(way, left, strict=True)) / length if length else -far
    if abs(along) < far * math.sqrt(0.5):
        return "across"
    if along > 0.0:
        return "overshoot"
    outwards = [e / far for e in left]
    faster = sum((then[k] - before[k]) * e for k, e in zip(axes, outwards, strict=True))
    return "away" if faster > 0.0 else "overshoot"
