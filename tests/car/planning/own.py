"""A planner as a user may write one for a car."""

from __future__ import annotations

from koordgen.runtime.values.points import Point
from targets.planning.world import Path, Scene, World


class Aside:
    """By the north of what stands between."""

    def __init__(self, world: World) -> None:
        assert world.footprint[0] > world.footprint[1] > 0.0 and world.turning_radius > 0.0

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        return start, Point(goal.x / 2, 1.5, 0.0), goal
