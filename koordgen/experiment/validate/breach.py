"""Breaches: cases in which a robot left the box between its position and its target, classified by their cause."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Kind = Literal["overshoot", "across", "away", "drift"]
Vector = tuple[float, float, float]

SLOW = 0.05  # a robot slower than this counts as standing, in m/s
EXPLANATIONS: dict[Kind, str] = {
    "overshoot": "along its motion, past its target or not yet braked: inertia",
    "across": "across the line to its target: a curve, around an obstacle or of a body that cannot turn on the spot",
    "away": "away from its target under power: it turns round",
    "drift": f"it stands (below {SLOW:g} m/s) and drifts about its place",
}


@dataclass(frozen=True)
class BoxBreach:
    """Breach: in one round, a robot was outside the box from its position at the round's start to its target.

    `at`: start of the round, in seconds since round 1.
    `out`: vector from the box to the robot's farthest position (m, local ENU).
    `together`: length in metres of the sum of `out` over this round and the uninterrupted breaches before this round.
    `main`: kind of the farthest breach among these rounds."""

    pid: int
    at: float
    out: Vector
    kind: Kind
    together: float
    main: Kind

    @property
    def distance(self) -> float:
        """Return the distance of the robot's farthest position from the box, in metres."""
        return math.hypot(*self.out)


class ConsecutiveBreaches:
    """Uninterrupted sequence of rounds in which one robot left the box from its position to its target."""

    def __init__(self) -> None:
        self._sum: Vector = (0.0, 0.0, 0.0)
        self._farthest = 0.0
        self._main: Kind = "drift"

    def add(self, pid: int, at: float, out: Vector, kind: Kind) -> BoxBreach:
        """Add the breach of the next round, and return it together with the sums over all rounds of the sequence."""
        self._sum = self._sum[0] + out[0], self._sum[1] + out[1], self._sum[2] + out[2]
        if (distance := math.hypot(*out)) > self._farthest:
            self._farthest, self._main = distance, kind
        return BoxBreach(pid, at, out, kind, math.hypot(*self._sum), self._main)


def kind(start: Vector, target: Vector, before: Vector, out: Vector, then: Vector) -> Kind:
    """Return the kind of a breach, in which a robot left the box from its position to its target.

    `start`, `before`: the robot's position and velocity at the start of the round.
    `out`: vector from the box to the robot's farthest position.
    `then`: the robot's velocity at the farthest position.
    Only x and y are compared, or only z if the robot left the box mainly in z, because robots move differently in z."""
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
