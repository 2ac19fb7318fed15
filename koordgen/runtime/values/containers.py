"""Koord's lists, queues, sets and maps as tuples.

Every function returns a new tuple; none changes its input.

A list or queue is a tuple (a queue's front first). A set is the tuple of its elements, ascending, without repetition. A
map is the tuple of its (key, value) pairs, keys ascending, without repetition. So equal sets are equal tuples. The
elements of one set, and the keys of one map, have one ordered type: int, bool, string, or tuples of those.

Python's own `==`, `in` and `count` compare parts by identity first, which differs from Koord's equality only for NaN.
So generated code checks for NaN first where it may occur (no_nan in points.py), also before it calls index_of and
removed.

OutOfRange, Missing, ValueError and ArithmeticError discard the event in which they are raised."""

from __future__ import annotations

import math
import reprlib
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import Any, Protocol, TypeVar, overload

from koordgen.runtime.values.turns import MOST_BITS, TOO_LONG, TooMuch, checked, made


class Key(Protocol):
    """Type of a set's element or a map's key."""

    def __lt__(self, other: Any, /) -> bool: ...


T = TypeVar("T")
K = TypeVar("K", bound=Key)
V = TypeVar("V")

MAX_EXPONENT = 1024

_key = itemgetter(0)


class OutOfRange(Exception):
    """An index outside of its list. Indices never count from the end."""


class Missing(Exception):
    """An element to be read or removed is missing."""


# Lists and queues


def at(xs: Sequence[T], i: int) -> T:
    """Return the i-th element, from 0. Raises OutOfRange unless 0 <= i < len."""
    return xs[_index(xs, i)]


def slice_(xs: tuple[T, ...], a: int | None, b: int | None) -> tuple[T, ...]:
    """Return the elements from a up to, not including, b; None is the start or the end.

    Bounds beyond the length are clipped. Raises OutOfRange for a negative one."""
    for bound in (a, b):
        if bound is not None and bound < 0:
            raise OutOfRange(f"{_shown(bound)} bounds no slice: indices never count from the end")
    return made(xs[a:b])


def updated(xs: tuple[T, ...], i: int, v: T) -> tuple[T, ...]:
    """Return xs with v as the i-th element. Raises OutOfRange unless 0 <= i < len."""
    _index(xs, i)
    return made((*xs[:i], v, *xs[i + 1 :]))


def appended(xs: tuple[T, ...], v: T) -> tuple[T, ...]:
    return made((*xs, v))


def extended(xs: tuple[T, ...], ys: tuple[T, ...]) -> tuple[T, ...]:
    return made(xs + ys)


def inserted(xs: tuple[T, ...], i: int, v: T) -> tuple[T, ...]:
    """Return xs with v before the i-th element, or at the end. Raises OutOfRange unless 0 <= i <= len."""
    if not 0 <= i <= len(xs):
        raise OutOfRange(f"{_shown(i)} is no place to insert at: places are 0 to {len(xs)}")
    return made((*xs[:i], v, *xs[i:]))


def removed(xs: tuple[T, ...], v: T) -> tuple[T, ...]:
    """Return xs without the first element that equals v. Raises Missing if there is none."""
    return without(xs, index_of(xs, v))


def without(xs: tuple[T, ...], i: int) -> tuple[T, ...]:
    """Return xs without its i-th element; a queue's front is the 0-th.

    Raises OutOfRange unless 0 <= i < len."""
    _index(xs, i)
    return made(xs[:i] + xs[i + 1 :])


def popped(xs: tuple[T, ...]) -> tuple[T, ...]:
    """Return xs without its last element. Raises Missing if xs is empty."""
    last(xs)
    return made(xs[:-1])


def first(xs: tuple[T, ...]) -> T:
    """Return the first element, a queue's front. Raises Missing if xs is empty."""
    if not xs:
        raise Missing("there is no first element: it is empty")
    return xs[0]


def last(xs: tuple[T, ...]) -> T:
    """Return the last element. Raises Missing if xs is empty."""
    if not xs:
        raise Missing("there is no last element: it is empty")
    return xs[-1]


def index_of(xs: tuple[T, ...], v: T) -> int:
    """Return the index of the first element that equals v. Raises Missing if there is none."""
    if v in xs:
        return xs.index(v)
    raise Missing(f"{_shown(v)} is not in the list")


def total(xs: Iterable[float]) -> float:
    """Return the sum from left to right, rounded at each step.

    Python's own `sum` compensates rounding errors from 3.12 on, and robots may have different versions."""
    found = 0.0
    for x in xs:
        found += x
    return found


def _index(xs: Sequence[Any], i: int) -> int:
    if not 0 <= i < len(xs):
        reason = f"indices are 0 to {len(xs) - 1}" if xs else "it is empty"
        raise OutOfRange(f"index {_shown(i)} is out of range: {reason}")
    return i


