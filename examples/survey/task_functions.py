"""Extern functions of task.koord: the cells of a map through which a quad may fly.

The functions are pure: for the same map they return the same value on every robot."""

from __future__ import annotations

from functools import lru_cache

from koordgen.runtime.values.gridmap import FREE, GridMap, cell, is_free
from koordgen.runtime.values.points import Grid, Point


def notFree(known: GridMap) -> list[Grid]:
    """Return the cells that are not known to be free."""
    return list(_closed(known))


def isFree(known: GridMap, place: Point) -> bool:
    """Return whether the cell of a place is known to be free."""
    return is_free(known, cell(place, known.resolution))


@lru_cache(maxsize=8)  # the map is the same in many rounds
def _closed(known: GridMap) -> tuple[Grid, ...]:
    return tuple(
        Grid(known.x + i, known.y + j, known.resolution)
        for j in range(known.height)
        for i in range(known.width)
        if (known.cells[(j * known.width + i) >> 2] >> 2 * ((j * known.width + i) & 3)) & 3 != FREE
    )
