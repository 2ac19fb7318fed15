"""Semantics of the builtin functions and methods of Koord, listed in koordgen/lang/ir/builtins.py.

This code is independent of the library that runs on robots, so that tests can compare the two. Both share only the code
of geometry and GridMaps. A function whose result does not exist raises ValueError or ArithmeticError; the evaluator
then discards the event.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Any

from koordgen.lang.semantics import exact
from koordgen.lang.semantics.numbers import within_bits
from koordgen.lang.semantics.values import Ball, Rect, Value, has_nan, items, same
from koordgen.runtime.values import geometry, gridmap
from koordgen.runtime.values.points import Grid, NotANumber, Point, Pose, distance

List = tuple[Any, ...]
_key = itemgetter(0)


def element(xs: Any, i: int) -> Any:
    """Return `xs[i]` of a list, queue or string."""
    if not 0 <= i < len(xs):
        raise ValueError(f"index {shown(i)} is not below the length {len(xs)}" if i >= 0 else f"index {shown(i)}")
    return xs[i]


def part(xs: Any, start: int | None, stop: int | None) -> Any:
    """Return `xs[start:stop]` of a list or string."""
    low = 0 if start is None else start
    high = len(xs) if stop is None else stop
    if low < 0 or high < 0:
        raise ValueError(f"a slice from {shown(low)} to {shown(high)}")
    found = [xs[i] for i in range(min(low, len(xs)), min(high, len(xs)))]
    return "".join(found) if isinstance(xs, str) else tuple(found)


def comparable(*values: Any) -> None:
    """Raise NotANumber if one of the values contains NaN, because NaN cannot be compared."""
    if any(map(has_nan, values)):
        raise NotANumber


def contains(xs: Any, item: Any) -> bool:
    """Return `item in xs`, where `xs` is a list, queue, set, string, region, or a map's keys.

    Raises NotANumber if a value that must be compared contains NaN.
    """
    comparable(xs, item)
    if isinstance(xs, Rect):
        pairs = ((item.x, xs.a.x, xs.b.x), (item.y, xs.a.y, xs.b.y), (item.z, xs.a.z, xs.b.z))
        return all(low <= c <= high or high <= c <= low for c, low, high in pairs)
    if isinstance(xs, Ball):
        measured = exact.distance if exact.is_exact(item, xs.center) else distance
        apart = measured(item, xs.center)
        comparable(apart)  # the distance of two points at infinity is NaN
        return bool(apart <= xs.radius)
    if isinstance(xs, str):
        return item in xs
    return any(same(x, item) for x in xs)


def set_of(values: List) -> List:
    """Return the set of the given values: a tuple in ascending order without duplicates."""
    ordered = sorted(values)
    return tuple([value for i, value in enumerate(ordered) if i == 0 or ordered[i - 1] < value])


def map_of(pairs: List) -> List:
    """Return the map that consists of the given pairs (key, value), in ascending order of the keys.

    If a key occurs in several pairs, the last of these pairs is kept.
    """
    found: List = ()
    for key, value in pairs:
        found = _map_with(found, key, value)
    return found


def shown(value: int) -> str:
    """Return an int as text for a message; a phrase stands in for an int of more than 64 bits."""
    return str(value) if abs(value) < 2**64 else "an int beyond 64 bits"


def _where(xs: List, item: Any) -> int:
    comparable(xs, item)
    for i, x in enumerate(xs):
        if same(x, item):
            return i
    raise ValueError("what is looked for is not there")


def _updated(xs: List, i: int, value: Any) -> List:
    element(xs, i)
    return tuple([value if j == i else x for j, x in enumerate(xs)])


def _inserted(xs: List, i: int, value: Any) -> List:
    if not 0 <= i <= len(xs):
        raise ValueError(f"{shown(i)} is no place in a list of {len(xs)}")
    found = []
    for j in range(len(xs) + 1):
        if j == i:
            found.append(value)
        if j < len(xs):
            found.append(xs[j])
    return tuple(found)


def _without(xs: List, i: int) -> List:
    element(xs, i)
    return tuple([x for j, x in enumerate(xs) if j != i])


def _common(s: List, t: frozenset[Any], wanted: bool) -> List:
    return tuple([x for x in s if (x in t) == wanted])


def _set_with(s: List, value: Any) -> List:
    below, above = [x for x in s if x < value], [x for x in s if value < x]
    return (*below, value, *above)


def _map_with(m: List, key: Any, value: Any) -> List:
    below, above = [p for p in m if p[0] < key], [p for p in m if key < p[0]]
    return (*below, (key, value), *above)


def has_key(m: Any, key: Any) -> bool:
    """Return `key in m` of a map, by binary search."""
    place = bisect_left(m, key, key=_key)
    return place < len(m) and bool(m[place][0] == key)


def _map_at(m: List, key: Any) -> Any:
    if has_key(m, key):
        return m[bisect_left(m, key, key=_key)][1]
    raise ValueError("the map has no such key")


def _count(xs: List, item: Any) -> int:
    comparable(xs, item)
    return len([x for x in xs if same(x, item)])


def _ascending(xs: List) -> List:
    comparable(xs)
    return tuple(sorted(xs))


def _least(a: Any, b: Any) -> Any:
    comparable(a, b)
    return b if b < a else a


def _greatest(a: Any, b: Any) -> Any:
    comparable(a, b)
    return b if b > a else a


def _sum(xs: List, zero: Any) -> Any:
    """Return the sum of a list's elements, added from left to right; each addition of floats rounds."""
    total = zero
    for x in xs:
        total = total + x
    return within_bits(total)


