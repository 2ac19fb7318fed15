"""Lists, queues, sets and maps of Koord, represented as tuples.

Every function returns a new tuple, and no function changes its arguments.

A list or a queue is the tuple of its elements; a queue's front is the first. A set is the tuple of its elements in
ascending order, without repetition. A map is the tuple of its (key, value) pairs, with keys in ascending order, without
repetition. So equal sets are equal tuples. All elements of a set, and all keys of a map, have one ordered type: int,
bool, string, or tuples of these.

Python's `==`, `in` and `count` first compare parts by identity. This differs from Koord's equality only for NaN. So
generated code checks for NaN (no_nan in points.py) before comparisons and before calls of index_of and removed, unless
the values cannot contain NaN.

An exception OutOfRange, Missing, ValueError or ArithmeticError discards the event that raised it."""

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
    """Type of the elements of a set and of the keys of a map."""

    def __lt__(self, other: Any, /) -> bool: ...


T = TypeVar("T")
K = TypeVar("K", bound=Key)
V = TypeVar("V")

MAX_EXPONENT = 1024

_key = itemgetter(0)


class OutOfRange(Exception):
    """Raised for an index outside of a list. A negative index is outside: indices never count from the end."""


class Missing(Exception):
    """Raised if an element to be read or removed is missing."""


# Lists and queues


def at(xs: Sequence[T], i: int) -> T:
    """Return the element with index i; the first index is 0. Raises OutOfRange unless 0 <= i < len(xs)."""
    return xs[_index(xs, i)]


def slice_(xs: tuple[T, ...], a: int | None, b: int | None) -> tuple[T, ...]:
    """Return the elements with indices from a to b - 1. None for a denotes the start, None for b the end.

    A bound beyond the length counts as the length. Raises OutOfRange for a negative bound."""
    for bound in (a, b):
        if bound is not None and bound < 0:
            raise OutOfRange(f"{_shown(bound)} bounds no slice: indices never count from the end")
    return made(xs[a:b])


def updated(xs: tuple[T, ...], i: int, v: T) -> tuple[T, ...]:
    """Return xs with v as the element with index i. Raises OutOfRange unless 0 <= i < len(xs)."""
    _index(xs, i)
    return made((*xs[:i], v, *xs[i + 1 :]))


def appended(xs: tuple[T, ...], v: T) -> tuple[T, ...]:
    return made((*xs, v))


def extended(xs: tuple[T, ...], ys: tuple[T, ...]) -> tuple[T, ...]:
    return made(xs + ys)


def inserted(xs: tuple[T, ...], i: int, v: T) -> tuple[T, ...]:
    """Return xs with v inserted at index i; len(xs) denotes the end. Raises OutOfRange unless 0 <= i <= len(xs)."""
    if not 0 <= i <= len(xs):
        raise OutOfRange(f"{_shown(i)} is no place to insert at: places are 0 to {len(xs)}")
    return made((*xs[:i], v, *xs[i:]))


def removed(xs: tuple[T, ...], v: T) -> tuple[T, ...]:
    """Return xs without the first element that equals v. Raises Missing if no element equals v."""
    return without(xs, index_of(xs, v))


def without(xs: tuple[T, ...], i: int) -> tuple[T, ...]:
    """Return xs without the element with index i; the front of a queue has index 0.

    Raises OutOfRange unless 0 <= i < len(xs)."""
    _index(xs, i)
    return made(xs[:i] + xs[i + 1 :])


def popped(xs: tuple[T, ...]) -> tuple[T, ...]:
    """Return xs without its last element. Raises Missing if xs is empty."""
    last(xs)
    return made(xs[:-1])


def first(xs: tuple[T, ...]) -> T:
    """Return the first element of a list, or the front of a queue. Raises Missing if xs is empty."""
    if not xs:
        raise Missing("there is no first element: it is empty")
    return xs[0]


def last(xs: tuple[T, ...]) -> T:
    """Return the last element of a list or queue. Raises Missing if xs is empty."""
    if not xs:
        raise Missing("there is no last element: it is empty")
    return xs[-1]


def index_of(xs: tuple[T, ...], v: T) -> int:
    """Return the index of the first element that equals v. Raises Missing if no element equals v."""
    if v in xs:
        return xs.index(v)
    raise Missing(f"{_shown(v)} is not in the list")


def total(xs: Iterable[float]) -> float:
    """Return the sum of the numbers, added from left to right and rounded after each addition.

    Python's `sum` is not used: since Python 3.12 it compensates rounding errors, and robots may have different versions
    of Python."""
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
    """Return whether a tuple, such as one from the network, represents a set: its elements are strictly ascending."""
    return all(a < b for a, b in pairwise(t))


def set_with(s: tuple[K, ...], v: K) -> tuple[K, ...]:
    i = _place(s, v)
    return made(s if i < len(s) and s[i] == v else (*s[:i], v, *s[i:]))


def set_without(s: tuple[K, ...], v: K) -> tuple[K, ...]:
    """Return the set s without the element v. Raises Missing if v is not in s."""
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
    """Return the map with the (key, value) pairs. If several pairs have one key, the last pair counts."""
    return tuple(sorted(dict(pairs).items(), key=_key))


def is_map(t: tuple[tuple[Any, Any], ...]) -> bool:
    """Return whether a tuple of pairs, such as one from the network, represents a map: keys are strictly ascending."""
    return all(a[0] < b[0] for a, b in pairwise(t))


def map_at(m: tuple[tuple[K, V], ...], k: K) -> V:
    """Return the value of key k in the map m. Raises Missing if k is not in m."""
    return m[_found(m, k)][1]


def map_with(m: tuple[tuple[K, V], ...], k: K, v: V) -> tuple[tuple[K, V], ...]:
    i = _slot(m, k)
    return made((*m[:i], (k, v), *m[i + has_key(m, k) :]))


def map_without(m: tuple[tuple[K, V], ...], k: K) -> tuple[tuple[K, V], ...]:
    """Return the map m without key k. Raises Missing if k is not in m."""
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
    """Return the index of key k in the map m, or the index at which k would be inserted."""
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
    """Return a ** b: an int if a and b are ints, otherwise a float.

    For ints, raises ValueError if b is negative, or if b is above MAX_EXPONENT and a is not -1, 0 or 1, and TooMuch if
    the result has more than MOST_BITS bits. For floats, raises ValueError if a ** b is not a real number, and
    OverflowError if it is too large."""
    if not (isinstance(a, int) and isinstance(b, int)):
        return math.pow(a, b)
    if b < 0:
        raise ValueError("an int has no int power with a negative exponent: write the base as a float")
    if b > MAX_EXPONENT and abs(a) > 1:
        raise ValueError(f"the exponent of an int is at most {MAX_EXPONENT}: write the base as a float")
    if abs(a) > 1 and (abs(a).bit_length() - 1) * b >= MOST_BITS:  # computing such a long int takes too long
        raise TooMuch(TOO_LONG)
    return checked(int(a**b))


def _shown(value: object) -> str:
    """Return a short text of any value for a message in the log."""
    huge = isinstance(value, int) and value.bit_length() > 64
    return "an int beyond 64 bits" if huge else reprlib.repr(value)
