"""Koord's types as sorts: what has parts is flattened, what varies in length is one value of a sort of its own."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.ir.types import BALL, BOOL, FLOAT, GRID, INT, POINT, POSE, RECT, RecordType, TupleOf, Type
from koordgen.verify.prove.encode.values import Named, Val, is_collection
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Sort, Term

Leaf = tuple[str, Sort]  # of a value: the suffix of its symbol, ".target.x", and its sort

_PLAIN: dict[Type, Sort] = {INT: t.INT, FLOAT: t.REAL, BOOL: t.BOOL}
_PARTS: dict[Type, tuple[tuple[str, Type], ...]] = {
    POINT: (("x", FLOAT), ("y", FLOAT), ("z", FLOAT)),
    POSE: (("position", POINT), ("yaw", FLOAT)),
    GRID: (("x", INT), ("y", INT), ("size", FLOAT)),
    RECT: (("a", POINT), ("b", POINT)),
    BALL: (("center", POINT), ("radius", FLOAT)),
}
_SHAPES: dict[str, tuple[Leaf, ...]] = {}


def parts_of(type_: Type) -> tuple[tuple[str, Type], ...] | None:
    """The names and types of a type's parts; None of one that is a single value."""
    if isinstance(type_, RecordType):
        return type_.fields
    if isinstance(type_, TupleOf):
        return tuple([(str(i), item) for i, item in enumerate(type_.items)])
    return _PARTS.get(type_)


def sort_of(type_: Type) -> Sort:
    """The sort of a type without parts. Strings, maps of places, scans, extern types, and all that is a collection are
    of sorts of their own, which are called as the type."""
    return _PLAIN.get(type_) or Sort(str(type_))


def shape(type_: Type) -> tuple[Leaf, ...]:
    """A type's leaves, in the order in which its values are flattened."""
    parts = parts_of(type_)
    if parts is None:
        return (("", sort_of(type_)),)
    return tuple([(f".{name}{suffix}", sort) for name, part in parts for suffix, sort in shape(part)])


def build(type_: Type, leaves: Iterator[Term]) -> Val:
    """A value of a type from its leaves."""
    parts = parts_of(type_)
    if parts is not None:
        return tuple([build(part, leaves) for _, part in parts])
    leaf = next(leaves)
    return Named(leaf, type_) if is_collection(type_) else leaf