def _text(value: Any) -> str:
    if isinstance(value, Point):
        return f"({value.x!r}, {value.y!r}, {value.z!r})"
    return value if isinstance(value, str) else repr(value)


def applied(name: str, args: list[Value], zero: Value) -> Value:
    """Return the result of the builtin function `name` for evaluated arguments.

    `zero` is the zero of the result's type; it is the sum of an empty list.
    """
    if name in exact.ROUNDING and exact.is_exact(*args):
        return exact.applied(name, args)  # type: ignore[no-any-return]
    value: Value = _sum(items(args[0]), zero) if name == "sum" else MEANINGS[name](*args)
    return value


_PLAIN: Mapping[str, Callable[..., Any]] = {
    "Point": Point,
    "Pose": Pose,
    "Grid": Grid,
    "Rect": Rect,
    "Ball": Ball,
    "distance": distance,
    "path_distance": geometry.path_distance,
    "clear": geometry.clear,
    "GridMap": gridmap.area,
    "center": gridmap.center,
    "cell": gridmap.cell,
    "merge": gridmap.merge,
    "is_free": gridmap.is_free,
    "is_occupied": gridmap.is_occupied,
    "is_known": gridmap.is_known,
    "mark_free": gridmap.mark_free,
    "mark_occupied": gridmap.mark_occupied,
    "abs": abs,
    "min": _least,
    "max": _greatest,
    **{name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log")},
    "atan2": math.atan2,
    "floor": math.floor,
    "ceil": math.ceil,
    "round": round,
    "str": _text,
}
_CONTAINERS: Mapping[str, Callable[..., Any]] = {
    "len": len,
    "first": lambda xs: element(xs, 0),
    "last": lambda xs: element(xs, len(xs) - 1),
    "sorted": _ascending,
    "reversed": lambda xs: tuple([xs[len(xs) - 1 - i] for i in range(len(xs))]),
    "index": _where,
    "count": _count,
    "updated": _updated,
    "appended": lambda xs, value: (*xs, value),
    "extended": lambda xs, ys: (*xs, *ys),
    "inserted": _inserted,
    "removed": lambda xs, value: _without(xs, _where(xs, value)),
    "without": _without,
    "popped": lambda xs: _without(xs, len(xs) - 1),
    "cleared": lambda xs: (),
    "union": lambda s, t: set_of((*s, *t)),
    "intersection": lambda s, t: _common(s, frozenset(t), True),
    "difference": lambda s, t: _common(s, frozenset(t), False),
    "set_with": _set_with,
    "set_without": lambda s, value: _without(s, _where(s, value)),
    "keys": lambda m: tuple([key for key, _ in m]),
    "values": lambda m: tuple([value for _, value in m]),
    "items": lambda m: m,
    "get": lambda m, key, otherwise: _map_at(m, key) if has_key(m, key) else otherwise,
    "map_at": _map_at,
    "map_with": _map_with,
    "map_without": lambda m, key: _without(m, _where([own for own, _ in m], key)),  # type: ignore[arg-type]
}
MEANINGS = {**_PLAIN, **_CONTAINERS}
# Builtins that make a new list, set, map or queue. The evaluator charges its size to the event's budget of loop turns.
MAKING = frozenset(
    ("sorted", "reversed", "updated", "appended", "extended", "inserted", "removed", "without", "popped", "union",
     "intersection", "difference", "set_with", "set_without", "keys", "values", "map_with", "map_without")
)  # fmt: skip
# Builtins that compare their arguments or parts of them. If an argument contains NaN, the event is discarded.
COMPARING = frozenset(("min", "max", "sorted", "index", "count", "removed", "Rect", "Ball"))
# Builtins that read all elements of their arguments. The evaluator charges the number of elements to the event's budget
# of loop turns. It charges for the builtins in COMPARING in the same way.
SEARCHING = frozenset(("sum", "union", "intersection", "difference"))
# Builtins that make a new GridMap. The evaluator charges its size to the event's budget of loop turns.
MAPPING = frozenset(("GridMap", "mark_free", "mark_occupied"))
