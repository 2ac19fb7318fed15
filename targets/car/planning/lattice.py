"""Anytime search over poses of the car: Hybrid A* that expands many poses at once, coarse cells first.

After D. Dolgov, S. Thrun, M. Montemerlo and J. Diebel, Practical search techniques in path planning for autonomous
driving (2008). From a pose the car goes on by arcs, straight and as sharp as it turns, in each gear that it may use.
From poses that seem to see the goal, a single curve to it is tried.

Poses are told apart by cells of several sizes. The cheapest pose of a large cell is expanded first; another pose of the
same cell waits, longer the smaller the cell is in which it is the cheapest. So one queue serves the first coarse look
and the finest, nothing is searched twice, and the order of the search does not depend on the time that it is given.
Lengths are in turning radii where that is said, else in metres.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from targets.car.planning.curves import Curve, Piece, Triple
from targets.car.planning.ground import Way
from targets.car.planning.overlap import Floats, Indices

BATCH = 24  # poses that are expanded at once
SPACING = 0.1  # turning radii between the poses of an arc that are checked
LONG, SHORT = np.array((3, 6)), np.array((1,))  # samples at which arcs may end
TINY = 9.0  # turning radii that a pose waits before the car goes on from it by short arcs, too
LEVELS = ((0.34, 24), (0.12, 36), (0.05, 96))  # width of a cell in turning radii, and number of headings
EAGER = 2.6  # weight of what is left against what was driven
AHEAD = 0.5  # turning radii: a pose is judged by the places so far ahead and behind
BACKWARDS, CHANGE = 1.2, 0.4  # of a metre in reverse; metres for a change of gear
SEEN, SEEN_NEAR = 1.15, 0.3  # a goal is in sight if the way around is at most this share, and metres, of the straight
UNKNOWN = 1e6  # metres: no way is so long


@dataclass(frozen=True, slots=True)
class Aim:
    """Where to: `left` estimates how far it is from places, `shots` yields single curves from a pose to the goal."""

    place: tuple[float, float]
    left: Callable[[Floats, Floats], Floats]
    shots: Callable[[Triple], Iterable[Curve]]


class Lattice:
    """One search from a pose. `radius` is the smallest turning radius, metres; `wait` is how many of these a pose waits
    for each level beyond the first."""

    def __init__(self, start: Triple, radius: float, reverse: bool, way: Way, aim: Aim, wait: float) -> None:
        self._radius, self._reverse, self._way, self._aim, self._wait = radius, reverse, way, aim, wait
        self._long, self._short = _Moves(radius, reverse, LONG), _Moves(radius, reverse, SHORT)
        self._least: list[dict[int, float]] = [{} for _ in LEVELS]  # the least cost of a pose in each cell, by level
        self._poses = np.zeros((5, 1024))  # x, y, yaw, cost and gear of the poses found so far
        self._poses[:3, 0] = start
        # For each of them: the pose that it was reached from, and the move to it.
        self._before, self._move = [-1], [(0.0, 0.0)]
        self._sure: dict[int, bool] = {}  # of poses: whether the move to it is clear all along, as far as was looked
        self._queue = [(0.0, 0)]
        self._again: list[tuple[float, int]] = []  # poses to go on from by short moves

    def explore(self) -> Iterator[list[Piece] | None]:
        """Yield after each batch: the pieces of a way if one was found, else None. End when nothing is left."""
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
        """Return the way over the pose of a batch that is nearest to the goal and sees it, if a curve from there is
        clear."""
        x, y = poses[:2]
        left = self._aim.left(x, y)
        away = np.hypot(x - self._aim.place[0], y - self._aim.place[1])
        seeing = np.flatnonzero(left <= SEEN * away + SEEN_NEAR)
        if not len(seeing):
            return None
        best = seeing[np.argmin(left[seeing])]
        for shot in self._aim.shots((float(x[best]), float(y[best]), float(poses[2, best]))):
            if self._way.clear(shot):
                moves = self._back(int(batch[best]))
                return None if moves is None else [*moves, *shot.pieces]
        return None

    def _expand(self, batch: Indices, poses: Floats, moves: _Moves) -> None:
        """Go on from each pose of a batch by each move."""
        x, y, yaw, cost, gear = (of[:, None, None] for of in poses)
        ahead, aside, turn = moves.samples
        c, s = np.cos(yaw), np.sin(yaw)
        px, py, pyaw = x + c * ahead - s * aside, y + s * ahead + c * aside, yaw + turn
        free = self._way.free(px.ravel(), py.ravel(), pyaw.ravel()).reshape(px.shape)
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
        """Estimate how far it is: as if the car first went on straight, in either gear, then turned on the spot."""
        first = AHEAD * self._radius
        dx, dy = first * np.cos(yaw), first * np.sin(yaw)
        left = self._aim.left(x + dx, y + dy) + first
        if self._reverse:
            left = np.minimum(left, self._aim.left(x - dx, y - dy) + BACKWARDS * first)
        return np.minimum(left, self._aim.left(x, y) + 2 * first)

    def _level(self, x: Floats, y: Floats, yaw: Floats, cost: Floats) -> Indices:
        """Return the first level in which each pose is the cheapest of its cell so far; len(LEVELS) if there is none.
        Note the costs."""
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
            order = cheapest  # a pose that is not the cheapest of a small cell is not that of a larger one
        return np.array(found)

    def _back(self, pose: int) -> list[Piece] | None:
        """Return the moves from the start to a pose; None if one is not clear between its samples."""
        found: list[Piece] = []
        while self._before[pose] >= 0:
            move, before = self._move[pose], self._before[pose]
            if pose not in self._sure:
                x, y, yaw = self._poses[:3, before].tolist()
                self._sure[pose] = self._way.surely_clear(Curve((x, y, yaw), (move,)))
            if not self._sure[pose]:
                return None
            found.append(move)
            pose = before
        return found[::-1]


def _cells(x: Floats, y: Floats, yaw: Floats, width: float, turns: int) -> NDArray[np.int64]:
    """Return the cells of poses, each as one number."""
    column, row = np.rint(x / width).astype(np.int64), np.rint(y / width).astype(np.int64)
    turn = np.rint(yaw * (turns / (2 * math.pi))).astype(np.int64) % turns
    return ((column << 28) + row << 8) + turn


class _Moves:
    """The arcs by which the car goes on: samples of each, in the frame of its beginning, and those where it may end."""

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
        self.samples = chords * np.cos(turned / 2), chords * np.sin(turned / 2), turned  # ahead, to the left, turned


def _popped(queue: list[tuple[float, int]]) -> tuple[list[float], Indices]:
    """Take the first of a queue, BATCH at most."""
    orders, poses = zip(*(heapq.heappop(queue) for _ in range(min(BATCH, len(queue)))), strict=True)
    return list(orders), np.array(poses)
