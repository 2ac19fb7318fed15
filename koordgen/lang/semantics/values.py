"""Values of Koord: their representation, equality, defaults, types, and the limits of values that are stored.

Ints, floats, bools and strings are represented by Python's; Points, Poses, Grids, Scans and GridMaps by the classes
that robots use. A list or queue is a tuple (a queue's front first); a set is an ascending tuple without duplicates; a
map is a tuple of pairs with ascending keys, without duplicate keys. Values are immutable, so they are never copied.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, TypeVar, assert_never

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir.types import ExternType, MapOf, PerRobot, RecordType, Scalar, Sequence, Sized, TupleOf, Type
from koordgen.lang.semantics.exact import Exact
from koordgen.runtime.values.gridmap import GridMap, sound
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan


class RecordValue(NamedTuple):
    """Value of a record: the name of its type, and its fields' values in the order of their declaration."""

    name: str
    fields: tuple[Value, ...]


class Rect(NamedTuple):
    """Box between two opposite corners, including the faces of the box."""

    a: Point
    b: Point


class Ball(NamedTuple):
    """Ball of all points at most `radius` metres away from `center`."""

    center: Point
    radius: float


Value = (
    int | float | bool | str | Point | Pose | Grid | Scan | GridMap | Opaque | RecordValue | Rect | Ball
    | tuple["Value", ...]
)  # fmt: skip
_STRUCTS = (Point, Pose, Grid, Scan, GridMap, Opaque)
_PYTHON: dict[str, type] = {
    "int": int, "float": float, "bool": bool, "string": str, "Point": Point, "Pose": Pose, "Grid": Grid, "Scan": Scan,
    "GridMap": GridMap,
}  # fmt: skip
EXTERN_BYTES = 256
CELLS_AN_ELEMENT = 100  # number of cells of a GridMap that count as one element
INT_MIN, INT_MAX = -(2**63), 2**63 - 1

P = TypeVar("P")


def as_(kind: type[P], value: object) -> P:
    """Return a value unchanged. Raises InternalError if it is not of the Python type `kind`."""
    if not isinstance(value, kind):
        raise InternalError(f"{value!r} is not of type {kind.__name__}")
    return value


def items(value: object) -> tuple[Any, ...]:
    """Return the elements of a list, queue or set, the pairs of a map, or the items of a tuple."""
    return as_(tuple, value)


def same(a: Value, b: Value) -> bool:
    """Return whether two values of one type are equal; floats are compared as in IEEE 754.

    The evaluator compares no values that contain NaN: it discards the event first.
    """
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, _STRUCTS):
        return all(same(getattr(a, field), getattr(b, field)) for field in a.__struct_fields__)
    return bool(a == b)


def elements_in(value: object, most: int) -> int:
    """Return the number of elements of a value, including nested elements. The count stops beyond `most`.

    Items of tuples, characters of strings, and rays of Scans are elements, and so are the pairs, keys and values of a
    map. CELLS_AN_ELEMENT cells of a GridMap count as one element.
    """
    if isinstance(value, str):
        return len(value)
    if isinstance(value, GridMap):
        return value.width * value.height // CELLS_AN_ELEMENT
    if isinstance(value, Scan):
        return len(value.angles) + len(value.ranges)
    if isinstance(value, RecordValue):
        return sum([elements_in(field, most) for field in value.fields])
    if not isinstance(value, tuple):
        return 0
    count = len(value)
    for part in value:
        if count > most:
            break
        count += elements_in(part, most)
    return count


def default(type_: Type, records: Mapping[str, RecordValue]) -> Value:
    """Return the default value of a type. `records` maps the name of each record type to its default value."""
    match type_:
        case Scalar(name) | Sized(name):
            return as_(_PYTHON[name], _DEFAULTS[name])
        case Sequence() | MapOf():
            return ()
        case TupleOf(parts):
            return tuple([default(part, records) for part in parts])
        case RecordType(name):
            return records[name]
        case ExternType():
            return Opaque()
        case PerRobot():
            raise InternalError(f"{type_} has no default")
        case _:
            assert_never(type_)


_DEFAULTS: dict[str, Value] = {
    "int": 0, "float": 0.0, "bool": False, "string": "", "Point": Point(), "Pose": Pose(), "Grid": Grid(),
    "Scan": Scan(), "GridMap": GridMap(),
}  # fmt: skip


