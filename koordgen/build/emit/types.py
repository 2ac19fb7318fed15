"""Koord types in generated programs: Python annotations, size bounds and empty values."""

from __future__ import annotations

from typing import assert_never

from koordgen.build.emit.layout import brackets, display, joined
from koordgen.build.emit.names import Names
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    MOST_ROBOTS,
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

# Largest sizes of values in MessagePack, in bytes; equal to those of runtime/values/bounds.py (a test compares them).
NUMBER = 9
FIXED: dict[Type, int] = {
    BOOL: 1, INT: NUMBER, FLOAT: NUMBER, POINT: 1 + 3 * NUMBER, POSE: 1 + 1 + 3 * NUMBER + NUMBER, GRID: 1 + 3 * NUMBER
}  # fmt: skip
EXTERN_BYTES = 256  # largest size of a value of an extern type, in bytes
_SIZED = {"string": ("str", "Text"), "GridMap": ("GridMap", "Cells"), "Scan": ("Scan", "Rays")}
_DEFAULTS: dict[Type, str] = {BOOL: "False", INT: "0", FLOAT: "0.0"}


def annotation(type_: Type, names: Names) -> str:
    """Return the Python annotation of a Koord type. For a planner it is the annotation of the planner's result."""
    match type_:
        case Scalar() if type_ == PLANNER:
            return _tuple(names.use("Point"), "...")
        case Scalar():
            return "str" if type_ == STREAM else names.use(type_.name)
        case Sized(name):
            return names.use(_SIZED[name][0])
        case Sequence(_, element) | PerRobot(element):
            return _tuple(annotation(element, names), "...")
        case MapOf(key, value):
            return _tuple(_tuple(annotation(key, names), annotation(value, names)), "...")
        case TupleOf(items):
            return _tuple(*[annotation(item, names) for item in items])
        case RecordType(name):
            return names.use(names.records[name])
        case ExternType(name):
            return names.use(names.extern_types[name])
        case _:
            assert_never(type_)


def _tuple(*items: str) -> str:
    return brackets("tuple[", items, "]")


def bound(type_: Type, names: Names) -> str:
    """Return the Python expression for a type's Bound. An argument `T[N_SYS]` has the Bound of a list."""
    match type_:
        case Scalar():
            return f"{names.use('Fixed')}(bytes={FIXED[type_]})"
        case Sized(name, capacity):
            return f"{names.use(_SIZED[name][1])}(capacity={capacity})"
        case Sequence(name, element, capacity):
            return _many("Distinct" if name == "Set" else "Many", capacity, element, names)
        case PerRobot(element):
            return _many("Many", MOST_ROBOTS, element, names)
        case MapOf(key, value, capacity):
            keys, values = (joined(f"{part}=", bound(t, names)) for part, t in (("key", key), ("value", value)))
            return brackets(f"{names.use('Pairs')}(", [f"capacity={capacity}", keys, values], ")")
        case TupleOf(items):
            parts = display([bound(item, names) for item in items])
            return brackets(f"{names.use('Parts')}(", [joined("items=", parts)], ")")
        case RecordType():
            made = bound_of_record(type_, names)
            return names.bounds.get(made, made)
        case ExternType(name):
            return f'{names.use("Blob")}(capacity={EXTERN_BYTES}, name="{name}")'
        case _:
            assert_never(type_)


def _many(kind: str, capacity: int, element: Type, names: Names) -> str:
    return brackets(f"{names.use(kind)}(", [f"capacity={capacity}", joined("element=", bound(element, names))], ")")


def bound_of_record(type_: RecordType, names: Names) -> str:
    """Return the Python expression for a record's Bound."""
    items = display([bound(field, names) for _, field in type_.fields])
    fields = display([f'"{names.fields[type_.name][field]}"' for field, _ in type_.fields])
    return brackets(f"{names.use('Parts')}(", [joined("items=", items), joined("fields=", fields)], ")")


def with_floats(type_: Type) -> bool:
    """Return whether values of a type contain floats. Then Python's `==` and `in` differ from Koord's for NaN."""
    match type_:
        case Scalar() | Sized():
            return type_ in (FLOAT, POINT, POSE, GRID) or (isinstance(type_, Sized) and type_.name != "string")
        case Sequence(_, element) | PerRobot(element) | MapOf(_, element):  # keys of a map contain no floats
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
    """Return the Python expression for the value that a variable of a type has before any write."""
    match type_:
        case Scalar():
            return _DEFAULTS.get(type_) or f"{names.use(type_.name)}()"
        case Sized(name):
            return '""' if name == "string" else f"{names.use(name)}()"
        case TupleOf(items):
            return display([default(item, names) for item in items])
        case RecordType(name):
            return f"{names.use(names.records[name])}()"
        case ExternType():
            return f"{names.use('Opaque')}()"
        case Sequence() | MapOf() | PerRobot():
            return "()"
        case _:
            assert_never(type_)
