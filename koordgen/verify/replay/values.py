"""Conversion of values between traces, which are JSON, and the executable semantics."""

from __future__ import annotations

import math
from base64 import b64decode, b64encode
from collections.abc import Callable
from typing import Any, assert_never

from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    PLANNER,
    POINT,
    POSE,
    ExternType,
    MapOf,
    PerRobot,
    RecordType,
    Scalar,
    Sequence,
    Sized,
    TupleOf,
    Type,
)
from koordgen.lang.semantics.values import RecordValue, Value
from koordgen.runtime.values.gridmap import GridMap
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan


class BadValue(Exception):
    """Raised if a value in a trace does not have its variable's type."""


Number = Callable[[Any], float]  # converts JSON data to a float; raises ValueError or TypeError


def from_trace(data: Any, type_: Type, number: Number = float) -> Value:
    """Convert a value from a trace. The function `number` reads floats. Raises BadValue.

    Null in a trace denotes any number that is not finite. Null becomes NaN."""
    try:
        return _from_trace(data, type_, number)
    except (TypeError, ValueError, LookupError, AttributeError, ArithmeticError):
        raise BadValue(f"{data!r} is not of type {type_}") from None


def _from_trace(data: Any, type_: Type, number: Number) -> Value:
    match type_:
        case Scalar() | Sized():
            return _plain_of(data, type_, number)
        case Sequence(_, element) | PerRobot(element):
            return tuple([_from_trace(part, element, number) for part in data])
        case MapOf(key, held):
            return tuple([(_from_trace(k, key, number), _from_trace(v, held, number)) for k, v in data])
        case TupleOf(items):
            return tuple([_from_trace(part, item, number) for part, item in zip(data, items, strict=True)])
        case RecordType(name, fields):
            return RecordValue(name, tuple([_from_trace(d, t, number) for d, (_, t) in zip(data, fields, strict=True)]))
        case ExternType():
            return Opaque(b64decode(data[0], validate=True))
        case _:
            assert_never(type_)


def _plain_of(data: Any, type_: Scalar | Sized, number: Number) -> Value:
    if type_ == FLOAT:
        return math.nan if data is None else number(data)
    if type_ in (INT, BOOL):
        if type(data) is not (int if type_ == INT else bool):
            raise ValueError
        return data
    if type_ == POINT:
        return _point(data, number)
    if type_ == POSE:
        return Pose(_point(data[0], number), _plain_of(data[1], FLOAT, number))  # type: ignore[arg-type]
    if type_ == GRID:
        return Grid(int(data[0]), int(data[1]), number(data[2]))
    if type_ == PLANNER:
        return tuple([_point(part, number) for part in data])
    match str(type_):
        case "Scan":
            angles, ranges, most = data
            return Scan(tuple(map(float, angles)), tuple(map(float, ranges)), float(most))
        case "GridMap":
            resolution, x, y, width, height, cells = data
            return GridMap(float(resolution), x, y, width, height, b64decode(cells, validate=True))
        case _:
            if not isinstance(data, str):
                raise TypeError
            return data


def _point(data: Any, number: Number) -> Point:
    x, y, z = (math.nan if part is None else number(part) for part in data)
    return Point(x, y, z)


def plain(value: Any) -> Any:
    """Convert a value of the semantics to its JSON form in a trace."""
    match value:
        case float():
            return value if math.isfinite(value) else None
        case RecordValue():
            return [plain(part) for part in value.fields]
        case tuple():
            return [plain(part) for part in value]
        case bytes():
            return b64encode(value).decode()
        case Point() | Pose() | Grid() | Scan() | GridMap() | Opaque():
            return [plain(getattr(value, name)) for name in value.__struct_fields__]
        case _:
            return value
