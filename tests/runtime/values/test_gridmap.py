"""Grid maps, against dictionaries from cells to what is known."""

from __future__ import annotations

import math
import random
from itertools import permutations, product

import msgspec
import pytest

from koordgen.runtime.values import gridmap
from koordgen.runtime.values.gridmap import (
    MAX_CELLS,
    GridMap,
    area,
    cell,
    center,
    is_free,
    is_known,
    is_occupied,
    mark_free,
    mark_occupied,
    merge,
    sound,
)
from koordgen.runtime.values.points import INT_MAX, INT_MIN, Grid, Point

SIZE = 0.25
UNKNOWN, FREE, OCCUPIED = 0, 1, 2  # ascending as the join goes


def window(x: int, y: int, width: int, height: int) -> GridMap:
    lo = Point(x * SIZE, y * SIZE)
    return area(lo, lo + Point(width * SIZE, height * SIZE), SIZE)


def scribbled(source: random.Random, m: GridMap) -> tuple[GridMap, dict[tuple[int, int], int]]:
    """A map with marks at random, and what it should know."""
    known: dict[tuple[int, int], int] = {}
    for _ in range(source.randint(0, 2 * m.width * m.height)):
        i, j = m.x + source.randrange(m.width), m.y + source.randrange(m.height)
        code = source.choice((FREE, OCCUPIED))
        m = (mark_free if code == FREE else mark_occupied)(m, Grid(i, j, SIZE))
        known[i, j] = max(known.get((i, j), UNKNOWN), code)
    return m, known


def knowledge(m: GridMap, reach: int = 16) -> dict[tuple[int, int], int]:
    """What a map tells of all cells near the origin, its window or not."""
    found = {}
    for i, j in product(range(-reach, reach), repeat=2):
        g = Grid(i, j, SIZE)
        assert is_known(m, g) == (is_free(m, g) or is_occupied(m, g))
        assert not (is_free(m, g) and is_occupied(m, g))
        if is_known(m, g):
            found[i, j] = FREE if is_free(m, g) else OCCUPIED
    return found


def anywhere(source: random.Random) -> GridMap:
    return window(*(source.randint(-6, 3) for _ in range(2)), *(source.randint(1, 9) for _ in range(2)))


@pytest.mark.parametrize("seed", range(60))
def test_maps_know_what_they_were_told_and_merge_as_dictionaries(seed: int) -> None:
    source = random.Random(seed)
    (a, known_a), (b, known_b) = scribbled(source, anywhere(source)), scribbled(source, anywhere(source))
    assert knowledge(a) == known_a
    both = merge(a, b)
    assert knowledge(both) == {k: max(known_a.get(k, 0), known_b.get(k, 0)) for k in known_a | known_b}
    assert (both.x, both.y) == (min(a.x, b.x), min(a.y, b.y))
    assert both.x + both.width == max(a.x + a.width, b.x + b.width)
    assert both.y + both.height == max(a.y + a.height, b.y + b.height)
    assert sound(a) and sound(b) and sound(both)


@pytest.mark.parametrize("seed", range(30))
def test_merge_is_a_join(seed: int) -> None:
    source = random.Random(seed)
    maps = [scribbled(source, anywhere(source))[0] for _ in range(3)]
    results = {merge(merge(a, b), c) for a, b, c in permutations(maps)}
    results |= {merge(a, merge(b, c)) for a, b, c in permutations(maps)}
    assert len(results) == 1  # order and grouping do not matter
    (joined,) = results
    for m in maps:
        assert merge(m, m) == merge(m, GridMap()) == merge(GridMap(), m) == m
        assert merge(joined, m) == joined


def test_the_same_knowledge_in_the_same_window_is_the_same_value() -> None:
    source = random.Random(1)
    marks = [(source.randrange(5), source.randrange(5), source.random() < 0.5) for _ in range(40)]
    results = set()
    for _ in range(20):
        source.shuffle(marks)
        m = window(0, 0, 5, 5)
        for i, j, free in marks:
            m = (mark_free if free else mark_occupied)(m, Grid(i, j, SIZE))
        results.add(msgspec.msgpack.encode(m))
    assert len(results) == 1


