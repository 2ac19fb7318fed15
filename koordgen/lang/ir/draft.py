"""Draft nodes, which a program has only between its two checks, and the form of wrong expressions.

`check` resolves names and types, and returns IR with draft nodes among its statements. `analyze` checks the program
and returns IR without drafts. An expression with a reported error has the type POISON: it is a Const, or a Make whose
items are its correct parts, which `analyze` still checks.
"""

from __future__ import annotations

from typing import Literal

from koordgen.lang.ir.expr import Expr
from koordgen.lang.ir.stmt import Stmt
from koordgen.lang.node import Node
from koordgen.lang.source import Span

# The section of an expression decides what it may read: `constant` (literals, params), `init`, `guard`, `effect`,
# `function` (parameters, params), `contract` (parameters, params, `result`), `property` (everything, by robot),
# `assume` (one module's ports, primed or not, params, pid), `guarantee` (its variable, primed or not, params),
# `provided` (shared variables, params).
Section = Literal[
    "constant", "init", "guard", "effect", "function", "contract", "property", "assume", "guarantee", "provided"
]


class SlotPlace(Node):
    """Target `x[index] = ...`, a slot of an allread variable.

    The analysis turns it into an OwnSlot, or reports that it may be another robot's slot.
    """

    name: str
    index: Expr
    span: Span


class Atomic(Node):
    """Marker of `atomic:`, before the statements of its block.

    The event that contains it is a transaction.
    """

    span: Span


class UnparsedStmt(Node):
    """A statement that could not be parsed: its effect is unknown."""

    span: Span


class WrongStmt(Node):
    """A wrong statement, whose error is already reported. `parts` has its correct expressions."""

    parts: tuple[Expr, ...]
    span: Span


Draft = Stmt | Atomic | UnparsedStmt | WrongStmt
