"""Statements as they were written. A block is a tuple of them."""

from __future__ import annotations

from koordgen.node import Node
from koordgen.source import Span
from koordgen.syntax.expr import Expr


class Assign(Node):
    """`target = value`; `op` is `+` for `+=` and so on, empty for `=`."""

    target: Expr
    op: str
    value: Expr
    span: Span


class Declare(Node):
    """`Type name = value`; without a value it is the type's default."""

    type: str
    type_span: Span
    name: str
    name_span: Span
    value: Expr | None
    span: Span


class Branch(Node):
    """`if` or `elif` with its condition and block."""

    condition: Expr
    block: Block
    span: Span


class If(Node):
    """A chain of conditions, of which the first that holds counts."""

    branches: tuple[Branch, ...]
    orelse: Block
    span: Span


class Evaluate(Node):
    """An expression that stands alone."""

    value: Expr
    span: Span


class Pass(Node):
    """`pass`"""

    span: Span


class Stop(Node):
    """`stop`"""

    span: Span


Stmt = Assign | Declare | If | Evaluate | Pass | Stop
Block = tuple[Stmt, ...]
