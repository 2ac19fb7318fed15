"""Syntax tree of types."""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span


class NamedType(Node):
    """Type with a plain name: `Point`, a record or extern type; `pos` and `boolean` in the 2020 dialect."""

    name: str
    span: Span


class GenericType(Node):
    """Container type: `List<T>`, `List<A, B>`, `Map<K, V>`, `Set<T>`, `Queue<T>`.

    `[]` names the old `T[]`.
    """

    name: str
    args: tuple[TypeExpr, ...]
    span: Span


class TupleType(Node):
    """Tuple type `(A, B)`."""

    items: tuple[TypeExpr, ...]
    span: Span


class BrokenType(Node):
    """A type that could not be parsed; the error is already reported."""

    span: Span


TypeExpr = NamedType | GenericType | TupleType | BrokenType
