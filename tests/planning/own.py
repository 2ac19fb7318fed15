"""Planners as users may write them: one that keeps the contract, and some that do not."""

from __future__ import annotations

import heapq
import math
import sys
import time
from typing import Any

from koordgen.runtime.values import Point
from targets.planning.room import fixed, room
from targets.planning.world import Path, Scene, World

Cell = tuple[int, int, int]


class Lattice:
    """A* on a lattice of half a metre."""

    step = 0.5

    def __init__(self, world: World) -> None:
        self._world = world
        self._standing = fixed(world.obstacles)

    def plan(self, start: Point, goal: Point, scene: Scene, seconds: float) -> Path:
        here = room(self._world, self._standing, scene, start)
        lo, hi = self._world.arena.lo, self._world.arena.hi
        moves = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) != (0, 0, 0)]

        def at(c: Cell) -> Point:
            return Point(start.x + c[0] * self.step, start.y + c[1] * self.step, start.z + c[2] * self.step)

        first = (0, 0, 0)
        queue: list[tuple[float, float, Cell]] = [(0.0, 0.0, first)]
        came: dict[Cell, Cell] = {first: first}
        cost = {first: 0.0}
        while queue:
            _, so_far, cell = heapq.heappop(queue)
            p = at(cell)
            if so_far > cost[cell]:
                continue
            if math.dist((p.x, p.y, p.z), (goal.x, goal.y, goal.z)) < 2 * self.step and here.clear(p, goal):
                path = [goal]
                while cell != first:
                    path.append(at(cell))
                    cell = came[cell]
                return (start, *reversed(path))
            for i, j, k in moves:
                onto = (cell[0] + i, cell[1] + j, cell[2] + k)
                q = at(onto)
                there = so_far + self.step * math.sqrt(i * i + j * j + k * k)
                inside = lo.x <= q.x <= hi.x and lo.y <= q.y <= hi.y and lo.z <= q.z <= hi.z
                if inside and there < cost.get(onto, math.inf) and here.clear(p, q):
                    cost[onto], came[onto] = there, cell
                    left = math.dist((q.x, q.y, q.z), (goal.x, goal.y, goal.z))
                    heapq.heappush(queue, (there + left, there, onto))
        return ()


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
