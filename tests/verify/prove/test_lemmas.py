"""Lemmas about distances hold for the values that robots compute, up to rounding."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.runtime.values.geometry import path_distance
from koordgen.runtime.values.points import Point, distance

NUMBERS = st.one_of(st.integers(-3, 3).map(float), st.floats(-100, 100, allow_subnormal=False))
POINTS = st.builds(Point, NUMBERS, NUMBERS, NUMBERS)
PATHS = st.lists(POINTS, min_size=1, max_size=4).map(tuple)
OFF = 1e-9  # metres of rounding, where coordinates are within 100 m


@settings(max_examples=200, deadline=None)
@given(PATHS, PATHS)
def test_of_two_paths(p: tuple[Point, ...], q: tuple[Point, ...]) -> None:
    apart = path_distance(p, q)
    assert apart >= 0
    assert abs(apart - path_distance(q, p)) <= OFF
    for end in (p[0], p[-1]):
        assert apart <= path_distance((end,), q) + OFF


@settings(max_examples=200, deadline=None)
@given(POINTS, POINTS)
def test_of_two_points(a: Point, b: Point) -> None:
    apart = distance(a, b)
    assert apart >= 0
    assert abs(apart - path_distance((a,), (b,))) <= OFF
    assert abs(apart - distance(b, a)) <= OFF
    assert (apart == 0) == (a == b) or apart < OFF
    square = (a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2
    assert abs(apart * apart - square) <= OFF * (1 + square)


@settings(max_examples=200, deadline=None)
@given(POINTS, POINTS, PATHS, PATHS)
def test_of_a_point_that_moves_and_of_the_way_past_it(
    a: Point, b: Point, p: tuple[Point, ...], q: tuple[Point, ...]
) -> None:
    moved = distance(a, b)
    assert abs(path_distance((a,), p) - path_distance((b,), p)) <= moved + OFF
    assert path_distance(p, q) <= path_distance((a,), p) + path_distance((a,), q) + OFF
    # An end of a path is on it.
    assert path_distance((p[0],), p) <= OFF
    assert path_distance((p[-1],), p) <= OFF