def test_occupied_stays_occupied() -> None:
    g = Grid(1, 1, SIZE)
    m = mark_free(mark_occupied(mark_free(window(0, 0, 3, 3), g), g), g)
    assert is_occupied(m, g)
    assert not is_free(m, g)


def test_layout_of_cells() -> None:
    m = window(-1, 2, 3, 2)
    assert m == GridMap(SIZE, -1, 2, 3, 2, b"\0\0")
    m = mark_occupied(mark_free(m, Grid(-1, 2, SIZE)), Grid(1, 3, SIZE))
    assert m.cells == bytes((0b01, 0b11 << 2))


@pytest.mark.parametrize(
    ("lo", "hi", "expected"),
    [
        (Point(0, 0), Point(1, 0.5), (0, 0, 4, 2)),
        (Point(0.1, 0.1), Point(0.2, 0.2), (0, 0, 1, 1)),
        (Point(-0.1, 0), Point(0.1, 0.26), (-1, 0, 2, 2)),
        (Point(-1, -1, 5), Point(-0.5, -0.75, -5), (-4, -4, 2, 1)),
    ],
)
def test_an_area_is_the_cells_it_touches(lo: Point, hi: Point, expected: tuple[int, int, int, int]) -> None:
    m = area(lo, hi, SIZE)
    assert (m.x, m.y, m.width, m.height) == expected
    assert sound(m)
    assert not knowledge(m)


def test_an_area_is_never_empty_whatever_rounding_does() -> None:
    source = random.Random(2)
    for _ in range(20_000):
        size = source.choice((0.1, 0.3, 0.05, 1 / 3))
        hi = source.randint(-50, 50) * size
        lo = math.nextafter(hi, -math.inf) if source.random() < 0.5 else hi - source.random() * size
        m = area(Point(lo, lo), Point(hi, hi), size)
        assert sound(m)
        assert is_known(mark_free(m, cell(Point(lo, lo), size)), cell(Point(lo, lo), size))


@pytest.mark.parametrize(
    ("lo", "hi", "size"),
    [
        (Point(0, 0), Point(0, 1), 0.5),
        (Point(1, 0), Point(0, 1), 0.5),
        (Point(0, 0), Point(1, 1), 0),
        (Point(0, 0), Point(1, 1), -0.5),
        (Point(0, 0), Point(1, 1), math.inf),
        (Point(0, 0), Point(1, 1), math.nan),
        (Point(math.nan, 0), Point(1, 1), 0.5),
        (Point(0, 0), Point(1e9, 1e9), 0.001),
        (Point(1e300, 0), Point(2e300, 1), 1e300 / 2**62),
        (Point(2.0**62, 0), Point(2.0**62 + 1024, 1), 0.25),
        (Point(0, -(2.0**62)), Point(1, -(2.0**62) + 1024), 0.25),
    ],
)
def test_no_area_discards(lo: Point, hi: Point, size: float) -> None:
    with pytest.raises(ValueError):
        area(lo, hi, size)


def test_an_infinite_area_discards() -> None:
    with pytest.raises((ValueError, ArithmeticError)):
        area(Point(0, 0), Point(math.inf, 1), 0.5)


def test_the_empty_map_knows_nothing_of_any_cell_and_takes_no_mark() -> None:
    for size in (0.1, 7.0):
        g = Grid(0, 0, size)
        assert not (is_known(GridMap(), g) or is_free(GridMap(), g) or is_occupied(GridMap(), g))
        with pytest.raises(ValueError, match="outside"):
            mark_free(GridMap(), g)


@pytest.mark.parametrize("place", [(-1, 0), (0, -1), (3, 0), (0, 2), (10**30, 0)])
def test_marks_outside_of_the_window_discard(place: tuple[int, int]) -> None:
    m, g = window(0, 0, 3, 2), Grid(*place, SIZE)
    assert not is_known(m, g)
    for mark in (mark_free, mark_occupied):
        with pytest.raises(ValueError, match="outside"):
            mark(m, g)


