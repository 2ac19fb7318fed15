"""A search over a lattice of poses, arc by arc: what finds a way where random trees do not get through in time, and
shorter ones where they have.

Poses are told apart by cells of the ground and of the heading; the cheapest way to a cell that was found so far stands
for it. From there the car goes on by short arcs, straight and as sharp as it turns, in each gear that it may use. From
poses near the goal, and now and then from others, a single curve to the goal is tried. After D. Dolgov, S. Thrun,
M. Montemerlo and J. Diebel, Practical search techniques in path planning for autonomous driving (2008): Hybrid A*.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from targets.car.curves import Curve, Piece, Triple, along
from targets.car.ground import PAD, Way
from targets.planning.limit import Limit

COARSE, FINE = 0.3, 0.15  # metres: the width of a cell
ARC = 1.5  # widths of a cell
TURN = math.pi / 12  # radians: headings that are one
ROUND = round(2 * math.pi / TURN)
SHOT = 10  # poses between two tries at the goal
NEAR = 1.0  # metres from the goal within which one is tried from every pose
EAGER = 1.6  # weight of what is left against what was driven
BACKWARDS, CHANGE = 1.2, 0.4  # of a metre in reverse; metres for a change of gear

GRID = 0.3  # metres
LONGER = 1.08
AROUND = [(i, j, GRID * math.hypot(i, j)) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]

Cell = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Aim:
    """Where to: `left` tells at least about how far a pose is from the goal, `shots` the curves to it that are worth
    a try."""

    place: tuple[float, float]
    left: Callable[[Triple], float]
    shots: Callable[[Triple], Iterable[Curve]]


class Lattice:
    """One search from a pose; `radius` is the smallest turning radius, `width` that of a cell, metres."""

    def __init__(self, start: Triple, radius: float, reverse: bool, way: Way, width: float) -> None:
        self._way, self._width, self._step = way, width, ARC * width
        gears = (1.0, -1.0) if reverse else (1.0,)
        self._moves = [(bend, gear * self._step) for bend in (0.0, 1 / radius, -1 / radius) for gear in gears]
        first = self._cell(start)
        self._came: dict[Cell, tuple[Cell, Piece] | None] = {first: None}
        self._cost, self._pose = {first: 0.0}, {first: start}
        self._queue: list[tuple[float, Cell]] = [(0.0, first)]
        self._done: set[Cell] = set()

    def explored(self, aim: Aim, over: Limit) -> list[Piece] | None:
        """Pieces of a way; None when the lattice holds none, or time is over."""
        while self._queue and not over():
            _, cell = heapq.heappop(self._queue)
            if cell in self._done:
                continue
            self._done.add(cell)
            at = self._pose[cell]
            if len(self._done) % SHOT == 1 or math.dist(at[:2], aim.place) < NEAR:
                for shot in aim.shots(at):
                    if self._way.clear(shot):
                        return [*self._back(cell), *shot.pieces]
            for move in self._moves:
                self._go_on(cell, move, aim)
        return None

    def _go_on(self, cell: Cell, move: Piece, aim: Aim) -> None:
        at, came = self._pose[cell], self._came[cell]
        there = along(at, *move)
        onto = self._cell(there)
        if onto in self._done:
            return
        cost = self._cost[cell] + (move[1] if move[1] > 0 else -BACKWARDS * move[1])
        if came is not None and came[1][1] * move[1] < 0:
            cost += CHANGE
        way = self._way
        if cost < self._cost.get(onto, math.inf) and way.slack(*there) >= PAD and way.clear(Curve(at, (move,))):
            self._cost[onto], self._came[onto], self._pose[onto] = cost, (cell, move), there
            heapq.heappush(self._queue, (cost + EAGER * aim.left(there), onto))

    def _cell(self, pose: Triple) -> Cell:
        return round(pose[0] / self._width), round(pose[1] / self._width), round(pose[2] / TURN) % ROUND

    def _back(self, cell: Cell) -> list[Piece]:
        found: list[Piece] = []
        while (step := self._came[cell]) is not None:
            cell, move = step
            found.append(move)
        return found[::-1]


class Field:
    """How far it is to a place around what stands there, for something that turns on the spot: Dijkstra's algorithm on
    a grid, from the place, as far as it is asked. A grid's ways are up to 8 % longer than others."""

    def __init__(self, place: tuple[float, float], free: Callable[[float, float], bool]) -> None:
        first = (round(place[0] / GRID), round(place[1] / GRID))
        self._free = free
        self._queue: list[tuple[float, tuple[int, int]]] = [(0.0, first)]
        self._far: dict[tuple[int, int], float] = {first: 0.0}
        self._done: set[tuple[int, int]] = set()

    def __call__(self, x: float, y: float) -> float:
        """Metres; infinite where the grid has no way."""
        wanted = (round(x / GRID), round(y / GRID))
        while wanted not in self._done:
            if not self._queue:
                return math.inf
            far, (i, j) = heapq.heappop(self._queue)
            if (i, j) in self._done:
                continue
            self._done.add((i, j))
            for di, dj, way in AROUND:
                onto = (i + di, j + dj)
                if far + way < self._far.get(onto, math.inf) and self._free(onto[0] * GRID, onto[1] * GRID):
                    self._far[onto] = far + way
                    heapq.heappush(self._queue, (far + way, onto))
        return self._far[wanted] / LONGER
