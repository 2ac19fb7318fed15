"""Syntax tree of expressions.

Spellings of the 2020 dialect (`&&`, `true`) are kept as written; the checker reports them.
"""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Name(Node):
    """Name of any kind; the checker resolves it."""

    name: str
    span: Span


class Literal(Node):
    """Literal int, float, bool or string. Escapes of a string are resolved."""

    value: int | float | bool | str
    span: Span


class Attribute(Node):
    """Attribute `value.name`: a port of a module, a field or a method."""

    value: Expr
    name: str
    name_span: Span
    span: Span


class Primed(Node):
    """Primed port `value'` in an assumption: the port's value at any time during the following delta."""

    value: Expr
    span: Span


class Index(Node):
    """Index `value[index]`."""

    value: Expr
    index: Expr
    span: Span


class Slice(Node):
    """Slice `value[start:stop]`; both ends are optional."""

    value: Expr
    start: Expr | None
    stop: Expr | None
    span: Span


class Keyword(Node):
    """Argument with a name in a call: `name=value`. Its span is the name's."""

    name: str
    value: Expr
    span: Span


class Call(Node):
    """Call `function(args)`."""

    function: Expr
    args: tuple[Expr | Keyword, ...]
    span: Span


class Tuple(Node):
    """Tuple `(a, b)`, with two or more items."""

    items: tuple[Expr, ...]
    span: Span


class ListDisplay(Node):
    """List `[a, b]`."""

    items: tuple[Expr, ...]
    span: Span


class SetDisplay(Node):
    """Set `{a, b}`, with one or more items."""

    items: tuple[Expr, ...]
    span: Span


class MapDisplay(Node):
    """Map `{k: v}`. `{}` is an empty map or set, depending on the expected type."""

    items: tuple[tuple[Expr, Expr], ...]
    span: Span


class Unary(Node):
    """Unary operator: `-`, `not`, or `!` of the 2020 dialect."""

    op: str
    operand: Expr
    span: Span


class Binary(Node):
    """Binary operator: `+ - * / // % **`, or `<<`, which writes to a stream."""

    op: str
    left: Expr
    right: Expr
    span: Span


class Compare(Node):
    """Comparison `first op second op third ...`: true if each neighbouring pair holds, as in Python.

    Operators: `== != < <= > >= in`, `not in`.
    """

    first: Expr
    rest: tuple[tuple[str, Expr], ...]
    span: Span


class Logic(Node):
    """Logical operator: `and`, `or`, or `&&`, `||` of the 2020 dialect. `op_span` is the operator's span."""

    op: str
    op_span: Span
    left: Expr
    right: Expr
    span: Span


class Conditional(Node):
    """Conditional `then if condition else orelse`."""

    condition: Expr
    then: Expr
    orelse: Expr
    span: Span


class Quantified(Node):
    """Quantifier `forall i, j in domain: body`. `kind` is `forall` or `exists`."""

    kind: str
    names: tuple[Name, ...]
    domain: Expr
    body: Expr
    span: Span


class Broken(Node):
    """Text that could not be parsed; the error is already reported.

    `names` has all names in it. The text may declare them, so later uses are not reported as undefined.
    """

    names: tuple[str, ...]
    span: Span


Expr = (
    Name | Literal | Attribute | Primed | Index | Slice | Call | Tuple | ListDisplay | SetDisplay | MapDisplay
    | Unary | Binary | Compare | Logic | Conditional | Quantified | Broken
)  # fmt: skip
