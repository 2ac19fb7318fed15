"""Anytime search over poses of the car: Hybrid A* that expands many poses at once, coarse cells first.

Source: D. Dolgov, S. Thrun, M. Montemerlo and J. Diebel, Practical search techniques in path planning for autonomous
driving (2008). The search expands a pose by straight lines and by arcs of the turning radius, in each gear that the car
may use. From a pose with the goal in sight, the search also tries a single curve to the goal.

The search sorts poses into cells of several sizes, called levels. It expands the cheapest pose of a large cell first.
Another pose of this large cell waits in the queue; the smaller the cell in which the pose is the cheapest, the longer
it waits. So one queue serves the coarse search and the fine search, no pose is expanded twice by equal moves, and the
order of the search does not depend on its time limit. Lengths are in metres, except where turning radii are named.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from targets.car.planning.curves import Curve, Piece, Triple
from targets.car.planning.ground import Terrain
from targets.car.planning.overlap import Floats, Indices

BATCH = 24  # poses that are expanded at once
SPACING = 0.1  # turning radii between two checked poses of an arc
LONG, SHORT = np.array((3, 6)), np.array((1,))  # numbers of the samples at which long and short arcs may end
TINY = 9.0  # turning radii that a pose waits before it is also expanded by short arcs
LEVELS = ((0.34, 24), (0.12, 36), (0.05, 96))  # for each level: width of a cell in turning radii, number of headings
EAGER = 2.6  # weight of the estimated remaining distance against the cost of the path driven to a pose
AHEAD = 0.5  # turning radii: the remaining distance of a pose is estimated from the places this far ahead and behind
BACKWARDS, CHANGE = 1.2, 0.4  # costs in metres: of each metre in reverse, of a change of gear

# A goal is in sight if the estimated distance around obstacles is at most SEEN times the straight distance plus
# SEEN_NEAR metres.
SEEN, SEEN_NEAR = 1.15, 0.3
UNKNOWN = 1e6  # metres: initial cost of a cell; every path costs less


@dataclass(frozen=True, slots=True)
class SearchGoal:
    """Goal of a search: its place, and estimates and curves to it.

    `left` estimates the distances (m) from places to the goal. `shots` yields single curves from a pose to the goal."""

    place: tuple[float, float]
    left: Callable[[Floats, Floats], Floats]
    shots: Callable[[Triple], Iterable[Curve]]


class Lattice:
    """One search from a start pose. `radius`: smallest turning radius (m).

    `wait`: number of turning radii that a pose waits in the queue for each level beyond the first."""

    def __init__(
        self, start: Triple, radius: float, reverse: bool, terrain: Terrain, aim: SearchGoal, wait: float
    ) -> None:
        self._radius, self._reverse, self._terrain, self._aim, self._wait = (
            radius,
            reverse,
            terrain,
            aim,
            wait,
        )
        self._long, self._short = _Moves(radius, reverse, LONG), _Moves(radius, reverse, SHORT)
        self._least: list[dict[int, float]] = [{} for _ in LEVELS]  # by level: each cell's least cost of a pose
        self._poses = np.zeros((5, 1024))  # rows: x, y, yaw, cost, gear; one column for each pose that was found
        self._poses[:3, 0] = start
        # For each pose: number of the pose before it (-1: none), and the move from there to this pose.
        self._before, self._move = [-1], [(0.0, 0.0)]
        self._sure: dict[int, bool] = {}  # pose -> whether the whole move to it is clear, for checked moves
        self._queue = [(0.0, 0)]
        self._again: list[tuple[float, int]] = []  # (order, pose) of poses to expand by short moves

    def explore(self) -> Iterator[list[Piece] | None]:
        """Yield after each batch the pieces of a path to the goal, or None if the batch found no path.

        The iteration ends when no pose is left to expand."""
        while self._queue or self._again:
            if self._again and (not self._queue or self._again[0] < self._queue[0]):
                _, batch = _popped(self._again)
                self._expand(batch, self._poses[:, batch], self._short)
                yield None
                continue
            orders, batch = _popped(self._queue)
            poses = self._poses[:, batch]
            yield self._shot(batch, poses)
            self._expand(batch, poses, self._long)
            for order, pose in zip(orders, batch.tolist(), strict=True):
                heapq.heappush(self._again, (order + TINY * self._radius, pose))

    def _shot(self, batch: Indices, poses: Floats) -> list[Piece] | None:
        """Return a path that reaches the goal by a single curve from one pose of the batch; None if there is none.

        The pose is the one with the least estimated distance to the goal among those with the goal in sight."""
        x, y = poses[:2]
        left = self._aim.left(x, y)
        away = np.hypot(x - self._aim.place[0], y - self._aim.place[1])
        seeing = np.flatnonzero(left <= SEEN * away + SEEN_NEAR)
        if not len(seeing):
            return None
        best = seeing[np.argmin(left[seeing])]
        for shot in self._aim.shots((float(x[best]), float(y[best]), float(poses[2, best]))):
            if self._terrain.clear(shot):
                moves = self._back(int(batch[best]))
                return None if moves is None else [*moves, *shot.pieces]
        return None

    def _expand(self, batch: Indices, poses: Floats, moves: _Moves) -> None:
        """Expand each pose of a batch by each of the moves."""
        x, y, yaw, cost, gear = (of[:, None, None] for of in poses)
        ahead, aside, turn = moves.samples
        c, s = np.cos(yaw), np.sin(yaw)
        px, py, pyaw = x + c * ahead - s * aside, y + s * ahead + c * aside, yaw + turn
        free = self._terrain.free(px.ravel(), py.ravel(), pyaw.ravel()).reshape(px.shape)
        open_ = np.flatnonzero(np.logical_and.accumulate(free, axis=2)[:, :, moves.ends])
        px, py, pyaw = (of[:, :, moves.ends].ravel()[open_] for of in (px, py, pyaw))
        total = cost[:, 0] + moves.prices + CHANGE * (gear[:, 0] * moves.gears < 0)
        total = total.ravel()[open_]
        level = self._level(px, py, pyaw, total)
        new = np.flatnonzero(level < len(LEVELS))
        px, py, pyaw, total, open_ = px[new], py[new], pyaw[new], total[new], open_[new]
        move = open_ % len(moves.pieces)
        order = total + EAGER * self._left(px, py, pyaw) + self._wait * self._radius * level[new]
        begin, end = len(self._before), len(self._before) + len(new)
        while end > self._poses.shape[1]:
            self._poses = np.concatenate((self._poses, np.zeros_like(self._poses)), axis=1)
        self._poses[:, begin:end] = px, py, pyaw, total, moves.gears[move]
        self._before += batch[open_ // len(moves.pieces)].tolist()
        self._move += [moves.pieces[i] for i in move.tolist()]
        for each in zip(order.tolist(), range(begin, end), strict=True):
            heapq.heappush(self._queue, each)

    def _left(self, x: Floats, y: Floats, yaw: Floats) -> Floats:
        """Return the estimated distances (m) from poses to the goal.

        The estimate assumes that the car first drives straight, in either gear, and then turns on the spot."""
        first = AHEAD * self._radius
        dx, dy = first * np.cos(yaw), first * np.sin(yaw)
        left = self._aim.left(x + dx, y + dy) + first
        if self._reverse:
            left = np.minimum(left, self._aim.left(x - dx, y - dy) + BACKWARDS * first)
        return np.minimum(left, self._aim.left(x, y) + 2 * first)

    def _level(self, x: Floats, y: Floats, yaw: Floats, cost: Floats) -> Indices:
        """Return for each pose the first level in which it is the cheapest pose found in its cell.

        The result is len(LEVELS) for a pose that is the cheapest in no level. Records the costs of the cheapest."""
        found = [len(LEVELS)] * len(x)
        keys = [_cells(x, y, yaw, width * self._radius, turns).tolist() for width, turns in LEVELS]
        costs, order = cost.tolist(), np.argsort(cost, kind="stable").tolist()
        for level in range(len(LEVELS) - 1, -1, -1):
            least, cells, cheapest = self._least[level], keys[level], []
            for i in order:
                if costs[i] < least.get(cells[i], UNKNOWN):
                    least[cells[i]] = costs[i]
                    found[i] = level
                    cheapest.append(i)
            order = cheapest  # only a pose that is the cheapest of its small cell can be the cheapest of a larger cell
        return np.array(found)

    def _back(self, pose: int) -> list[Piece] | None:
        """Return the moves from the start to a pose; None if a move is not clear between its samples."""
        found: list[Piece] = []
        while self._before[pose] >= 0:
            move, before = self._move[pose], self._before[pose]
            if pose not in self._sure:
                x, y, yaw = self._poses[:3, before].tolist()
                self._sure[pose] = self._terrain.is_fully_clear(Curve((x, y, yaw), (move,)))
            if not self._sure[pose]:
                return None
            found.append(move)
            pose = before
        return found[::-1]


def _cells(x: Floats, y: Floats, yaw: Floats, width: float, turns: int) -> NDArray[np.int64]:
    """Return the numbers of the cells in which poses lie."""
    column, row = np.rint(x / width).astype(np.int64), np.rint(y / width).astype(np.int64)
    turn = np.rint(yaw * (turns / (2 * math.pi))).astype(np.int64) % turns
    return ((column << 28) + row << 8) + turn


class _Moves:
    """Arcs and straight lines by which a search expands a pose.

    `samples`: checked poses of each arc, in the frame of the arc's start; `ends`: indices at which an arc may end."""

    def __init__(self, radius: float, reverse: bool, ends: Indices) -> None:
        gears = (1.0, -1.0) if reverse else (1.0,)
        arcs = [(bend, gear) for bend in (0.0, 1 / radius, -1 / radius) for gear in gears]
        ways = SPACING * radius * np.arange(1, ends[-1] + 1)
        self.ends = ends - 1
        self.pieces = [(bend, gear * float(ways[end])) for bend, gear in arcs for end in self.ends]
        lengths = np.array([length for _, length in self.pieces])
        self.gears = np.sign(lengths)
        self.prices = np.where(lengths > 0, lengths, -BACKWARDS * lengths)
        curvature, gear = np.array(arcs).T[:, :, None]
        turned = curvature * gear * ways
        chords = gear * ways * np.sinc(turned / (2 * math.pi))
        # Metres ahead, metres to the left, radians turned.
        self.samples = chords * np.cos(turned / 2), chords * np.sin(turned / 2), turned


def _popped(queue: list[tuple[float, int]]) -> tuple[list[float], Indices]:
    """Remove the first entries of a queue, at most BATCH, and return their orders and their poses."""
    orders, poses = zip(*(heapq.heappop(queue) for _ in range(min(BATCH, len(queue)))), strict=True)
    return list(orders), np.array(poses)
