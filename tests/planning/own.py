"""Planners that break the contract, as users may write them."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from koordgen.runtime.values.points import Point
from targets.planning.world import Scene, World


class _Bad:
    def __init__(self, world: World) -> None:
        """Nothing to prepare."""


class Through(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return (start, goal)


class Nan(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return (start, Point(math.nan, 0.0, 0.0), goal)


class Elsewhere(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return (goal, start)


class Short(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return (start,)


class Outside(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return (start, Point(0.0, 50.0, 1.5), goal)


class Text(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return "straight ahead"


class None_(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        return None


class Raises(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        raise RuntimeError("no map")


class Sleeps(_Bad):
    """Late for goals in the north, gone for those in the far north."""

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        if goal.y > 3.0:
            time.sleep(60.0)
        if goal.y > 1.0:
            time.sleep(0.2)
        return (start, goal)


class Ends(_Bad):
    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Any:
        print("printing goes to standard error")
        if goal.y > 1.0:
            sys.exit(3)
        return (start, goal)


class Refuses:
    def __init__(self, world: World) -> None:
        raise RuntimeError("no licence")