def conforms(value: object, type_: Type) -> bool:
    """Return whether an object is a value of a type; sets and the keys of maps must be in ascending order.

    The capacities of the type are not checked.
    """
    match type_:
        case Scalar(name) | Sized(name):
            of_it = type(value) is _PYTHON.get(name) or (name == "float" and isinstance(value, Exact))
            return of_it and (not isinstance(value, GridMap) or sound(value))
        case Sequence(name, element):
            return _all(value, element) and (name != "Set" or _ascending(items(value)))
        case PerRobot(element):
            return _all(value, element)
        case MapOf(key, held):
            return _all(value, TupleOf((key, held))) and _ascending([pair[0] for pair in items(value)])
        case TupleOf(parts):
            return type(value) is tuple and _each(value, parts)
        case RecordType(name, fields):
            of_it = isinstance(value, RecordValue) and value.name == name
            return of_it and _each(as_(RecordValue, value).fields, [part for _, part in fields])
        case ExternType():
            return type(value) is Opaque
        case _:
            assert_never(type_)


def _all(value: object, element: Type) -> bool:
    return type(value) is tuple and all(conforms(part, element) for part in value)


def _each(parts: tuple[Any, ...], types: tuple[Type, ...] | list[Type]) -> bool:
    return len(parts) == len(types) and all(map(conforms, parts, types))


def _ascending(keys: Any) -> bool:
    return all(keys[i] < keys[i + 1] for i in range(len(keys) - 1))


def has_nan(value: object) -> bool:
    """Return whether a value is NaN or contains NaN at any depth. Such a value cannot be compared."""
    if isinstance(value, _STRUCTS):
        return any(has_nan(getattr(value, field)) for field in value.__struct_fields__)
    return any(map(has_nan, value)) if isinstance(value, tuple) else isinstance(value, float) and math.isnan(value)


def flaw(value: Any, type_: Type) -> str:
    """Return the reason why a variable, slot or actuator of type `type_` cannot store a value.

    Returns an empty string if the value can be stored.

    Stored floats must be finite, at any depth, so that no NaN remains after its event. Stored ints must have at most 64
    bits: without this limit, an int that is squared every round would soon block the robot.
    """
    match type_:
        case Scalar() | Sized("string"):
            return number_flaw(value) or (_text_flaw(value, type_) if isinstance(type_, Sized) else "")
        case Sized("GridMap", capacity):
            return _excess(value.width * value.height, capacity, "cells")
        case Sized(_, capacity):
            return _excess(max(len(value.angles), len(value.ranges)), capacity, "rays") or number_flaw(value)
        case Sequence(_, element, capacity):
            return _excess(len(value), capacity, "elements") or _first(flaw(v, element) for v in value)
        case MapOf(key, held, capacity):
            parts = TupleOf((key, held))
            return _excess(len(value), capacity, "keys") or _first(flaw(v, parts) for v in value)
        case TupleOf(types):
            return _first(flaw(v, t) for v, t in zip(value, types, strict=True))
        case RecordType(_, fields):
            return _first(flaw(v, t) for v, (_, t) in zip(value.fields, fields, strict=True))
        case ExternType():
            return _excess(len(value.data), EXTERN_BYTES, "bytes")
        case PerRobot():
            raise InternalError(f"variables and ports cannot store a {type_}")
        case _:
            assert_never(type_)


def number_flaw(value: Any) -> str:
    """Return a description of a number in a value that cannot be stored or sent; empty if there is none."""
    if isinstance(value, (*_STRUCTS, tuple)):
        parts = value if isinstance(value, tuple) else [getattr(value, field) for field in value.__struct_fields__]
        return _first(number_flaw(part) for part in parts)
    if isinstance(value, int) and not INT_MIN <= value <= INT_MAX:
        return "an int beyond 64 bits"
    return repr(value) if isinstance(value, float) and not math.isfinite(value) else ""


def _text_flaw(value: str, type_: Sized) -> str:
    return _excess(len(value.encode()), type_.capacity, "bytes") if encodable(value) else "a text that is not Unicode"


def encodable(text: str) -> bool:
    """Return whether a string is valid Unicode: it has no lone surrogates, which malformed bytes decode to."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _excess(count: int, capacity: int, what: str) -> str:
    return f"one of {count} {what} where at most {capacity} fit" if count > capacity else ""


def _first(flaws: Iterable[str]) -> str:
    return next(filter(None, flaws), "")
