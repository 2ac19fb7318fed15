"""Blocks of statements: the way into each, and what is known after an assignment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from koordgen.lang.check.context import Context
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir import stmt
from koordgen.lang.syntax import stmt as tree

Out = list[stmt.Stmt]  # where a checked statement goes, or the several that it becomes
# By the class of the node; stmt.py fills it.
STATEMENTS: dict[type, Callable[[Any, Context, Out], None]] = {}


def check_block(block: tree.Block, c: Context) -> stmt.Block:
    """The statements of a block; its declarations end with it. `c.path` is None if no run gets to the end."""
    c.scopes.append({})
    checked: Out = []
    told = False
    for statement in block:
        if c.path is None and not told and type(statement) is not tree.Pass:
            c.warn("K043", "this statement can never run: every way to it has stopped or left", statement.span)
            told = True
        STATEMENTS[type(statement)](statement, c, checked)
    c.scopes.pop()
    return tuple(checked)


def learn(place: stmt.Place, value: ir.Expr, c: Context) -> None:
    """After `place = value`: what was known of the place is gone, and its new value may be known."""
    if c.path is not None:
        c.path = c.path.assigning(place, value)
