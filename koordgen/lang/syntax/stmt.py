"""Syntax tree of statements. A block is a tuple of statements."""

from __future__ import annotations

from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax.expr import Expr, Name
from koordgen.lang.syntax.types import TypeExpr


class Assign(Node):
    """Assignment `target = value`. `op` is `+` for `+=` and so on, empty for `=`."""

    target: Expr
    op: str
    value: Expr
    span: Span


class Declare(Node):
    """Declaration `Type name = value`. Without a value the variable has the default of its type."""

    type: TypeExpr
    name: str
    name_span: Span
    value: Expr | None
    span: Span


class Branch(Node):
    """One branch of an `if` statement: `if` or `elif` with its condition and block."""

    condition: Expr
    block: Block
    span: Span


class If(Node):
    """Statement `if`, with its `elif` branches and `else` block."""

    branches: tuple[Branch, ...]
    orelse: Block
    span: Span


class For(Node):
    """Loop `for a, b in values:`. Its span is the header's."""

    names: tuple[Name, ...]
    values: Expr
    block: Block
    span: Span


class CountedFor(Node):
    """Loop `for i = first, last:` of the 2020 dialect, with `last` included."""

    name: Name
    first: Expr
    last: Expr
    block: Block
    span: Span


class While(Node):
    """Loop `while condition:`. Its span is the header's."""

    condition: Expr
    block: Block
    span: Span


class Atomic(Node):
    """Block `atomic:`. Its span is the keyword's."""

    block: Block
    span: Span


class Evaluate(Node):
    """Expression as a statement: a call, or a write to a stream (`Log.stdout << a << b`)."""

    value: Expr
    span: Span


class Return(Node):
    """Statement `return value`."""

    value: Expr
    span: Span


class Break(Node):
    """Statement `break`."""

    span: Span


class Continue(Node):
    """Statement `continue`."""

    span: Span


class Pass(Node):
    """Statement `pass`."""

    span: Span


class Stop(Node):
    """Statement `stop`."""

    span: Span


class Invariant(Node):
    """Loop invariant `invariant condition`, at the head of a loop's block."""

    condition: Expr
    span: Span


class BrokenStmt(Node):
    """A statement that could not be parsed; the error is already reported. `names` has all names in it."""

    names: tuple[str, ...]
    span: Span


Stmt = (
    Assign | Declare | If | For | CountedFor | While | Atomic | Evaluate | Return | Break | Continue | Pass | Stop
    | Invariant | BrokenStmt
)  # fmt: skip
Block = tuple[Stmt, ...]
