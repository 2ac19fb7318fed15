"""Geometry and GridMaps as programs call them: geometry.py and gridmap.py, for the turns that they cost.

A GridMap counts as one element for CELLS_AN_ELEMENT cells. koordgen/lang/semantics/eval.py counts the same.
Sensors, planners and simulations call geometry.py and gridmap.py themselves: no event pays for them.
"""

from __future__ import annotations

from koordgen.runtime.values import geometry, gridmap
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Point
from koordgen.runtime.values.turns import elements, looked_in, spend

PAIRS_A_TURN = 10  # of points of two paths

Path = tuple[Point, ...]


def path_distance(a: Path, b: Path) -> float:
    """Do what the function of this name in geometry.py does, within the limit. Raises TooMuch."""
    spend((len(a) + 1) * (len(b) + 1) // PAIRS_A_TURN)
    return geometry.path_distance(a, b)


def clear(path: Path, paths: tuple[Path, ...], eps: float) -> bool:
    """Do what the function of this name in geometry.py does, within the limit. Raises TooMuch."""
    spend((len(path) + 1) * (sum(map(len, paths)) + len(paths)) // PAIRS_A_TURN)
    return geometry.clear(path, paths, eps)


def area(lo: Point, hi: Point, resolution: float) -> GridMap:
    """As in gridmap.py. Raises TooMuch."""
    return looked_in(gridmap.area(lo, hi, resolution))


def mark_free(m: GridMap, g: Grid) -> GridMap:
    """As in gridmap.py. Raises TooMuch."""
    return looked_in(gridmap.mark_free(m, g))


def mark_occupied(m: GridMap, g: Grid) -> GridMap:
    """As in gridmap.py. Raises TooMuch."""
    return looked_in(gridmap.mark_occupied(m, g))


def merge(a: GridMap, b: GridMap) -> GridMap:
    """As in gridmap.py: it goes through all cells, which takes 100 times as long as to copy them. Raises TooMuch."""
    found = gridmap.merge(a, b)
    spend(elements(found))
    return found
