"""RRT-Connect without OMPL, for versions of Python for which OMPL has no wheel (3.14 and later).

Algorithm: J. Kuffner, S. LaValle, RRT-Connect: an efficient approach to single-query path planning, ICRA 2000.
"""

from __future__ import annotations

import importlib.util
import random
import sys

from koordgen.runtime.values.points import Point, distance
from targets.planning.limit import STARTS, Limit
from targets.planning.room import Room

LONGEST = 0.2  # maximum length of a tree's edge, as a share of the arena's diagonal; OMPL uses this share, too
NEEDS_OMPL = "the planner rrt-star needs OMPL, which has no wheel for this Python; use rrt-smoothed, or Python 3.13"


def is_needed() -> bool:
    """Return whether the planner must work without OMPL.

    This is so if OMPL has no wheel for this Python (3.14 or later) and is not installed. With Python 3.13 and earlier,
    the user can install OMPL."""
    return sys.version_info >= (3, 14) and importlib.util.find_spec("ompl") is None


class OwnTrees:
    """RRT-Connect in the box from `low` to `high`; if `flat`, in the plane at low.z."""

    def __init__(self, low: Point, high: Point, flat: bool, seed: int | None) -> None:
        self._low, self._high, self._flat, self._seed = low, high, flat, seed
        self._longest = LONGEST * distance(low, high)

    def connect(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        """Return the corners of a path that RRT-Connect finds; None if the limit ends the search first."""
        dice = random.Random(None if self._seed is None else self._seed * STARTS + turn + 1)
        one, other = [(start, -1)], [(goal, -1)]  # nodes of the two trees: place, and index of the parent node or -1
        while not over():
            reached, _ = self._extended(one, self._anywhere(dice), here)
            if reached is not None:
                end: int | None
                end, met = self._extended(other, one[reached][0], here)
                while end is not None and not met:
                    end, met = self._extended(other, one[reached][0], here)
                if end is not None:
                    path = [*reversed(_back(one, reached)), *_back(other, end)[1:]]
                    return (path if path[0] == start else path[::-1])[1:-1]
            one, other = other, one
        return None

    def _anywhere(self, dice: random.Random) -> Point:
        low, high = self._low, self._high
        z = low.z if self._flat else dice.uniform(low.z, high.z)
        return Point(dice.uniform(low.x, high.x), dice.uniform(low.y, high.y), z)

    def _extended(self, tree: list[tuple[Point, int]], to: Point, here: Room) -> tuple[int | None, bool]:
        """Grow a tree towards the place `to` by one edge.

        Return the index of the new node, or None if the edge is blocked; and whether the new node is at `to`."""
        near = min(range(len(tree)), key=lambda k: distance(tree[k][0], to))
        at = tree[near][0]
        away = distance(at, to)
        met = away <= self._longest
        end = to if met else at + (to - at) * (self._longest / away)
        if not here.clear(at, end):
            return None, False
        tree.append((end, near))
        return len(tree) - 1, met


def _back(tree: list[tuple[Point, int]], at: int) -> list[Point]:
    """Return the places from node number `at` of a tree to the tree's root."""
    found = []
    while at >= 0:
        place, at = tree[at]
        found.append(place)
    return found
