"""Symbolic values of Koord's types: a term, a tuple of parts, or a collection.

A collection records how it was built, so that its length and elements can be derived on demand. Axioms about lists are
never needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from koordgen.lang.ir.types import (
    BALL,
    BOOL,
    FLOAT,
    GRID,
    INT,
    POINT,
    POSE,
    RECT,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
)
from koordgen.lang.node import Node
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.term import Sort, Term


class OpaqueCollection(Node):
    """Collection of which only its term is known."""

    term: Term
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class EnumeratedCollection(Node):
    """Collection of these elements; for a map, pairs. Sets and maps have no order here."""

    items: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class ConditionalCollection(Node):
    """One of two collections, by a condition."""

    condition: Term
    then: Collection
    orelse: Collection
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class UpdatedCollection(Node):
    """Collection after an update of koordgen/lang/ir/builtins.py, such as "appended"."""

    update: str
    base: Collection
    args: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class FleetValue(Node):
    """One value per robot, as a whole.

    `slot` reads one robot's value; `name` identifies the variable and the state. `changed`: another such value, a
    robot, and the only value in which it differs, that robot's."""

    name: str
    slot: Callable[[Term], Val]
    type: Type
    changed: tuple[FleetValue, Term, Val] | None = None
    __eq__ = object.__eq__
    __hash__ = object.__hash__


Collection = OpaqueCollection | EnumeratedCollection | ConditionalCollection | UpdatedCollection | FleetValue
Val = Term | tuple["Val", ...] | Collection


def is_collection(type_: Type) -> bool:
    return isinstance(type_, (Sequence, MapOf, PerRobot))


def pick(condition: Term, then: Val, orelse: Val) -> Val:
    """Return one of two values of one type, by a condition."""
    if condition is t.TRUE or then is orelse:
        return then
    if condition is t.FALSE:
        return orelse
    if isinstance(then, tuple) and isinstance(orelse, tuple):
        return tuple([pick(condition, a, b) for a, b in zip(then, orelse, strict=True)])
    if isinstance(then, (OpaqueCollection, EnumeratedCollection, ConditionalCollection, UpdatedCollection, FleetValue)):
        assert isinstance(
            orelse, (OpaqueCollection, EnumeratedCollection, ConditionalCollection, UpdatedCollection, FleetValue)
        )
        if isinstance(then, ConditionalCollection) and then.condition is condition:
            then = then.then
        if isinstance(orelse, ConditionalCollection) and orelse.condition is condition:
            orelse = orelse.orelse
        if then is orelse or (
            isinstance(then, OpaqueCollection) and isinstance(orelse, OpaqueCollection) and then.term is orelse.term
        ):
            return then
        return ConditionalCollection(condition, then, orelse, then.type)
    assert not isinstance(
        orelse, (tuple, OpaqueCollection, EnumeratedCollection, ConditionalCollection, UpdatedCollection, FleetValue)
    )
    assert not isinstance(then, tuple)
    return t.ite(condition, then, orelse)


def as_term(value: Val) -> Term:
    """Return a value that is known to be a term."""
    assert isinstance(value, (t.LiteralTerm, t.Apply, t.Op)), f"{value!r} is no term"
    return value


# Koord's types as sorts: a type with parts is flattened, a value of variable length is one value of its own sort.

Leaf = tuple[str, Sort]  # suffix of the symbol of one part of a value (".target.x"), and its sort
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
    """Return the names and types of a type's parts; None for a type that is a single value."""
    if isinstance(type_, RecordType):
        return type_.fields
    if isinstance(type_, TupleOf):
        return tuple([(str(i), item) for i, item in enumerate(type_.items)])
    return _PARTS.get(type_)


def sort_of(type_: Type) -> Sort:
    """Return the sort of a type without parts.

    Strings, maps of places, scans, extern types and collections have sorts of their own, named like the type."""
    return _PLAIN.get(type_) or Sort(str(type_))


def shape(type_: Type) -> tuple[Leaf, ...]:
    """Return the leaves of a type, in the order in which its values are flattened."""
    parts = parts_of(type_)
    if parts is None:
        return (("", sort_of(type_)),)
    return tuple([(f".{name}{suffix}", sort) for name, part in parts for suffix, sort in shape(part)])


def build(type_: Type, leaves: Iterator[Term]) -> Val:
    """Return a value of a type, built from its leaves."""
    parts = parts_of(type_)
    if parts is not None:
        return tuple([build(part, leaves) for _, part in parts])
    leaf = next(leaves)
    return OpaqueCollection(leaf, type_) if is_collection(type_) else leaf
