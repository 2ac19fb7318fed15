"""GridMap: occupancy grid of a rectangle of the plane. Each cell is unknown, free or occupied.

All maps of one resolution are windows of one lattice about the origin, so maps of different areas can be merged.
Knowledge only grows: a cell changes from unknown to free to occupied, and never back. Marking and merging are an OR of
the cells' bits. So merging is commutative, associative and idempotent, and the order in which a robot receives maps
does not matter."""

from __future__ import annotations

import math
from itertools import product

import msgspec

from koordgen.runtime.values.points import INT_MAX, INT_MIN, Grid, Point

FREE, OCCUPIED = 0b01, 0b11  # bits of a cell; 00 denotes an unknown cell, 10 is invalid
MAX_CELLS = 1 << 22  # largest number of cells: larger maps need too much memory, and too much time in a round

_SOUND = bytes(
    a << 6 | b << 4 | c << 2 | d for a, b, c, d in product((0, FREE, OCCUPIED), repeat=4)
)  # all bytes that represent four valid cells


class GridMap(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Occupancy grid: a window of `width` x `height` cells of a lattice; its lower left cell is (x, y).

    Cell (i, j) of the lattice is the square [i, i + 1) x [j, j + 1) in units of `resolution` metres. `cells` has two
    bits per cell, row by row from cell (x, y). The first of four cells in a byte has the lowest bits, and the last byte
    is padded with zeros. GridMap() is the empty map; every other map has cells."""

    resolution: float = 0.0
    x: int = 0
    y: int = 0
    width: int = 0
    height: int = 0
    cells: bytes = b""


def area(lo: Point, hi: Point, resolution: float) -> GridMap:
    """Return a map of the rectangle from lo to hi whose cells are all unknown. The z coordinates are ignored.

    The map contains all cells from the cell of lo to the last cells that begin before hi. Raises ValueError if lo is
    not below hi in x and in y, or if the map would have more than MAX_CELLS cells."""
    size = _size(resolution)
    if not (lo.x < hi.x and lo.y < hi.y):
        raise ValueError("a GridMap's first corner must be below its second in x and in y")
    x, y = math.floor(lo.x / size), math.floor(lo.y / size)
    width, height = math.ceil(hi.x / size) - x, math.ceil(hi.y / size) - y
    return _blank(size, x, y, max(width, 1), max(height, 1))  # rounding may give a width or height of 0


def cell(p: Point, size: float) -> Grid:
    """Return the cell that contains a point, in the lattice whose cells are `size` metres wide.

    Raises ValueError unless size is positive and finite."""
    return Grid(math.floor(p.x / _size(size)), math.floor(p.y / size), size)


def center(g: Grid) -> Point:
    """Return the centre of a cell, at z = 0."""
    return Point((g.x + 0.5) * g.size, (g.y + 0.5) * g.size, 0.0)


def is_free(m: GridMap, g: Grid) -> bool:
    """Return whether the map records a cell as free; False for a cell outside the map.

    Raises ValueError for a cell of another size."""
    return _code(m, g) == FREE


def is_occupied(m: GridMap, g: Grid) -> bool:
    """Return whether the map records a cell as occupied; False for a cell outside the map.

    Raises ValueError for a cell of another size."""
    return _code(m, g) == OCCUPIED


def is_known(m: GridMap, g: Grid) -> bool:
    """Return whether the map records a cell as free or as occupied; False for a cell outside the map.

    Raises ValueError for a cell of another size."""
    return _code(m, g) != 0


def mark_free(m: GridMap, g: Grid) -> GridMap:
    """Return the map m with a cell marked as free. An occupied cell stays occupied.

    Raises ValueError for a cell outside the map or of another size."""
    return _marked(m, g, FREE)


def mark_occupied(m: GridMap, g: Grid) -> GridMap:
    """Return the map m with a cell marked as occupied.

    Raises ValueError for a cell outside the map or of another size."""
    return _marked(m, g, OCCUPIED)


def merge(a: GridMap, b: GridMap) -> GridMap:
    """Return the smallest map that contains the maps a and b, with the knowledge of both. Other cells are unknown.

    Raises ValueError if the resolutions differ, or if the map would have more than MAX_CELLS cells."""
    if not a.width:
        return b
    if not b.width:
        return a
    if a.resolution != b.resolution:
        raise ValueError(f"maps of {a.resolution} m and of {b.resolution} m a cell do not merge")
    x, y = min(a.x, b.x), min(a.y, b.y)
    width, height = max(a.x + a.width, b.x + b.width) - x, max(a.y + a.height, b.y + b.height) - y
    window = _blank(a.resolution, x, y, width, height)
    bits = _bits(a, window) | _bits(b, window)
    return GridMap(a.resolution, x, y, width, height, bits.to_bytes(len(window.cells), "little"))


def sound(m: GridMap) -> bool:
    """Return whether a map, such as one from the network, could be a result of this module's functions.

    All other functions require such maps."""
    if m.width == 0 or m.height == 0:
        return m == GridMap()
    return (
        m.resolution > 0
        and math.isfinite(m.resolution)
        and 0 < m.width <= MAX_CELLS
        and 0 < m.height <= MAX_CELLS // m.width
        and INT_MIN <= m.x <= INT_MAX - m.width
        and INT_MIN <= m.y <= INT_MAX - m.height
        and len(m.cells) == _length(m.width, m.height)
        and m.cells[-1] >> 2 * ((m.width * m.height - 1) % 4 + 1) == 0
        and not m.cells.translate(None, _SOUND)
    )


def _size(size: float) -> float:
    if not 0 < size < math.inf:
        raise ValueError(f"the size of a cell must be positive: {size}")
    return size


def _length(width: int, height: int) -> int:
    return (width * height + 3) // 4


def _blank(resolution: float, x: int, y: int, width: int, height: int) -> GridMap:
    if width * height > MAX_CELLS:
        raise ValueError(f"a GridMap has at most {MAX_CELLS} cells")
    if min(x, y) < INT_MIN or max(x + width, y + height) > INT_MAX:
        raise ValueError("a GridMap's cells are numbered by ints of 64 bits")
    return GridMap(resolution, x, y, width, height, bytes(_length(width, height)))


def _bits(m: GridMap, window: GridMap) -> int:
    """Return the cells of map m as bits of an int, at their places in a larger `window`; the first cell is lowest."""
    bits = int.from_bytes(m.cells, "little")
    if m.width == window.width:
        return bits << 2 * m.width * (m.y - window.y)
    row, digits = (
        2 * m.width,
        f"{bits:0{2 * m.width * m.height}b}",
    )  # binary digits begin with the highest bit: rows from the last to the first
    left = "0" * (2 * (m.x - window.x))
    right = "0" * (2 * (window.width - m.width) - len(left))
    rows = "".join(f"{right}{digits[k : k + row]}{left}" for k in range(0, len(digits), row))
    return int(rows, 2) << 2 * window.width * (m.y - window.y)


def _index(m: GridMap, g: Grid) -> int | None:
    """Return the number of a cell in the map m, row by row from 0; None for a cell outside the map."""
    if not m.width:
        return None
    if g.size != m.resolution:
        raise ValueError(f"a cell of {g.size} m is none of a map of {m.resolution} m a cell")
    i, j = g.x - m.x, g.y - m.y
    return j * m.width + i if 0 <= i < m.width and 0 <= j < m.height else None


def _code(m: GridMap, g: Grid) -> int:
    k = _index(m, g)
    return 0 if k is None else m.cells[k // 4] >> 2 * (k % 4) & 0b11


def _marked(m: GridMap, g: Grid, code: int) -> GridMap:
    k = _index(m, g)
    if k is None:
        raise ValueError(f"cell ({g.x}, {g.y}) is outside of the map")
    cells = bytearray(m.cells)
    cells[k // 4] |= code << 2 * (k % 4)
    return GridMap(m.resolution, m.x, m.y, m.width, m.height, bytes(cells))