# Sets


def set_of(values: Iterable[K]) -> tuple[K, ...]:
    return tuple(sorted(set(values)))


def is_set(t: tuple[Any, ...]) -> bool:
    """Return whether a tuple of orderable elements, as from the network, is a set: strictly ascending."""
    return all(a < b for a, b in pairwise(t))


def set_with(s: tuple[K, ...], v: K) -> tuple[K, ...]:
    i = _place(s, v)
    return made(s if i < len(s) and s[i] == v else (*s[:i], v, *s[i:]))


def set_without(s: tuple[K, ...], v: K) -> tuple[K, ...]:
    """Return s without v. Raises Missing if v is not in s."""
    i = _place(s, v)
    if i == len(s) or s[i] != v:
        raise Missing(f"{_shown(v)} is not in the set")
    return made(s[:i] + s[i + 1 :])


def union(s: tuple[K, ...], t: tuple[K, ...]) -> tuple[K, ...]:
    return made(set_of(s + t))


def intersection(s: tuple[K, ...], t: tuple[K, ...]) -> tuple[K, ...]:
    there = set(t)
    return made(tuple(v for v in s if v in there))


def difference(s: tuple[K, ...], t: tuple[K, ...]) -> tuple[K, ...]:
    there = set(t)
    return made(tuple(v for v in s if v not in there))


def _place(s: tuple[K, ...], v: K) -> int:
    return bisect_left(s, v)


# Maps


def map_of(pairs: Iterable[tuple[K, V]]) -> tuple[tuple[K, V], ...]:
    """Return the map of these pairs; of several with one key the last counts."""
    return tuple(sorted(dict(pairs).items(), key=_key))


def is_map(t: tuple[tuple[Any, Any], ...]) -> bool:
    """Return whether a tuple of pairs, as from the network, is a map: keys strictly ascending."""
    return all(a[0] < b[0] for a, b in pairwise(t))


def map_at(m: tuple[tuple[K, V], ...], k: K) -> V:
    """Return the value of key k. Raises Missing if there is none."""
    return m[_found(m, k)][1]


def map_with(m: tuple[tuple[K, V], ...], k: K, v: V) -> tuple[tuple[K, V], ...]:
    i = _slot(m, k)
    return made((*m[:i], (k, v), *m[i + has_key(m, k) :]))


def map_without(m: tuple[tuple[K, V], ...], k: K) -> tuple[tuple[K, V], ...]:
    """Return m without key k. Raises Missing if k is not in m."""
    i = _found(m, k)
    return made(m[:i] + m[i + 1 :])


def map_get(m: tuple[tuple[K, V], ...], k: K, default: V) -> V:
    return map_at(m, k) if has_key(m, k) else default


def has_key(m: tuple[tuple[K, V], ...], k: K) -> bool:
    i = _slot(m, k)
    return i < len(m) and m[i][0] == k


def keys(m: tuple[tuple[K, V], ...]) -> tuple[K, ...]:
    return made(tuple(k for k, _ in m))


def values(m: tuple[tuple[K, V], ...]) -> tuple[V, ...]:
    return made(tuple(v for _, v in m))


def _slot(m: tuple[tuple[K, V], ...], k: K) -> int:
    """Return the index at which key k is, or would be."""
    return bisect_left(m, k, key=_key)


def _found(m: tuple[tuple[K, V], ...], k: K) -> int:
    if not has_key(m, k):
        raise Missing(f"the key {_shown(k)} is not in the map")
    return _slot(m, k)


# Numbers


@overload
def power(a: int, b: int) -> int: ...
@overload
def power(a: float, b: float) -> float: ...
def power(a: float, b: float) -> float:
    """Return a ** b; an int if both are.

    Raises ValueError for ints with a negative exponent, or with one above MAX_EXPONENT unless the base is -1, 0 or 1,
    and for floats without a real power. Raises OverflowError if the float would be infinite."""
    if not (isinstance(a, int) and isinstance(b, int)):
        return math.pow(a, b)
    if b < 0:
        raise ValueError("an int has no int power with a negative exponent: write the base as a float")
    if b > MAX_EXPONENT and abs(a) > 1:
        raise ValueError(f"the exponent of an int is at most {MAX_EXPONENT}: write the base as a float")
    if abs(a) > 1 and (abs(a).bit_length() - 1) * b >= MOST_BITS:  # too long even to be computed
        raise TooMuch(TOO_LONG)
    return checked(int(a**b))


def _shown(value: object) -> str:
    """Return a short representation of any value, for reasons in the log."""
    huge = isinstance(value, int) and value.bit_length() > 64
    return "an int beyond 64 bits" if huge else reprlib.repr(value)
