"""Nodes that stand in a program only between its two checks, and how expressions with errors look there.

`check` resolves names and types, and yields the IR with these nodes among its statements. `analyze` judges what stands
there, and yields the IR alone. An expression in which an error was reported has the type POISON: a Const, or a Make
whose items are the parts that are right and are still to be judged.
"""

from __future__ import annotations

from typing import Literal

from koordgen.lang.ir.expr import Expr
from koordgen.lang.ir.stmt import Stmt
from koordgen.lang.node import Node
from koordgen.lang.source import Span

# Where an expression stands decides what it may read: `constant` (literals, params), `init`, `guard`, `effect`,
# `function` (parameters, params), `contract` (parameters, params, `result`), `property` (everything, by robot),
# `assume` (one module's ports, primed or not, params, pid).
Section = Literal["constant", "init", "guard", "effect", "function", "contract", "property", "assume"]


class SlotPlace(Node):
    """`x[index] = ...` of an allread variable. The analysis makes it an OwnSlot, or reports that it may be another
    robot's slot."""

    name: str
    index: Expr
    span: Span


class Atomic(Node):
    """`atomic:`; the statements of its block follow. The event that contains it is a transaction."""

    span: Span


class Unread(Node):
    """A statement that could not be read: what it does is not known."""

    span: Span


class Wrong(Node):
    """A statement that has no meaning, which has been reported. Its `parts` are expressions that are right."""

    parts: tuple[Expr, ...]
    span: Span


Draft = Stmt | Atomic | Unread | Wrong
