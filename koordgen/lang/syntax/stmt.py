"""Statements as they were written. A block is a tuple of them."""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax.expr import Expr, Name
from koordgen.lang.syntax.types import TypeExpr


class Assign(Node):
    """`target = value`; `op` is `+` for `+=` and so on, empty for `=`."""

    target: Expr
    op: str
    value: Expr
    span: Span


class Declare(Node):
    """`Type name = value`; without a value it is the type's default."""

    type: TypeExpr
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


class For(Node):
    """`for a, b in values:`; its span is the header's."""

    names: tuple[Name, ...]
    values: Expr
    block: Block
    span: Span


class CountedFor(Node):
    """`for i = first, last:` of the 2020 dialect: `last` is included."""

    name: Name
    first: Expr
    last: Expr
    block: Block
    span: Span


class While(Node):
    """`while condition:`; its span is the header's."""

    condition: Expr
    block: Block
    span: Span


class Atomic(Node):
    """`atomic:`; its span is the word's."""

    block: Block
    span: Span


class Evaluate(Node):
    """An expression that stands alone: a call, or what goes to a stream (`Log.stdout << a << b`)."""

    value: Expr
    span: Span


class Return(Node):
    """`return value`"""

    value: Expr
    span: Span


class Break(Node):
    """`break`"""

    span: Span


class Continue(Node):
    """`continue`"""

    span: Span


class Pass(Node):
    """`pass`"""

    span: Span


class Stop(Node):
    """`stop`"""

    span: Span


class Invariant(Node):
    """`invariant condition`, at the head of a loop's block."""

    condition: Expr
    span: Span


class BrokenStmt(Node):
    """A statement that could not be read; it has been reported. `names` are the names that stand in it."""

    names: tuple[str, ...]
    span: Span


Stmt = (
    Assign | Declare | If | For | CountedFor | While | Atomic | Evaluate | Return | Break | Continue | Pass | Stop
    | Invariant | BrokenStmt
)  # fmt: skip
Block = tuple[Stmt, ...]
