"""Symbolic values of Koord's types: a term, a tuple of parts, or a collection.

A collection records how it was built. The length and the elements are derived from this record on demand, so the
encoding needs no axioms about lists.
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
    """Collection that contains exactly `items`. The items of a map are pairs of key and value.

    For sets and maps, the order of the items has no meaning."""

    items: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class ConditionalCollection(Node):
    """Conditional collection: `then` if `condition` holds, otherwise `orelse`."""

    condition: Term
    then: Collection
    orelse: Collection
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class UpdatedCollection(Node):
    """Collection `base` after an update, such as "appended".

    koordgen/lang/ir/builtins.py lists the updates."""

    update: str
    base: Collection
    args: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class FleetValue(Node):
    """Values of one variable in all robots, as one value.

    `name`: identifies the variable and the state.
    `slot`: returns the value of one robot.
    `changed`: (other, robot, value) if the values equal those of the FleetValue `other` in all robots but `robot`."""

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
    """Return `then` if the condition holds, otherwise `orelse`. Both values have the same type."""
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
    """Return a value that the caller knows to be a single term."""
    assert isinstance(value, (t.LiteralTerm, t.Apply, t.Op)), f"{value!r} is no term"
    return value


# Sorts of Koord's types. A value of a type with parts becomes one term per part. A value without a fixed size becomes
# one term of a separate sort.

# Leaf: the sort of one part of a value, with the suffix of its symbol, such as ".target.x".
Leaf = tuple[str, Sort]
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

    Strings, maps of places, scans, extern types and collections each have an uninterpreted sort, named after the
    type."""
    return _PLAIN.get(type_) or Sort(str(type_))


def shape(type_: Type) -> tuple[Leaf, ...]:
    """Return the leaves of a type, in the order in which values of the type are flattened."""
    parts = parts_of(type_)
    if parts is None:
        return (("", sort_of(type_)),)
    return tuple([(f".{name}{suffix}", sort) for name, part in parts for suffix, sort in shape(part)])


def build(type_: Type, leaves: Iterator[Term]) -> Val:
    """Return a value of a type, built from its flattened terms."""
    parts = parts_of(type_)
    if parts is not None:
        return tuple([build(part, leaves) for _, part in parts])
    leaf = next(leaves)
    return OpaqueCollection(leaf, type_) if is_collection(type_) else leaf