def test_cells_and_maps_of_another_size_discard() -> None:
    m, g = window(0, 0, 3, 2), Grid(0, 0, 0.5)
    for use in (is_free, is_occupied, is_known, mark_free, mark_occupied):
        with pytest.raises(ValueError, match=r"a cell of 0\.5 m"):
            use(m, g)
    with pytest.raises(ValueError, match="do not merge"):
        merge(m, area(Point(), Point(1, 1), 0.5))


def test_maps_too_far_apart_do_not_merge() -> None:
    """A hostile or lost robot's map must not take this one's memory."""
    for far in (GridMap(SIZE, INT_MAX - 9, 0, 1, 1, b"\1"), GridMap(SIZE, MAX_CELLS, 0, 1, 1, b"\1")):
        assert sound(far)
        with pytest.raises(ValueError, match="at most"):
            merge(window(0, 0, 3, 3), far)


def test_a_point_lies_in_its_cell_and_a_center_in_its_own() -> None:
    assert cell(Point(-0.1, 0.6, 9), 0.5) == Grid(-1, 1, 0.5)
    assert center(Grid(-1, 1, 0.5)) == Point(-0.25, 0.75, 0)
    source = random.Random(3)
    for _ in range(2_000):
        g = Grid(source.randint(-1000, 1000), source.randint(-1000, 1000), source.choice((0.1, 0.3, 1 / 3, 2.5)))
        assert cell(center(g), g.size) == g
    for size in (0, -1, math.nan, math.inf):
        with pytest.raises(ValueError, match="must be positive"):
            cell(Point(), size)


UNSOUND = [
    GridMap(SIZE),  # the empty map has one form
    GridMap(0, 1),
    GridMap(0, 0, 0, 0, 0, b"\0"),
    GridMap(SIZE, 0, 0, 3, 0),
    GridMap(0, 0, 0, 1, 1, b"\0"),
    GridMap(-SIZE, 0, 0, 1, 1, b"\0"),
    GridMap(math.inf, 0, 0, 1, 1, b"\0"),
    GridMap(math.nan, 0, 0, 1, 1, b"\0"),
    GridMap(SIZE, 0, 0, -1, -1, b"\0"),
    GridMap(SIZE, 0, 0, -1, 1, b""),
    GridMap(SIZE, 0, 0, 1, 1, b""),
    GridMap(SIZE, 0, 0, 2, 2, b"\0\0"),
    GridMap(SIZE, 0, 0, 5, 1, b"\0"),
    GridMap(SIZE, 0, 0, 1, 1, b"\x04"),  # padding
    GridMap(SIZE, 0, 0, 5, 1, b"\0\x40"),
    GridMap(SIZE, 0, 0, 1, 1, b"\x02"),  # a cell that is neither free nor occupied nor unknown
    GridMap(SIZE, 0, 0, 2, 2, b"\x80"),
    GridMap(SIZE, INT_MAX, 0, 1, 1, b"\0"),
    GridMap(SIZE, 0, INT_MIN - 1, 1, 1, b"\0"),
    GridMap(SIZE, 0, 0, MAX_CELLS + 1, 1, bytes(MAX_CELLS // 4 + 1)),
    GridMap(SIZE, 0, 0, 2**62, 2**62, b"\0"),
]


@pytest.mark.parametrize("m", UNSOUND, ids=lambda m: f"{m.resolution}-{m.x}-{m.y}-{m.width}-{m.height}-{m.cells[:2]!r}")
def test_maps_that_nobody_made_are_unsound(m: GridMap) -> None:
    assert not sound(m)


def test_every_byte_of_sound_cells_is_sound_and_no_other() -> None:
    for byte in range(256):
        pairs = [byte >> shift & 3 for shift in (0, 2, 4, 6)]
        assert sound(GridMap(SIZE, 0, 0, 4, 1, bytes((byte,)))) == (0b10 not in pairs)
    assert sound(GridMap())


def test_the_largest_map_merges() -> None:
    side = math.isqrt(MAX_CELLS)
    whole, part = window(0, 0, side, side), mark_free(window(3, 5, side - 7, side - 9), Grid(3, 5, SIZE))
    assert knowledge(merge(whole, part)) == {(3, 5): gridmap.FREE}
