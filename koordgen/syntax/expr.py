"""Expressions as they were written."""

from __future__ import annotations

from koordgen.node import Node
from koordgen.source import Span


class Name(Node):
    """A name of any kind; the checker knows which."""

    name: str
    span: Span


class Literal(Node):
    """An int, a float or a bool."""

    value: int | float | bool
    span: Span


class Attribute(Node):
    """`value.name`: a port of a module or a field."""

    value: Expr
    name: str
    name_span: Span
    span: Span


class Index(Node):
    """`value[index]`"""

    value: Expr
    index: Expr
    span: Span


class Call(Node):
    """`function(args)`"""

    function: Expr
    args: tuple[Expr, ...]
    span: Span


class Unary(Node):
    """op: `-` or `not`."""

    op: str
    operand: Expr
    span: Span


class Binary(Node):
    """op: `+ - * / // %`."""

    op: str
    left: Expr
    right: Expr
    span: Span


class Compare(Node):
    """`first op second op third ...`: every neighbouring pair holds, as in Python."""

    first: Expr
    rest: tuple[tuple[str, Expr], ...]
    span: Span


class Logic(Node):
    """op: `and` or `or`."""

    op: str
    left: Expr
    right: Expr
    span: Span


class Conditional(Node):
    """`then if condition else orelse`"""

    condition: Expr
    then: Expr
    orelse: Expr
    span: Span


Expr = Name | Literal | Attribute | Index | Call | Unary | Binary | Compare | Logic | Conditional
