"""Koord's values while a program is run on symbols: a term, a tuple of parts, or a collection.

A collection keeps how it was made, so that its length and its elements are told where they are asked for, and no axiom
about lists is ever needed.
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


class Named(Node):
    """A collection of which nothing is known but the term that it is."""

    term: Term
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Known(Node):
    """The collection of these elements: of a map, pairs. Sets and maps are in no order here."""

    items: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Choice(Node):
    """The one collection or the other."""

    condition: Term
    then: Collection
    orelse: Collection
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Changed(Node):
    """A collection after an update of koordgen/lang/ir/builtins.py ("appended", "updated") with these arguments."""

    update: str
    base: Collection
    args: tuple[Val, ...]
    type: Type
    __eq__ = object.__eq__
    __hash__ = object.__hash__


class Fleet(Node):
    """One value a robot, as a whole: `slot` reads one; `name` tells the variable and the moment. `changed`: it is
    another one but for what one robot has there."""

    name: str
    slot: Callable[[Term], Val]
    type: Type
    changed: tuple[Fleet, Term, Val] | None = None
    __eq__ = object.__eq__
    __hash__ = object.__hash__


Collection = Named | Known | Choice | Changed | Fleet
Val = Term | tuple["Val", ...] | Collection


def is_collection(type_: Type) -> bool:
    return isinstance(type_, (Sequence, MapOf, PerRobot))


def pick(condition: Term, then: Val, orelse: Val) -> Val:
    """The one value or the other, of one type."""
    if condition is t.TRUE or then is orelse:
        return then
    if condition is t.FALSE:
        return orelse
    if isinstance(then, tuple) and isinstance(orelse, tuple):
        return tuple([pick(condition, a, b) for a, b in zip(then, orelse, strict=True)])
    if isinstance(then, (Named, Known, Choice, Changed, Fleet)):
        assert isinstance(orelse, (Named, Known, Choice, Changed, Fleet))
        if isinstance(then, Choice) and then.condition is condition:
            then = then.then
        if isinstance(orelse, Choice) and orelse.condition is condition:
            orelse = orelse.orelse
        if then is orelse or (isinstance(then, Named) and isinstance(orelse, Named) and then.term is orelse.term):
            return then
        return Choice(condition, then, orelse, then.type)
    assert not isinstance(orelse, (tuple, Named, Known, Choice, Changed, Fleet))
    assert not isinstance(then, tuple)
    return t.ite(condition, then, orelse)


def truth(value: Val) -> Term:
    """A value that is a term."""
    assert isinstance(value, (t.Value, t.Apply, t.Op)), f"{value!r} is no term"
    return value


# Koord's types as sorts: what has parts is flattened, what varies in length is one value of a sort of its own.

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
