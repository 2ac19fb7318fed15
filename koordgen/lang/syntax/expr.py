"""Expressions as they were written. Words and marks of the 2020 dialect stay as they are (`&&`, `true`): the checker
notes them."""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Name(Node):
    """A name of any kind; the checker knows which."""

    name: str
    span: Span


class Literal(Node):
    """An int, a float, a bool or a string (its escapes resolved)."""

    value: int | float | bool | str
    span: Span


class Attribute(Node):
    """`value.name`: a port of a module, a field or a method."""

    value: Expr
    name: str
    name_span: Span
    span: Span


class Primed(Node):
    """`value'`: in an assumption, the port at any moment of the following delta."""

    value: Expr
    span: Span


class Index(Node):
    """`value[index]`"""

    value: Expr
    index: Expr
    span: Span


class Slice(Node):
    """`value[start:stop]`, either of them optional."""

    value: Expr
    start: Expr | None
    stop: Expr | None
    span: Span


class Keyword(Node):
    """`name=value` among the arguments of a call; its span is the name's."""

    name: str
    value: Expr
    span: Span


class Call(Node):
    """`function(args)`"""

    function: Expr
    args: tuple[Expr | Keyword, ...]
    span: Span


class Tuple(Node):
    """`(a, b)`: two items at least."""

    items: tuple[Expr, ...]
    span: Span


class ListDisplay(Node):
    """`[a, b]`"""

    items: tuple[Expr, ...]
    span: Span


class SetDisplay(Node):
    """`{a, b}`: one item at least."""

    items: tuple[Expr, ...]
    span: Span


class MapDisplay(Node):
    """`{k: v}`; `{}` is an empty map or an empty set, as is wanted."""

    items: tuple[tuple[Expr, Expr], ...]
    span: Span


class Unary(Node):
    """op: `-`, `not`; `!` of the 2020 dialect."""

    op: str
    operand: Expr
    span: Span


class Binary(Node):
    """op: `+ - * / // % **`, and `<<` of a stream."""

    op: str
    left: Expr
    right: Expr
    span: Span


class Compare(Node):
    """`first op second op third ...`: every neighbouring pair holds, as in Python.
    op: `== != < <= > >= in`, `not in`."""

    first: Expr
    rest: tuple[tuple[str, Expr], ...]
    span: Span


class Logic(Node):
    """op: `and`, `or`; `&&`, `||` of the 2020 dialect. `op_span` is the operator's place."""

    op: str
    op_span: Span
    left: Expr
    right: Expr
    span: Span


class Conditional(Node):
    """`then if condition else orelse`"""

    condition: Expr
    then: Expr
    orelse: Expr
    span: Span


class Quantified(Node):
    """`forall i, j in domain: body`; kind: `forall` or `exists`. Each name with its place."""

    kind: str
    names: tuple[Name, ...]
    domain: Expr
    body: Expr
    span: Span


class Broken(Node):
    """What could not be read; it has been reported. `names` are the names that stand in it: what it may have meant
    to declare is no second mistake."""

    names: tuple[str, ...]
    span: Span


Expr = (
    Name | Literal | Attribute | Primed | Index | Slice | Call | Tuple | ListDisplay | SetDisplay | MapDisplay
    | Unary | Binary | Compare | Logic | Conditional | Quantified | Broken
)  # fmt: skip
