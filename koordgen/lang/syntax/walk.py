"""Walks over syntax trees, for rare questions. `ir/tree.py` has those over the IR."""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.node import Node
from koordgen.lang.syntax import decl, expr, stmt
from koordgen.lang.syntax.types import BrokenType

_APART = ("span", "name_span", "op_span", "def_span")


def parts(node: object) -> tuple[object, ...]:
    """Return the values of a node's fields without spans, or the items of a tuple.

    Of other values nothing.
    """
    if isinstance(node, Node):
        return tuple([getattr(node, f) for f in type(node).__match_args__ if f not in _APART])  # type: ignore[attr-defined]
    return node if isinstance(node, tuple) else ()


def nodes(root: object) -> Iterator[Node]:
    """Yield all nodes of a tree, or of a tuple of trees, except spans, in no particular order."""
    pending: list[object] = [root]
    while pending:
        item = pending.pop()
        if isinstance(item, Node):
            yield item
        pending.extend(parts(item))


def broken_names(program: decl.Program) -> frozenset[str]:
    """Return all names in text that could not be parsed."""
    found: set[str] = set()
    for node in nodes(program):
        if isinstance(node, (expr.Broken, stmt.BrokenStmt, decl.BrokenSection)):
            found.update(node.names)
        elif isinstance(node, (decl.Variable, decl.Param)) and isinstance(node.type, BrokenType):
            found.add(node.name)
    return frozenset(found)


def is_whole(program: decl.Program) -> bool:
    """Return whether all of a program could be parsed."""
    return not any(isinstance(node, (expr.Broken, stmt.BrokenStmt, decl.BrokenSection)) for node in nodes(program))


def statements(block: stmt.Block) -> Iterator[stmt.Stmt]:
    """Yield all statements of a block and of the blocks in it."""
    pending = list(block)
    while pending:
        statement = pending.pop()
        yield statement
        match statement:
            case stmt.If(branches, orelse):
                for branch in branches:
                    pending.extend(branch.block)
                pending.extend(orelse)
            case stmt.For(block=inner) | stmt.CountedFor(block=inner) | stmt.While(block=inner) | stmt.Atomic(inner):
                pending.extend(inner)
            case _:
                pass
