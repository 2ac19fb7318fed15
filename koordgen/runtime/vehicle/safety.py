"""Safety layer: checks the geofence and the age of the robot's own position.

This module returns verdicts, and the agent acts on them.

Frames: local ENU metres. A robot's own position is the sensor that its program declares as the robot's position. If the
program declares no sensor, the platform's `<Module>.position` is used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from koordgen.runtime.config.settings import Box, Safety
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Sensed


@dataclass(frozen=True, slots=True)
class SafetyVerdict:
    """Reaction that the safety layer requires of the agent, with its reason."""

    action: Literal["go", "hold", "stop"]
    reason: str = ""


GO = SafetyVerdict("go")


def inside(box: Box, p: Point) -> bool:
    """Return whether a point is in the box, faces included. The box's corners may be in any order."""
    lo, hi = _corners(box)
    return all(a <= v <= b for a, v, b in zip(lo, (p.x, p.y, p.z), hi, strict=True))


def clamp(box: Box, p: Point) -> Point:
    """Return the point of the box nearest to `p`."""
    lo, hi = _corners(box)
    return Point(*(max(a, min(v, b)) for a, v, b in zip(lo, (p.x, p.y, p.z), hi, strict=True)))


def clamped(box: Box, actuators: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the actuators with every Point clamped to the box, and the names of the actuators that this changed."""
    moved: dict[str, Any] = {name: _into(box, value) for name, value in actuators.items()}
    return moved, [name for name, value in moved.items() if value != actuators[name]]


def own_position(sensed: Sensed, declared: Sequence[str] = ()) -> Point | None:
    """Return the robot's own position, or None. `declared`: sensors that the program declares as own position."""
    offered = [name for name in sensed.values if name.endswith(".position")]
    places = (sensed.values.get(name) for name in (*declared, *offered))
    return next((place for place in places if isinstance(place, Point)), None)


class SafetyGuard:
    """Safety check of one robot's own position, from the time at which the vehicle is ready.

    `declared`: sensors that the program declares as own position."""

    def __init__(self, safety: Safety, fence: Box, declared: Sequence[str] = ()) -> None:
        self._safety, self._declared = safety, declared
        self._fence = fence
        self._since = math.inf  # time of the first call of `judge`
        self._outside: float | None = None

    def judge(self, sensed: Sensed, now: float) -> SafetyVerdict:
        """Return the reaction that the sensor values at local time `now` (seconds) require."""
        self._since = min(self._since, now)
        age = now - (self._since if sensed.time is None else sensed.time)
        position = own_position(sensed, self._declared)
        if position is not None and not all(map(math.isfinite, (position.x, position.y, position.z))):
            position, age = None, max(age, now - self._since)
            if age <= self._safety.position_lost:
                return SafetyVerdict("hold", "own position is not finite")
        if age > self._safety.position_lost:
            return SafetyVerdict("stop", f"no own position for {age:.1f} s")
        if position is None or inside(self._fence, position):
            self._outside = None
        elif self._outside is None:
            self._outside = now
        if self._outside is not None and now - self._outside > self._safety.outside_fence and position is not None:
            where = f"({position.x:.2f}, {position.y:.2f}, {position.z:.2f})"
            return SafetyVerdict("stop", f"outside the geofence for {now - self._outside:.1f} s, at {where}")
        if age > self._safety.position_stale:
            return SafetyVerdict("hold", f"own position is {age:.1f} s old")
        return GO


def _corners(box: Box) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    a, b = box.lo, box.hi
    return (min(a.x, b.x), min(a.y, b.y), min(a.z, b.z)), (max(a.x, b.x), max(a.y, b.y), max(a.z, b.z))


def _into(box: Box, value: Any) -> Any:
    if isinstance(value, Point):
        return clamp(box, value)
    if isinstance(value, tuple):
        return tuple(_into(box, v) for v in value)
    return value
