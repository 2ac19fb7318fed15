"""Koord types in generated programs: their Python annotations, how much their values may hold, their empty values."""

from __future__ import annotations

from typing import assert_never

from koordgen.build.emit.names import Names
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    PLANNER,
    POINT,
    POSE,
    STREAM,
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

# The most bytes of values of these types in MessagePack, as runtime/values/bounds.py counts them (a test compares).
NUMBER = 9
FIXED: dict[Type, int] = {
    BOOL: 1, INT: NUMBER, FLOAT: NUMBER, POINT: 1 + 3 * NUMBER, POSE: 1 + 1 + 3 * NUMBER + NUMBER, GRID: 1 + 3 * NUMBER
}  # fmt: skip
EXTERN_BYTES = 256  # of a value of an extern type
_SIZED = {"string": ("str", "Text"), "GridMap": ("GridMap", "Cells"), "Scan": ("Scan", "Rays")}
_DEFAULTS: dict[Type, str] = {
    BOOL: "False", INT: "0", FLOAT: "0.0", POINT: "Point()", POSE: "Pose()", GRID: "Grid()"
}  # fmt: skip


def annotation(type_: Type, names: Names) -> str:
    """The Python type of a Koord type's values; a planner's is that of what it returns."""
    match type_:
        case Scalar():
            return {PLANNER: "tuple[Point, ...]", STREAM: "str"}.get(type_, type_.name)
        case Sized(name):
            return _SIZED[name][0]
        case Sequence(_, element) | PerRobot(element):
            return f"tuple[{annotation(element, names)}, ...]"
        case MapOf(key, value):
            return f"tuple[tuple[{annotation(key, names)}, {annotation(value, names)}], ...]"
        case TupleOf(items):
            return f"tuple[{', '.join([annotation(item, names) for item in items])}]"
        case RecordType(name):
            return names.records[name]
        case ExternType(name):
            return names.extern_types[name]
        case _:
            assert_never(type_)


def bound(type_: Type, names: Names) -> str:
    """The Python expression for a type's Bound. An argument's one value a robot has none of its own."""
    match type_:
        case Scalar():
            return f"Fixed({FIXED[type_]})"
        case Sized(name, capacity):
            return f"{_SIZED[name][1]}({capacity})"
        case Sequence(name, element, capacity):
            return f"{'Distinct' if name == 'Set' else 'Many'}({capacity}, {bound(element, names)})"
        case PerRobot(element):
            return f"Many(128, {bound(element, names)})"
        case MapOf(key, value, capacity):
            return f"Pairs({capacity}, {bound(key, names)}, {bound(value, names)})"
        case TupleOf(items):
            return f"Parts(({', '.join([bound(item, names) for item in items])}))"
        case RecordType(name, fields):
            called = [f'"{names.fields[name][field]}"' for field, _ in fields]
            return f"Parts({display([bound(field, names) for _, field in fields])}, {display(called)})"
        case ExternType(name):
            return f'Blob({EXTERN_BYTES}, "{name}")'
        case _:
            assert_never(type_)


def with_floats(type_: Type) -> bool:
    """Whether values of a type have floats in them: Python's `==` and `in` are not Koord's then."""
    match type_:
        case Scalar() | Sized():
            return type_ in (FLOAT, POINT, POSE, GRID) or (isinstance(type_, Sized) and type_.name != "string")
        case Sequence(_, element) | PerRobot(element) | MapOf(_, element):  # keys have none
            return with_floats(element)
        case TupleOf(items):
            return any(map(with_floats, items))
        case RecordType(_, fields):
            return any(with_floats(field) for _, field in fields)
        case ExternType():
            return False
        case _:
            assert_never(type_)


def default(type_: Type, names: Names) -> str:
    """The value of a type that nothing was ever written to."""
    match type_:
        case Scalar():
            return _DEFAULTS[type_]
        case Sized(name):
            return '""' if name == "string" else f"{name}()"
        case TupleOf(items):
            return display([default(item, names) for item in items])
        case RecordType(name):
            return f"{names.records[name]}()"
        case ExternType():
            return "Opaque()"
        case Sequence() | MapOf() | PerRobot():
            return "()"
        case _:
            assert_never(type_)


def display(items: list[str]) -> str:
    """A tuple of these items."""
    return f"({items[0]},)" if len(items) == 1 else f"({', '.join(items)})"
