"""RRT-Connect without OMPL, for Pythons that OMPL has no wheel for (3.14 and later).

Algorithm: J. Kuffner, S. LaValle, RRT-Connect: an efficient approach to single-query path planning, ICRA 2000.
"""

from __future__ import annotations

import importlib.util
import random
import sys

from koordgen.runtime.values.points import Point, distance
from targets.planning.limit import STARTS, Limit
from targets.planning.room import Room

LONGEST = 0.2  # maximum length of a tree's edge, as a share of the arena's diagonal; the same as in OMPL
NEEDS_OMPL = "the planner rrt-star needs OMPL, which has no wheel for this Python; take rrt-smoothed, or Python 3.13"


def is_needed() -> bool:
    """Return whether OMPL has no wheel for this Python and was not built on this computer either.

    With Python 3.13 and earlier, return False: a missing OMPL is then a package to install."""
    return sys.version_info >= (3, 14) and importlib.util.find_spec("ompl") is None


class OwnTrees:
    """RRT-Connect in the box from `low` to `high`; if `flat`, in the plane at low.z."""

    def __init__(self, low: Point, high: Point, flat: bool, seed: int | None) -> None:
        self._low, self._high, self._flat, self._seed = low, high, flat, seed
        self._longest = LONGEST * distance(low, high)

    def connect(self, here: Room, start: Point, goal: Point, over: Limit, turn: int) -> list[Point] | None:
        """See rrt.Trees."""
        dice = random.Random(None if self._seed is None else self._seed * STARTS + turn + 1)
        one, other = [(start, -1)], [(goal, -1)]  # places, and the index of the place before
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
        """Grow a tree towards a place by one edge.

        Return the index of the new node, None if the edge is blocked; and whether the new node is the place."""
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
    """Return the places from a tree's node to its root."""
    found = []
    while at >= 0:
        place, at = tree[at]
        found.append(place)
    return found
