"""The runs of a counted loop that are sure to come: its first and its last, and what its block does in each of them."""

from __future__ import annotations

from typing import NamedTuple

from koordgen.lang.analyze import linear
from koordgen.lang.analyze.facts import Flow, term
from koordgen.lang.analyze.flow import independent
from koordgen.lang.analyze.linear import Formula, Linear
from koordgen.lang.analyze.walk import parts, statements
from koordgen.lang.ir import expr as ir
from koordgen.lang.node import Node
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree


class Loop(NamedTuple):
    """A `for` whose block is being checked; `before` is known where it begins. `changed` are the variables around it
    that its block may change; of those in `sized` the lengths stay."""

    name: str
    temp: str
    values: ir.Expr
    before: Flow
    changed: frozenset[str]
    sized: frozenset[str]
    block: tree.Block


class Runs(NamedTuple):
    """Runs of a loop: the values of its variable in them, and what is known where the loop begins if it runs at all."""

    values: tuple[Linear, ...]
    flow: Flow


def sure(loop: Loop, span: Span, terms: tuple[Linear, ...]) -> Runs | None:
    """The last run and the first, where every run evaluates what stands at `span`; None where `terms`, as they are
    known there, may depend on what earlier runs changed."""
    ends = _ends(loop)
    if (
        ends is None
        or not all(independent(item, loop.changed, loop.sized) for item in terms)
        or any(isinstance(s, _LEAVING) or _assigns(s, loop.name) for s in statements(loop.block))
        or not _in_block(loop.block, span)
    ):
        return None
    first, last, some = ends
    return Runs((first,) if last is None else (last, first), loop.before.knowing(some))


def _ends(loop: Loop) -> tuple[Linear, Linear | None, Formula] | None:
    """The variable's first and last value, and that there is one; None where that is not known."""
    match loop.values:
        case ir.Ids():
            size = linear.variable(linear.N_SYS)
            return linear.constant(0), linear.combine(size, linear.constant(-1)), linear.TRUE
        case ir.Range(start, stop, step):
            first, end = term(start, loop.before), term(stop, loop.before)
            if first is None or end is None:
                return None
            last = linear.combine(end, linear.constant(-step)) if abs(step) == 1 else None
            return first, last, linear.less(first, end) if step > 0 else linear.less(end, first)
        case _:
            return None


_LEAVING = (tree.Break, tree.Continue, tree.Return, tree.Stop, tree.BrokenStmt)


def _assigns(statement: tree.Stmt, name: str) -> bool:
    return (
        isinstance(statement, tree.Assign) and isinstance(statement.target, ast.Name) and statement.target.name == name
    )


def _in_block(block: tree.Block, span: Span) -> bool:
    """Whether each run of a block evaluates what stands there."""
    for statement in block:
        parts: tuple[ast.Expr | None, ...]
        match statement:
            case tree.Assign(target, _, value):
                parts = (target, value)
            case tree.Declare(value=value) | tree.Evaluate(value):
                parts = (value,)
            case tree.If(branches):
                parts = (branches[0].condition,)
            case tree.For(values=values):
                parts = (values,)
            case tree.Atomic(inner):
                if _in_block(inner, span):
                    return True
                continue
            case _:
                continue
        if any(_in_expression(part, span) for part in parts):
            return True
    return False


def _in_expression(root: ast.Expr | None, span: Span) -> bool:
    """Whether an expression always evaluates what stands there: no `and`, `or`, `if` or chain decides about it."""
    pending: list[object] = [root]
    while pending:
        match pending.pop():
            case tuple() as items:
                pending.extend(items)
            case ast.Logic(left=first) | ast.Conditional(condition=first) | ast.Quantified(domain=first):
                pending.append(first)
            case ast.Compare(first, rest):
                pending += [first, rest[0][1]]
            case Node() as node:
                if node.span is span:  # type: ignore[attr-defined]
                    return True
                pending.extend(parts(node))
            case _:
                pass
    return False
