"""Types as they were written."""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span


class NamedType(Node):
    """`Point`, a record's or an extern type's name; also the words of the 2020 dialect (`pos`, `boolean`)."""

    name: str
    span: Span


class GenericType(Node):
    """`List<T>`, `List<A, B>`, `Map<K, V>`, `Set<T>`, `Queue<T>`; `T[]` of the 2020 dialect has the name `[]`."""

    name: str
    args: tuple[TypeExpr, ...]
    span: Span


class TupleType(Node):
    """`(A, B)`"""

    items: tuple[TypeExpr, ...]
    span: Span


class BrokenType(Node):
    """What could not be read; it has been reported."""

    span: Span


TypeExpr = NamedType | GenericType | TupleType | BrokenType
