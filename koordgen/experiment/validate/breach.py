"""In which way a body left the box between its place and its target, told by where it was and how it moved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Kind = Literal["overshoot", "across", "away", "drift"]
Vector = tuple[float, float, float]

SLOW = 0.05  # m/s: what is slower stands
TOLD: dict[Kind, str] = {
    "overshoot": "along its motion, past its target or not yet braked: inertia",
    "across": "across the line to its target: a curve, around an obstacle or of a body that cannot turn on the spot",
    "away": "away from its target under power: it turns round",
    "drift": f"it stands (below {SLOW:g} m/s) and wanders about its place",
}


@dataclass(frozen=True)
class Breach:
    """The moment of a window at which the body was farthest outside: `out` is the vector from the box (m, local ENU).
    `at` is when the window began, seconds since round 1. Each window's box begins where the body then is; so what it
    comes to in windows one after the other is told, too: `together`, the length of their vectors' sum (m), and `main`,
    in which way it went farthest in one of them."""

    pid: int
    at: float
    out: Vector
    kind: Kind
    together: float
    main: Kind

    @property
    def distance(self) -> float:
        """Metres."""
        return math.hypot(*self.out)


class Row:
    """Windows of one robot, one after the other, in which it was outside."""

    def __init__(self) -> None:
        self._sum: Vector = (0.0, 0.0, 0.0)
        self._farthest = 0.0
        self._main: Kind = "drift"

    def add(self, pid: int, at: float, out: Vector, kind: Kind) -> Breach:
        """The next one."""
        self._sum = self._sum[0] + out[0], self._sum[1] + out[1], self._sum[2] + out[2]
        if (distance := math.hypot(*out)) > self._farthest:
            self._farthest, self._main = distance, kind
        return Breach(pid, at, out, kind, math.hypot(*self._sum), self._main)


def kind(start: Vector, target: Vector, before: Vector, out: Vector, then: Vector) -> Kind:
    """`start` and `before`: place and velocity as the window began; `out` and `then`: how far outside (the vector from
    the box) and how fast when it was farthest. Looked at in plan, because robots go up and down otherwise than they go
    about, unless it left the box mainly by its height."""
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
