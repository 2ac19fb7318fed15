"""Extern function of task.koord: the cells of a map through which nobody may fly.

The function is pure: for the same map it returns the same value on every robot."""

from __future__ import annotations

from functools import lru_cache

from koordgen.runtime.values.gridmap import FREE, GridMap
from koordgen.runtime.values.points import Grid


def notFree(known: GridMap) -> list[Grid]:
    """Return the cells that are not known to be free."""
    return list(_closed(known))


@lru_cache(maxsize=8)  # the map is the same in many rounds
def _closed(known: GridMap) -> tuple[Grid, ...]:
    return tuple(
        Grid(known.x + i, known.y + j, known.resolution)
        for j in range(known.height)
        for i in range(known.width)
        if (known.cells[(j * known.width + i) >> 2] >> 2 * ((j * known.width + i) & 3)) & 3 != FREE
    )
