"""Fault state of a robot's devices: written by faults.py, read by devices."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from random import Random
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")
Vector = tuple[float, float, float]


class PositioningFault(msgspec.Struct, frozen=True):
    """Errors of a robot's positions, added to its usual noise and delay.

    noise: m, standard deviation. bias: m, ENU. delay: s. dropout: share of positions that are lost, 0 to 1."""

    noise: float = 0.0
    bias: Vector = (0.0, 0.0, 0.0)
    delay: float = 0.0
    dropout: float = 0.0


NO_POSITIONING_FAULT = PositioningFault()


@dataclass(slots=True)
class FaultState:
    """Present faults of a robot's devices.

    `positioning`: errors of its positions. `battery`: largest state of charge, 0 to 1. `lag`: time constant of its
    motors and servos (s)."""

    positioning: PositioningFault = NO_POSITIONING_FAULT
    battery: float = 1.0
    lag: float = 0.0
    _past: deque[tuple[float, Any]] = field(default_factory=deque)

    def late(self, now: float, state: T) -> T:
        """Return the state as it is known at `now` (s): delayed by the positioning's delay.

        Call it repeatedly with the state of one body only: past states are kept here."""
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
        """Return a measured position with noise (m, standard deviation), bias and faults; None if it is lost."""
        wrong = self.positioning
        if wrong.dropout and dice.random() < wrong.dropout:
            return None
        noise = math.hypot(noise, wrong.noise) if wrong.noise else noise
        (x, y, z), (bx, by, bz), gauss = position, wrong.bias, dice.gauss
        return x + bx + gauss(0.0, noise), y + by + gauss(0.0, noise), z + bz + gauss(0.0, noise)
