"""Distances of segments and paths, against exact integer arithmetic on pairs made to be hard."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

import pytest

from koordgen.runtime.values.geometry import LIMIT, clear, path_distance, segment_distance
from koordgen.runtime.values.points import Point, distance

Whole = tuple[int, int, int]
Pair = tuple[Point, Point, Point, Point]

RELATIVE, ABSOLUTE = 10**15, 10**75  # what geometry.py promises: a 1e-15 of the size, and 1e-75 m
FINE = 64  # exact distances are told to 2^-64 of the length of which all coordinates are multiples


def minus(a: Whole, b: Whole) -> Whole:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Whole, b: Whole) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Whole, b: Whole) -> Whole:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def from_segment(x: Whole, p: Whole, q: Whole) -> tuple[int, int]:
    """The exact squared distance of a point from a segment, as numerator and denominator."""
    d, v = minus(q, p), minus(x, p)
    along, length = dot(v, d), dot(d, d)
    if along <= 0:
        return dot(v, v), 1
    if along >= length:
        return dot(minus(x, q), minus(x, q)), 1
    return dot(v, v) * length - along * along, length


def exact(p: Whole, q: Whole, r: Whole, s: Whole) -> tuple[int, int]:
    """The exact squared distance of two segments, as numerator and denominator. A strictly convex function of the two
    places has its minimum where the gradient is zero when that is inside of the square; else, and for parallel
    segments, it is on the rim."""
    d, e, w = minus(q, p), minus(s, r), minus(r, p)
    dd, ee, de, dw, ew = dot(d, d), dot(e, e), dot(d, e), dot(d, w), dot(e, w)
    det = dd * ee - de * de
    if det and 0 <= dw * ee - ew * de <= det and 0 <= dw * de - ew * dd <= det:
        return dot(w, cross(d, e)) ** 2, det
    best = from_segment(p, r, s)
    for other in (from_segment(q, r, s), from_segment(r, p, q), from_segment(s, p, q)):
        if other[0] * best[1] < best[0] * other[1]:
            best = other
    return best


def whole(pair: Pair) -> tuple[tuple[Whole, Whole, Whole, Whole], int]:
    """The pair's coordinates as multiples of 1 / unit metres; the unit is a power of two."""
    ratios = [c.as_integer_ratio() for point in pair for c in (float(point.x), float(point.y), float(point.z))]
    unit = max(denominator for _, denominator in ratios)
    n = [numerator * (unit // denominator) for numerator, denominator in ratios]
    return ((n[0], n[1], n[2]), (n[3], n[4], n[5]), (n[6], n[7], n[8]), (n[9], n[10], n[11])), unit


# Pairs


class Maker:
    """Pairs of segments of many shapes, sizes and places; the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.shapes = (
            *(self.generic, self.lattice, self.parallel, self.nearly_parallel, self.collinear, self.shared_endpoint),
            *(self.points, self.crossing, self.needle, self.needle, self.long_and_short, self.touching),
        )

    def pairs(self, n: int) -> Iterator[Pair]:
        for i in range(n):
            pair = self.shapes[i % len(self.shapes)]()
            match self.random.randrange(8):
                case 0:
                    pair = scaled(pair, tenth(self.random, -60, 60))
                case 1:
                    pair = scaled(pair, tenth(self.random, -6, 6))
                case 2:
                    pair = moved(pair, self.vector(tenth(self.random, 2, 9)))
                case 3:
                    pair = (pair[2], pair[3], pair[1], pair[0])
            yield pair

    def vector(self, size: float = 10.0) -> Point:
        uniform = self.random.uniform
        return Point(uniform(-size, size), uniform(-size, size), uniform(-size, size))

    def node(self, n: int = 5) -> Point:
        whole = self.random.randint
        return Point(whole(-n, n), whole(-n, n), whole(-n, n))

    def small(self, least: int = -17) -> float:
        return tenth(self.random, least, -1)

    def generic(self) -> Pair:
        return self.vector(), self.vector(), self.vector(), self.vector()

    def lattice(self) -> Pair:
        """Few whole coordinates: crossing, touching, parallel, collinear and equal ones all come about."""
        n = self.random.choice((1, 2, 5))
        return self.node(n), self.node(n), self.node(n), self.node(n)

    def parallel(self) -> Pair:
        p, d, r = self.node(), self.node(), self.node()
        return p, p + d, r, r + d * self.random.choice((-3, -1, 0.5, 1, 2))

    def nearly_parallel(self) -> Pair:
        p, d, r = self.vector(), self.vector(), self.vector()
        return p, p + d, r, r + d * self.random.uniform(-2, 2) + self.vector() * self.small()

    def collinear(self) -> Pair:
        """On one line: apart, touching, overlapping or one within the other."""
        p, d = self.node(), self.node()
        a, b, c = (self.random.randint(-4, 4) * 0.5 for _ in range(3))
        return p, p + d * a, p + d * b, p + d * c

    def shared_endpoint(self) -> Pair:
        p = self.vector()
        near = self.vector() * self.random.choice((0.0, 0.0, self.small()))
        return p, self.vector(), p + near, self.vector()

    def points(self) -> Pair:
        """One of them, or both, a point; sometimes on the other's inside."""
        p, q, r = self.vector(), self.vector(), self.vector()
        on = p + (q - p) * self.random.random()
        return self.random.choice(
            ((p, p, r, r), (p, q, r, r), (p, p, q, r), (p, q, on, on), (p, p, p, p), (p, p, p, q))
        )

    def crossing(self) -> Pair:
        """Both near one place, a little apart."""
        x, d, e = self.vector(), self.vector(), self.vector()
        y = x + self.vector() * self.small()
        a, b, c, f = (self.random.random() for _ in range(4))
        return x - d * a, x + d * b, y - e * c, y + e * f

    def needle(self) -> Pair:
        """Nearly parallel and crossing nearly or wholly: the distance is far below that of the endpoints."""
        x, d = self.vector(), self.vector()
        e = d + self.vector() * self.small(-16)
        y = x + self.vector() * self.random.choice((0.0, self.small(-16)))
        a, b, c, f = (self.random.random() for _ in range(4))
        return x - d * a, x + d * b, y - e * c, y + e * f

    def long_and_short(self) -> Pair:
        p, r = self.vector(), self.vector()
        return p, p + self.vector() * tenth(self.random, -12, 6), r, r + self.vector() * self.small(-12)

    def touching(self) -> Pair:
        """An endpoint on the other's inside, to rounding or exactly."""
        p, d = self.node(), self.node()
        r = p + d * self.random.choice((0.25, 0.5, self.random.random()))
        return p, p + d, r, r + self.vector()


def scaled(pair: Pair, factor: float) -> Pair:
    p, q, r, s = pair
    return p * factor, q * factor, r * factor, s * factor


def moved(pair: Pair, by: Point) -> Pair:
    p, q, r, s = pair
    return p + by, q + by, r + by, s + by


# The study


class Figures(NamedTuple):
    """`worst` is the largest error in units of the tolerance; `close` counts pairs not farther apart than eps, `missed`
    those of them that were taken to be clear, `refused` the clear ones that were taken to be close."""

    pairs: int
    worst: float
    close: int
    missed: int
    refused: int


def spread(p: Whole, q: Whole, r: Whole, s: Whole) -> int:
    return max(max(axis) - min(axis) for axis in zip(p, q, r, s, strict=True))


def study(n: int, seed: int, measure: Callable[[Point, Point, Point, Point], float] = segment_distance) -> Figures:
    """Compares distances, and decisions for an eps near the truth, with exact ones; a decision counts where the truth
    differs from eps by more than the tolerance."""
    maker = Maker(seed)
    worst, close, missed, refused = 0.0, 0, 0, 0
    for pair in maker.pairs(n):
        ends, unit = whole(pair)
        unit <<= FINE
        numerator, denominator = exact(*ends)
        truth, size = math.isqrt((numerator << 2 * FINE) // denominator), spread(*ends) << FINE
        tolerance = size // RELATIVE + unit // ABSOLUTE + 1
        worst = max(worst, abs(in_units(measure(*pair), unit) - truth) / tolerance)
        eps = nearby(maker.random, truth / unit, size / unit)
        exact_eps = in_units(eps, unit)
        if abs(truth - exact_eps) > tolerance:
            near = truth <= exact_eps
            said = measure(*pair) <= eps
            close += near
            missed += near and not said
            refused += said and not near
    return Figures(n, worst, close, missed, refused)


def in_units(metres: float, unit: int) -> int:
    numerator, denominator = metres.as_integer_ratio()
    return numerator * unit // denominator


def nearby(source: random.Random, distance: float, size: float) -> float:
    """An eps mostly just beside the distance, else a share of the pair's size."""
    if source.random() < 0.3:
        return size * source.random()
    beside = distance * tenth(source, -15, -1) + size * tenth(source, -15, -9)
    return abs(distance + source.choice((-1, 1)) * beside)


def tenth(source: random.Random, least: float, most: float) -> float:
    """Ten to a power between the two."""
    return math.pow(10, source.uniform(least, most))


def test_the_exact_reference_agrees_with_points_on_the_segments() -> None:
    """None of 441 pairs of points is closer, and one is as close as their spacing allows."""
    maker = Maker(7)
    for _ in range(200):
        p, q, r, s = maker.lattice()
        n = 20
        least = min(distance(p + (q - p) * (i / n), r + (s - r) * (j / n)) for i in range(n + 1) for j in range(n + 1))
        numerator, denominator = exact(*whole((p, q, r, s))[0])
        truth = math.sqrt(numerator / denominator)
        assert truth <= least + 1e-12
        assert least <= truth + (distance(p, q) + distance(r, s)) / (2 * n) + 1e-12


def test_distances_and_decisions_are_right() -> None:
    figures = study(20_000, seed=1)
    assert figures.worst <= 1
    assert (figures.missed, figures.refused) == (0, 0)
    assert figures.close > 4_000
    assert figures.pairs - figures.close > 4_000


@pytest.mark.slow
def test_a_million_distances_and_decisions_are_right() -> None:
    figures = study(1_000_000, seed=2)
    print(figures)
    assert figures.worst <= 1
    assert (figures.missed, figures.refused) == (0, 0)


def endpoints_only(p: Point, q: Point, r: Point, s: Point) -> float:
    return min(
        segment_distance(p, p, r, s), segment_distance(q, q, r, s), *(segment_distance(p, q, x, x) for x in (r, s))
    )


def textbook(p: Point, q: Point, r: Point, s: Point) -> float:
    """The usual formula, whose denominator cancels for nearly parallel segments."""
    d, e, w = (Point(*(float(x) for x in (v.x, v.y, v.z))) for v in (q - p, s - r, r - p))
    a, b, c, f, g = (u.x * v.x + u.y * v.y + u.z * v.z for u, v in ((d, d), (d, e), (e, e), (d, w), (e, w)))
    det = a * c - b * b
    if det <= 1e-12 * a * c:
        return endpoints_only(p, q, r, s)
    t, u = (f * c - g * b) / det, (f * b - g * a) / det
    return distance(p + d * t, r + e * u) if 0 <= t <= 1 and 0 <= u <= 1 else endpoints_only(p, q, r, s)


@pytest.mark.parametrize("wrong", [endpoints_only, textbook])
def test_the_pairs_are_hard_enough_to_tell_lesser_formulas(
    wrong: Callable[[Point, Point, Point, Point], float],
) -> None:
    figures = study(2_000, seed=3, measure=wrong)
    assert figures.worst > 1e6
    assert figures.missed > 20


# Paths


def walk(source: random.Random, start: Point, n: int) -> tuple[Point, ...]:
    points = [start]
    for _ in range(n - 1):
        points.append(points[-1] + Point(source.uniform(-1, 2), source.uniform(-1, 1), source.uniform(-1, 1)))
    return tuple(points)


def test_a_path_is_as_close_as_its_closest_segments() -> None:
    source = random.Random(4)
    for _ in range(200):
        a = walk(source, Point(), source.randint(2, 8))
        b = walk(source, Point(source.uniform(-3, 9), source.uniform(-4, 4)), source.randint(2, 8))
        expected = min(segment_distance(*ab, *cd) for ab in pairwise(a) for cd in pairwise(b))
        for distance_of_both in (path_distance(a, b), path_distance(b, a), path_distance(a[::-1], b)):
            assert distance_of_both == pytest.approx(expected, rel=0, abs=1e-14)


def test_a_single_point_is_a_path_and_no_point_is_infinitely_far() -> None:
    line = (Point(0, 0, 0), Point(10, 0, 0))
    assert path_distance((Point(5, 2, 0),), line) == 2
    assert path_distance(line, (Point(13, 4, 0),)) == 5
    assert path_distance((Point(1, 2, 3),), (Point(1, 2, 3),)) == 0
    assert path_distance((), line) == path_distance(line, ()) == path_distance((), ()) == math.inf


def test_a_bend_that_crosses_between_two_points_is_seen() -> None:
    assert path_distance((Point(0, 0), Point(2, 2), Point(4, 0)), (Point(2, 0), Point(2, 9))) == 0


def test_clear_is_strict_and_wants_every_path() -> None:
    line = (Point(0, 0, 0), Point(10, 0, 0))
    near, far = (Point(0, 1, 0), Point(10, 1, 0)), (Point(0, 5, 0),)
    assert clear(line, (near, far), 0.5)
    assert not clear(line, (far, near), 1)  # exactly as far as eps is not clear
    assert not clear(line, (line,), 0)
    assert clear(line, ((), far), 4.999)
    assert clear((), (line, near), 100)
    assert clear(line, (), 100)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, LIMIT * 1.01, 1e308])
def test_no_distance_is_told_from_what_is_no_place(bad: float) -> None:
    """min() and comparisons lose a NaN, and a path with one would be taken for clear."""
    line, place = (Point(0, 0, 0), Point(1, 0, 0)), Point(0, bad, 0)
    for path in ((place,), (place, Point()), (Point(9, 9, 9), place)):
        with pytest.raises(ValueError, match="no distance can be told"):
            path_distance(line, path)
        with pytest.raises(ValueError, match="no distance can be told"):
            clear(path, (line,), 0.1)


def test_the_largest_places_do_not_overflow() -> None:
    corner = Point(LIMIT, LIMIT, LIMIT)
    assert segment_distance(-corner, corner, Point(-LIMIT, LIMIT, -LIMIT), Point(LIMIT, -LIMIT, LIMIT)) == 0
    assert segment_distance(corner, corner, -corner, -corner) == pytest.approx(2 * math.sqrt(3) * LIMIT)
