"""Geometry and GridMaps as programs call them: geometry.py and gridmap.py with a count of turns.

A GridMap counts as one element for CELLS_AN_ELEMENT cells. koordgen/lang/semantics/eval.py counts the same. Sensors,
planners and simulations call geometry.py and gridmap.py directly, without a count."""

from __future__ import annotations

from koordgen.runtime.values import geometry, gridmap
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Point
from koordgen.runtime.values.turns import elements, looked_in, spend

PAIRS_A_TURN = 10  # pairs of points of two paths

Path = tuple[Point, ...]


def path_distance(a: Path, b: Path) -> float:
    """Call the function of geometry.py within the limit of turns. Raises TooMuch."""
    spend((len(a) + 1) * (len(b) + 1) // PAIRS_A_TURN)
    return geometry.path_distance(a, b)


def clear(path: Path, paths: tuple[Path, ...], eps: float) -> bool:
    """Call the function of geometry.py within the limit of turns. Raises TooMuch."""
    spend((len(path) + 1) * (sum(map(len, paths)) + len(paths)) // PAIRS_A_TURN)
    return geometry.clear(path, paths, eps)


def area(lo: Point, hi: Point, resolution: float) -> GridMap:
    """Call the function of gridmap.py within the limit of turns. Raises TooMuch."""
    return looked_in(gridmap.area(lo, hi, resolution))


def mark_free(m: GridMap, g: Grid) -> GridMap:
    """Call the function of gridmap.py within the limit of turns. Raises TooMuch."""
    return looked_in(gridmap.mark_free(m, g))


def mark_occupied(m: GridMap, g: Grid) -> GridMap:
    """Call the function of gridmap.py within the limit of turns. Raises TooMuch."""
    return looked_in(gridmap.mark_occupied(m, g))


def merge(a: GridMap, b: GridMap) -> GridMap:
    """Call the function of gridmap.py within the limit of turns. Raises TooMuch.

    It visits all cells, which takes 100 times as long as copying them."""
    found = gridmap.merge(a, b)
    spend(elements(found))
    return found
