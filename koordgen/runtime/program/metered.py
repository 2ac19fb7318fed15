"""Functions of geometry.py and gridmap.py for programs: each call also spends turns of the event.

CELLS_AN_ELEMENT cells of a GridMap count as one element. koordgen/lang/semantics/eval.py counts turns by the same
rules. Sensors, planners and simulations call geometry.py and gridmap.py directly, without a count."""

from __future__ import annotations

from koordgen.runtime.values import geometry, gridmap
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Point
from koordgen.runtime.values.turns import elements, looked_in, spend

PAIRS_A_TURN = 10  # number of pairs of points, one of each path, that cost one turn

Path = tuple[Point, ...]


def path_distance(a: Path, b: Path) -> float:
    """Return `geometry.path_distance(a, b)` after spending the call's turns. Raises TooMuch."""
    spend((len(a) + 1) * (len(b) + 1) // PAIRS_A_TURN)
    return geometry.path_distance(a, b)


def clear(path: Path, paths: tuple[Path, ...], eps: float) -> bool:
    """Return `geometry.clear(path, paths, eps)` after spending the call's turns. Raises TooMuch."""
    spend((len(path) + 1) * (sum(map(len, paths)) + len(paths)) // PAIRS_A_TURN)
    return geometry.clear(path, paths, eps)


def area(lo: Point, hi: Point, resolution: float) -> GridMap:
    """Return `gridmap.area(lo, hi, resolution)` and spend the call's turns. Raises TooMuch."""
    return looked_in(gridmap.area(lo, hi, resolution))


def mark_free(m: GridMap, g: Grid) -> GridMap:
    """Return `gridmap.mark_free(m, g)` and spend the call's turns. Raises TooMuch."""
    return looked_in(gridmap.mark_free(m, g))


def mark_occupied(m: GridMap, g: Grid) -> GridMap:
    """Return `gridmap.mark_occupied(m, g)` and spend the call's turns. Raises TooMuch."""
    return looked_in(gridmap.mark_occupied(m, g))


def merge(a: GridMap, b: GridMap) -> GridMap:
    """Return `gridmap.merge(a, b)` and spend the call's turns. Raises TooMuch.

    Each element costs one turn, because merging maps takes 100 times as long as copying them."""
    found = gridmap.merge(a, b)
    spend(elements(found))
    return found
