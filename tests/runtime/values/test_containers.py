"""Lists, sets and maps as tuples, against Python's own list, set and dict."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest

from koordgen.runtime.program.program import Slots
from koordgen.runtime.values import containers as c
from koordgen.runtime.values.containers import Missing, OutOfRange

XS = (3, 1, 4, 1)


def test_list_updates_make_new_lists() -> None:
    assert c.at(XS, 2) == 4
    assert c.updated(XS, 1, 9) == (3, 9, 4, 1)
    assert c.appended(XS, 9) == (3, 1, 4, 1, 9)
    assert c.extended(XS, (5, 9)) == (3, 1, 4, 1, 5, 9)
    assert c.inserted(XS, 0, 9) == (9, 3, 1, 4, 1)
    assert c.inserted(XS, 4, 9) == (3, 1, 4, 1, 9)
    assert c.removed(XS, 1) == (3, 4, 1)  # the first of two
    assert c.without(XS, 0) == (1, 4, 1)
    assert c.popped(XS) == (3, 1, 4)
    assert (c.first(XS), c.last(XS), c.index_of(XS, 1)) == (3, 1, 1)
    assert XS == (3, 1, 4, 1)


def test_a_sum_is_rounded_at_each_step() -> None:
    """Python compensates from 3.12 on, and would say 2.0 of the first."""
    assert c.total((1e16, 1.0, 1.0, -1e16)) == 0.0
    assert repr(c.total((-0.0,))) == "0.0"
    assert repr(c.total(())) == "0.0"


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (1, 3, (1, 4)),
        (None, 2, (3, 1)),
        (2, None, (4, 1)),
        (None, None, XS),
        (3, 99, (1,)),
        (98, 99, ()),
        (3, 1, ()),
        (0, 10**30, XS),
    ],
)
def test_slices_are_clipped(a: int | None, b: int | None, expected: tuple[int, ...]) -> None:
    assert c.slice_(XS, a, b) == expected


@pytest.mark.parametrize(
    "fault",
    [
        lambda: c.at(XS, 4),
        lambda: c.at(XS, -1),
        lambda: c.at((), 0),
        lambda: c.at(XS, 10**400),
        lambda: c.updated(XS, 4, 0),
        lambda: c.updated(XS, -1, 0),
        lambda: c.inserted(XS, 5, 0),
        lambda: c.inserted(XS, -1, 0),
        lambda: c.without(XS, 4),
        lambda: c.without(XS, -1),
        lambda: c.without((), 0),
        lambda: c.slice_(XS, -1, None),
        lambda: c.slice_(XS, 0, -1),
        lambda: c.slice_(XS, -(10**5000), None),
    ],
)
def test_indices_outside_discard(fault: Callable[[], object]) -> None:
    with pytest.raises(OutOfRange):
        fault()


NONE: tuple[int, ...] = ()
M = ((1, "a"), (3, "c"))


@pytest.mark.parametrize(
    "fault",
    [
        lambda: c.removed(XS, 9),
        lambda: c.index_of(XS, 9),
        lambda: c.popped(NONE),
        lambda: c.first(NONE),
        lambda: c.last(NONE),
        lambda: c.set_without((1, 3), 2),
        lambda: c.set_without((1, 3), 4),
        lambda: c.set_without(NONE, 1),
        lambda: c.map_at(M, 2),
        lambda: c.map_at(M, 4),
        lambda: c.map_without(M, 0),
    ],
)
def test_what_is_not_there_discards(fault: Callable[[], object]) -> None:
    with pytest.raises(Missing):
        fault()


def test_reasons_name_the_thing_and_stay_short() -> None:
    with pytest.raises(OutOfRange, match="index 4 is out of range: indices are 0 to 3"):
        c.at(XS, 4)
    with pytest.raises(OutOfRange, match="index 0 is out of range: it is empty"):
        c.at((), 0)
    with pytest.raises(Missing, match="the key 'b' is not in the map"):
        c.map_at((("a", 1),), "b")
    with pytest.raises(Missing) as caught:
        c.index_of((), "x" * 100_000)
    assert len(str(caught.value)) < 100


def test_a_slot_of_no_robot_is_out_of_range() -> None:
    with pytest.raises(OutOfRange, match="names no robot"):
        Slots([1, 2], 0)[2]


def key_maker(source: random.Random) -> Callable[[], Any]:
    """Makes keys of one type, few enough to meet again."""

    def number() -> int:
        return source.randint(-6, 6)

    def text() -> str:
        return source.choice(("", "a", "b", "ab", "ä", "Z", "\U0001f916"))

    def flag() -> bool:
        return source.random() < 0.5

    return source.choice((number, text, flag, lambda: (number(), text()), lambda: (flag(), (text(), number()))))


@pytest.mark.parametrize("seed", range(40))
def test_sets_behave_as_pythons(seed: int) -> None:
    source = random.Random(seed)
    key = key_maker(source)
    mine: tuple[Any, ...] = ()
    theirs: set[Any] = set()
    for _ in range(200):
        v, other = key(), {key() for _ in range(source.randint(0, 6))}
        match source.randrange(6):
            case 0 | 1:
                mine, theirs = c.set_with(mine, v), theirs | {v}
            case 2 if v in theirs:
                mine, theirs = c.set_without(mine, v), theirs - {v}
            case 3:
                mine, theirs = c.union(mine, c.set_of(other)), theirs | other
            case 4:
                mine, theirs = c.difference(mine, c.set_of(other)), theirs - other
            case 5:
                assert c.intersection(mine, c.set_of(other)) == tuple(sorted(theirs & other))
        assert mine == tuple(sorted(theirs)) == c.set_of(theirs)
        assert c.is_set(mine)


@pytest.mark.parametrize("seed", range(40))
def test_maps_behave_as_pythons(seed: int) -> None:
    source = random.Random(seed)
    key = key_maker(source)
    mine: tuple[tuple[Any, float], ...] = ()
    theirs: dict[Any, float] = {}
    for _ in range(200):
        k, v = key(), source.random()
        if source.random() < 0.6:
            mine, theirs = c.map_with(mine, k, v), {**theirs, k: v}
        elif k in theirs:
            assert c.map_at(mine, k) == theirs.pop(k)
            mine = c.map_without(mine, k)
        assert mine == tuple(sorted(theirs.items())) == c.map_of(theirs.items())
        assert c.is_map(mine)
        assert c.has_key(mine, k) == (k in theirs)
        assert c.map_get(mine, k, -1.0) == theirs.get(k, -1.0)
        assert c.keys(mine) == tuple(sorted(theirs))
        assert dict(zip(c.keys(mine), c.values(mine), strict=True)) == theirs


def test_of_several_pairs_with_one_key_the_last_counts() -> None:
    assert c.map_of([(2, "a"), (1, "b"), (2, "c")]) == ((1, "b"), (2, "c"))


def test_values_of_a_map_are_never_compared() -> None:
    m = c.map_of([(2, 1j), (1, 2j)])  # complex numbers have no order
    assert c.map_with(c.map_with(m, 1, 3j), 0, 4j) == ((0, 4j), (1, 3j), (2, 1j))
    assert c.is_map(m)


@pytest.mark.parametrize(
    ("t", "canonical"),
    [((), True), ((1,), True), ((1, 2), True), ((1, 1), False), ((2, 1), False), ((1, 3, 2), False)],
)
def test_only_ascending_tuples_are_sets_and_maps(t: tuple[int, ...], canonical: bool) -> None:
    assert c.is_set(t) == canonical
    assert c.is_map(tuple((k, 0) for k in t)) == canonical
    assert c.is_map(tuple((k, i) for i, k in enumerate(t))) == canonical  # values play no part


def test_powers() -> None:
    assert (c.power(2, 10), type(c.power(2, 10))) == (1024, int)
    assert (c.power(0, 0), c.power(-3, 3), c.power(7, 0)) == (1, -27, 1)
    assert c.power(2, 1024) == 2**1024
    assert (c.power(1, 10**9), c.power(-1, 10**9 + 1), c.power(0, 10**9)) == (1, -1, 0)
    assert (c.power(2.0, -1), c.power(4, 0.5), c.power(2, -1.0)) == (0.5, 2.0, 0.5)


@pytest.mark.parametrize(("a", "b"), [(2, -1), (1, -1), (0, -1), (2, 1025), (-2, 10**30), (-8.0, 1 / 3), (0.0, -1)])
def test_powers_that_are_no_value_discard(a: float, b: float) -> None:
    with pytest.raises(ValueError):
        c.power(a, b)


@pytest.mark.parametrize(("a", "b"), [(10.0, 400), (10**400, 0.5), (2, 1e9)])
def test_powers_too_large_for_a_float_discard(a: float, b: float) -> None:
    with pytest.raises(OverflowError):
        c.power(a, b)
