"""Calls of the program's planner that found no way: a robot that has nothing else to do stands because of them."""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Point

FORGOTTEN = 5.0  # seconds after which a call no longer says what the program wants
# Vehicles on the ground and in the air share their tasks by asking for all of them: these answers are no stall.
ANOTHERS = ("the goal is not on the ground", "the goal is not above the ground")


class Unplanned:
    """Times in seconds on the platform's clock."""

    def __init__(self) -> None:
        self._why, self._at = "", -math.inf

    def called(self, goal: Point, reason: str, now: float) -> None:
        """Record a call of the planner for a way to `goal`; `reason` is empty when it found one."""
        found = not reason or reason in ANOTHERS
        self._why, self._at = "" if found else f"the planner's goal {_placed(goal)} {reason}", now

    def commanded(self) -> None:
        """Record that the program commanded a target or a path."""
        self._why = ""

    def why(self, now: float) -> str:
        """Return the reason why the robot has no way; "" when it has one, or no longer asks."""
        return self._why if now - self._at <= FORGOTTEN else ""


def _placed(p: Point) -> str:
    return f"({p.x:.2f}, {p.y:.2f}, {p.z:.2f})"
