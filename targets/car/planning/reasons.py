"""Reasons why a car has no path to its target: the planner's answer, or an obstacle on the planned path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.points import Point
from targets.car.planning.planner import Point2
from targets.car.planning.shapes import Footprint, Shape
from targets.planning.world import Path

SAME = 0.02  # metres: targets within this distance count as one target
ANOTHER = "another robot's path"  # the planner's name of an obstacle that is another robot's published path
_POINT = Footprint(0.0, 0.0, 0.0)


class NoWay:
    """Reason why the car has no path to its target. Places in metres, local ENU.

    `why`: the target and the reason, in words; "" while the car has a path."""

    def __init__(self) -> None:
        self.why = ""
        self._target: Point2 | None = None  # the target to which no path was found
        self._tries = 0
        self._since = 0.0

    def failed(self, target: Point2, reason: str, now: float) -> None:
        """Record that no path to a target was found."""
        if self._target is None or math.dist(self._target, target) > SAME:
            self._target, self._tries, self._since = target, 0, now
        self._tries += 1
        tries = f" ({self._tries} tries in {now - self._since:.0f} s)" if self._tries > 1 else ""
        self.why = f"{_named(target)} {reason}{tries}"

    def blocked(self, target: Point2, reason: str) -> None:
        """Record that the path to the target is blocked."""
        self.why, self._target = f"{_named(target)} is not approached: {reason}", None

    def found(self) -> None:
        """Record that the car drives along a path to its target."""
        self.why, self._target = "", None


def unreachable(
    start: Point2, target: Point2, reason: str, fixed: Iterable[Shape], others: Mapping[str, Path], clearance: float
) -> str:
    """Return why the planner found no path from `start` to `target`, as words that follow the target's name.

    `reason`: the planner's reason, may be empty. `fixed`: obstacles of the fleet file. `others`: robot's name -> its
    published path. `clearance`: in metres."""
    inside = next((shape.name for shape in fixed if _POINT.distance(*target, 0.0, shape) <= 0.0), "")
    if inside:
        return f"lies inside {inside}"
    nearest = min(others, key=lambda name: _distance(target, others[name]), default="")
    if not reason:
        past = f", past the paths of {', '.join(sorted(others))}" if others else ""
        return f"has no path from {_placed(start)}{past}"
    if nearest:
        reason = reason.replace(ANOTHER, f"robot {nearest}'s path")
    near = "the goal is too near to "
    if reason.startswith(near):
        return f"is too near to {reason.removeprefix(near)} for the car (clearance {clearance:g} m)"
    return f"has no path: {reason}"


def _distance(place: Point2, path: Path) -> float:
    return path_distance((Point(*place, 0.0),), tuple(Point(p.x, p.y, 0.0) for p in path))


def _named(target: Point2) -> str:
    return f"target {_placed(target)}"


def _placed(place: Point2) -> str:
    x, y = (round(c, 2) + 0.0 for c in place)  # adding 0.0 turns -0.0 into 0.0
    return f"({x:.2f}, {y:.2f})"
