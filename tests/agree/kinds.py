"""Random types, their values, and constant expressions for the values."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import msgspec

from koordgen.lang.ir import expr as e
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    GRIDMAP,
    INT,
    POINT,
    POSE,
    SCAN,
    STRING,
    ExternType,
    MapOf,
    RecordType,
    Scalar,
    Sequence,
    Sized,
    TupleOf,
    Type,
    list_of,
)
from koordgen.lang.semantics.builtins import map_of, set_of
from koordgen.lang.semantics.values import RecordValue, Value
from koordgen.lang.source import Span
from koordgen.runtime.values.gridmap import GridMap, area, mark_free, mark_occupied
from koordgen.runtime.values.points import Grid, Opaque, Point, Pose, Scan

AT = Span(1, 1, 1, 2)
SIZE = 0.5  # of the cells of nearly all maps and grids
TICKET = ExternType("Ticket")
KEYS: tuple[Type, ...] = (INT, INT, STRING, BOOL, TupleOf((INT, STRING)), TupleOf((STRING, BOOL)))
BASE: tuple[Type, ...] = (INT, FLOAT, BOOL, STRING, POINT, POSE, GRID, GRIDMAP, SCAN, TICKET)
TEXTS = ("", "a", "b", "door", "naïve", 'x"y', "it's", "\\ \n\t", "abc", "ba")


class Ticket(msgspec.Struct):
    """Class of the extern type."""

    number: int = 0


def random_type(rng: Random, depth: int, records: tuple[RecordType, ...] = ()) -> Type:
    """Return a type that variables can have."""
    if depth == 0 or rng.random() < 0.25:
        return rng.choice(BASE)
    inner = random_type(rng, depth - 1, records)
    match rng.randrange(8):
        case 0 | 1:
            return list_of(inner)
        case 2:
            return Sequence("Queue", inner, 64)
        case 3:
            return Sequence("Set", rng.choice(KEYS), 64)
        case 4:
            return MapOf(rng.choice(KEYS), inner, 64)
        case 5 | 6 if records:
            return rng.choice(records)
        case _:
            return TupleOf((inner, random_type(rng, depth - 1, records)))


def sized(type_: Type, rng: Random, tight: float = 0.06) -> Type:
    """Return the type with capacities; `tight` is the share of small ones."""

    def room(least: int) -> int:
        return least if rng.random() < tight else 64

    match type_:
        case Sized(name):
            return Sized(name, 4 * room(3))
        case Sequence(name, element):
            return Sequence(name, sized(element, rng, tight), room(4))
        case MapOf(key, value):
            return MapOf(sized(key, rng, tight), sized(value, rng, tight), room(4))
        case TupleOf(items):
            return TupleOf(tuple([sized(item, rng, tight) for item in items]))
        case _:
            return type_


def random_value(rng: Random, type_: Type, wild: bool = True) -> Value:
    """Return a value of a type, nearly always an ordinary one."""
    match type_:
        case Scalar() | Sized():
            return _plain(rng, type_, wild)
        case Sequence(name, element, capacity):
            count = min(rng.choice((0, 1, 2, 2, 3)), capacity)
            found = tuple([random_value(rng, element, wild) for _ in range(count)])
            return set_of(found) if name == "Set" else found
        case MapOf(key, value, capacity):
            count = min(rng.choice((0, 1, 2, 3)), capacity)
            return map_of(tuple([(random_value(rng, key), random_value(rng, value, wild)) for _ in range(count)]))
        case TupleOf(items):
            return tuple([random_value(rng, item, wild) for item in items])
        case RecordType(name, fields):
            return RecordValue(name, tuple([random_value(rng, field, wild) for _, field in fields]))
        case ExternType():
            number = rng.randrange(4)
            return Opaque(msgspec.msgpack.encode(Ticket(number)) if number else b"")
        case _:
            raise AssertionError(type_)


BEYOND = (math.nan, math.nan, math.inf, -math.inf)


def not_finite(rng: Random, value: Value, share: float = 0.1) -> Value:
    """Return a value in which this share of floats are NaN or infinite."""
    match value:
        case float():
            return rng.choice(BEYOND) if rng.random() < share else value
        case Point(_, y, z):
            return Point(rng.choice(BEYOND), y, z) if rng.random() < share else value
        case Pose(position, yaw):
            return Pose(not_finite(rng, position, share), not_finite(rng, yaw, share))  # type: ignore[arg-type]
        case RecordValue(name, fields):
            return RecordValue(name, tuple([not_finite(rng, part, share) for part in fields]))
        case tuple():
            return tuple([not_finite(rng, part, share) for part in value])
        case _:
            return value


def _plain(rng: Random, type_: Scalar | Sized, wild: bool) -> Value:
    odd = wild and rng.random() < 0.01

    def real() -> float:
        return rng.choice((0.0, 0.5, 1.0, 2.5, -1.5, round(rng.uniform(-9, 9), 2)))

    match type_.name:
        case "int":
            return rng.choice((2**62, -(2**63))) if odd else rng.choice((-3, -1, 0, 0, 1, 1, 2, 2, 3, 4, 5, 7, 8))
        case "float":
            return rng.choice((1e300, 1.7e308, -0.0)) if odd else real()
        case "bool":
            return rng.random() < 0.5
        case "string":
            return rng.choice(TEXTS)
        case "Point":
            return Point(real(), real(), real())
        case "Pose":
            return Pose(Point(real(), real(), real()), real())
        case "Grid":
            return Grid(rng.randrange(-2, 5), rng.randrange(-2, 5), 1.0 if odd else SIZE)
        case "GridMap":
            return _map(rng)
        case _:
            count = rng.randrange(3)
            angles = tuple([real() for _ in range(count)])
            return Scan(angles, tuple([abs(a) for a in angles]), 10.0)


def _map(rng: Random) -> GridMap:
    if rng.random() < 0.2:
        return GridMap()
    x, y = rng.randrange(-2, 2), rng.randrange(-2, 2)
    found = area(Point(x * SIZE, y * SIZE, 0.0), Point((x + 3) * SIZE, (y + 2) * SIZE, 0.0), SIZE)
    for mark in rng.sample((mark_free, mark_occupied, mark_free), rng.randrange(3)):
        found = mark(found, Grid(x + rng.randrange(3), y + rng.randrange(2), SIZE))
    return found


def real(value: float) -> e.Expr:
    return e.Const(value, FLOAT, AT)


def whole(value: int) -> e.Expr:
    return e.Const(value, INT, AT)


def point(p: Point) -> e.Expr:
    return e.Builtin("Point", (real(p.x), real(p.y), real(p.z)), POINT, AT)


def constant(value: Any, type_: Type) -> e.Expr:
    """Return the expression for a value, from literals. Maps, scans and tickets have only that of the empty value."""
    match type_:
        case Scalar("Point"):
            return point(value)
        case Scalar("Pose"):
            return e.Builtin("Pose", (point(value.position), real(value.yaw)), POSE, AT)
        case Scalar("Grid"):
            return e.Builtin("Grid", (whole(value.x), whole(value.y), real(value.size)), GRID, AT)
        case Scalar() | Sized("string"):
            return e.Const(value, type_, AT)
        case Sized() | ExternType():
            return e.Make((), type_, AT)
        case Sequence(_, element):
            return e.Make(tuple([constant(v, element) for v in value]), type_, AT)
        case MapOf(key, held):
            return e.Make(tuple([constant(pair, TupleOf((key, held))) for pair in value]), type_, AT)
        case TupleOf(items):
            return e.Make(tuple([constant(v, t) for v, t in zip(value, items, strict=True)]), type_, AT)
        case RecordType(_, fields):
            parts = zip(value.fields, fields, strict=True)
            return e.Make(tuple([constant(v, t) for v, (_, t) in parts]), type_, AT)
        case _:
            raise AssertionError(type_)


def parts(type_: Type) -> list[Type]:
    """Return the types within a type, without the type itself."""
    match type_:
        case Sequence(_, element):
            return [element]
        case MapOf(key, value):
            return [key, value, list_of(key), list_of(value)]
        case TupleOf(items):
            return list(items)
        case RecordType(_, fields):
            return [field for _, field in fields]
        case _:
            named: dict[str, list[Type]] = {
                "Point": [FLOAT], "Pose": [POINT, FLOAT], "Grid": [INT, FLOAT, POINT], "Scan": [list_of(FLOAT), FLOAT]
            }  # fmt: skip
            return named.get(str(type_), [])
