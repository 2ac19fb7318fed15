"""What is wrong with a robot's devices at the moment. Faults change it (faults.py), devices look at it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from random import Random
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")
Vector = tuple[float, float, float]


class Positioning(msgspec.Struct, frozen=True):
    """What is wrong with a robot's positions: noise on top (m, standard deviation), bias (m, ENU), delay (s, on top),
    and which part of them never comes."""

    noise: float = 0.0
    bias: Vector = (0.0, 0.0, 0.0)
    delay: float = 0.0
    dropout: float = 0.0


WELL = Positioning()


@dataclass(slots=True)
class Upset:
    """Its positions (what comes on top of their usual noise and delay), how full its battery is at most (a part of 1),
    by how much its motors and servos are slower (a time constant, s)."""

    positioning: Positioning = WELL
    battery: float = 1.0
    lag: float = 0.0
    _past: deque[tuple[float, Any]] = field(default_factory=deque)

    def late(self, now: float, state: T) -> T:
        """What is known at `now` (s) of what is `state` in truth: how it was a delay of the positions ago. To be asked
        again and again, of one thing."""
        delay, past = self.positioning.delay, self._past
        if not delay:
            past.clear()
            return state
        past.append((now, state))
        while len(past) > 1 and past[1][0] <= now - delay:
            past.popleft()
        known: T = past[0][1]
        return known

    def measured(self, position: Vector, noise: float, dice: Random) -> Vector | None:
        """A position as it is measured with so much usual noise (m, standard deviation); None: it never comes."""
        wrong = self.positioning
        if wrong.dropout and dice.random() < wrong.dropout:
            return None
        noise = math.hypot(noise, wrong.noise) if wrong.noise else noise
        (x, y, z), (bx, by, bz), gauss = position, wrong.bias, dice.gauss
        return x + bx + gauss(0.0, noise), y + by + gauss(0.0, noise), z + bz + gauss(0.0, noise)
