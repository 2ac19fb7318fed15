"""An exhaustive search for a way that a car can drive: slow, and sure to find what its lattice holds.

Poses are told apart by cells of 0.1 m and 15 degrees; from the first pose that comes to a cell, arcs of 0.15 m in both
gears go on, straight and as sharp as the car steers. From every pose near the goal, and from every 20th, the shortest
Reeds-Shepp curve to the goal is tried. Whether a curve is clear is looked at every centimetre with the exact checker's
distances in `exact.py`, which knows nothing of the planner.
"""

from __future__ import annotations

import heapq
import math

from targets.car.curves import Curve, Piece, Triple, along, reeds_shepp
from targets.planning.world import World
from tests.car.exact import SPACING, gap, near, outline

CELL, TURN = 0.1, math.pi / 12
STEP = 0.15  # metres
SHOT = 20  # poses between two curves to the goal
NEAR = 1.5  # metres from the goal within which one is tried from every pose

Cell = tuple[int, int, int]


class Lattice:
    """Of one scene."""

    def __init__(self, world: World) -> None:
        self._world = world

    def solved(self, start: Triple, goal: Triple) -> list[Piece] | None:
        """Pieces of a way; None when the lattice holds none."""
        bend = 1 / self._world.turning_radius
        moves = [(k, s) for k in (0.0, bend, -bend) for s in (STEP, -STEP)]
        first = self._cell(start)
        queue: list[tuple[float, float, Cell]] = [(0.0, 0.0, first)]
        came: dict[Cell, tuple[Cell, Piece] | None] = {first: None}
        pose = {first: start}
        count = 0
        while queue:
            _, so_far, cell = heapq.heappop(queue)
            at = pose[cell]
            away = math.dist(at[:2], goal[:2])
            count += 1
            if away < NEAR or count % SHOT == 1:
                shot = reeds_shepp(at, goal, self._world.turning_radius)
                if self._clear(shot):
                    return [*self._back(came, cell), *shot.pieces]
            for move in moves:
                there = along(at, *move)
                onto = self._cell(there)
                if onto not in came and self._clear(Curve(at, (move,))):
                    came[onto], pose[onto] = (cell, move), there
                    cost = so_far + STEP
                    heapq.heappush(queue, (cost + 1.5 * math.dist(there[:2], goal[:2]), cost, onto))
        return None

    def _cell(self, pose: Triple) -> Cell:
        turn = round(pose[2] / TURN) % round(2 * math.pi / TURN)
        return round(pose[0] / CELL), round(pose[1] / CELL), turn

    def _back(self, came: dict[Cell, tuple[Cell, Piece] | None], cell: Cell) -> list[Piece]:
        found: list[Piece] = []
        while (step := came[cell]) is not None:
            cell, move = step
            found.append(move)
        return found[::-1]

    def _clear(self, curve: Curve) -> bool:
        steps = max(1, math.ceil(curve.length / SPACING))
        return all(self._stands(curve.at(curve.length * i / steps)) for i in range(steps, -1, -1))

    def _stands(self, pose: Triple) -> bool:
        """Whether the car may be there: its middle is looked at first, for most poses are far from everything or in
        something."""
        world, (x, y, yaw) = self._world, pose
        lo, hi = world.arena.lo, world.arena.hi
        if not (lo.x <= x <= hi.x and lo.y <= y <= hi.y):
            return False
        corners = outline(world, x, y, yaw)
        middle = (sum(p[0] for p in corners) / 4, sum(p[1] for p in corners) / 4)
        round_ = math.dist(middle, corners[0]) + world.clearance
        for body in world.obstacles:
            if near(middle, body) < round_ and gap(corners, body) < world.clearance:
                return False
        return True
