"""What is wrong with a robot's devices at the moment. Faults change it (faults.py), devices look at it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

import msgspec

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

    def measured(self, position: Vector, noise: float, dice: Random) -> Vector | None:
        """A position as it is measured with so much usual noise (m, standard deviation); None: it never comes."""
        wrong = self.positioning
        if wrong.dropout and dice.random() < wrong.dropout:
            return None
        noise = math.hypot(noise, wrong.noise) if wrong.noise else noise
        (x, y, z), (bx, by, bz), gauss = position, wrong.bias, dice.gauss
        return x + bx + gauss(0.0, noise), y + by + gauss(0.0, noise), z + bz + gauss(0.0, noise)
