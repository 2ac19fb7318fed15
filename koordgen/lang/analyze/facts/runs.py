"""Values of a `for` loop's variable in its first and last iteration, for loops over a range or `ID`.

The values are computed only if every iteration evaluates a given expression, such as an index. If the expression is
wrong for one of these values, the loop is certain to fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.flow import independent, variable_of
from koordgen.lang.analyze.facts.linear import Formula, Linear
from koordgen.lang.analyze.facts.terms import Flow, term
from koordgen.lang.ir import draft, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import children, walk
from koordgen.lang.node import Node
from koordgen.lang.source import Span


class Loop(NamedTuple):
    """A `for` over a range or over ID whose block is being analysed.

    `name` is the name of the loop's variable in the program, and `temp` is its name in a Flow. `before` holds the facts
    before the loop. `changed` is the set of outer variables that the loop's block may change; the lengths of the
    variables in `sized` do not change.
    """

    name: str
    temp: str
    values: ir.Expr
    before: Flow
    changed: frozenset[str]
    sized: frozenset[str]
    block: stmt.Block


class CertainIterations(NamedTuple):
    """Iterations of a loop that evaluate an expression.

    `values` has the values of the loop's variable in these iterations. `flow` has the facts before the loop, with the
    condition that the loop has at least one iteration.
    """

    values: tuple[Linear, ...]
    flow: Flow


def certain_iterations(loop: Loop, span: Span, terms: tuple[Linear, ...]) -> CertainIterations | None:
    """Return the last and the first iteration if every iteration evaluates the expression at `span`.

    Returns None if an iteration may skip the expression, or if `terms` may depend on variables that earlier iterations
    changed.
    """
    ends = _ends(loop)
    if (
        ends is None
        or not all(independent(item, loop.changed, loop.sized) for item in terms)
        or any(_may_skip(node, loop) for node in walk(loop.block))
        or not _in_block(loop.block, span)
    ):
        return None
    first, last, some = ends
    return CertainIterations((first,) if last is None else (last, first), loop.before.assuming(some))


def _ends(loop: Loop) -> tuple[Linear, Linear | None, Formula] | None:
    """Return the first value of a loop's variable, its last value, and the condition that there is an iteration.

    The last value is None if it is unknown. Returns None if the first value or the condition is unknown.
    """
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


_LEAVING = (stmt.Break, stmt.Continue, stmt.Return, stmt.Stop, draft.UnparsedStmt)


def _may_skip(node: Node, loop: Loop) -> bool:
    """Return whether a statement may end an iteration of the loop early, or changes the loop's variable."""
    return isinstance(node, _LEAVING) or (isinstance(node, stmt.Assign) and variable_of(node.place) == loop.temp)


def _in_block(block: Sequence[draft.Draft], span: Span) -> bool:
    """Return whether each execution of a block evaluates the expression at `span`."""
    for statement in block:
        parts: tuple[ir.Expr, ...]
        match statement:
            case stmt.Assign(draft.SlotPlace(_, index), value):
                parts = (index, value)
            case stmt.Assign(_, value) | stmt.Let(value=value):
                parts = (value,)
            case stmt.If(condition):
                parts = (condition,)
            case stmt.For(values=values):
                parts = (values,)
            case stmt.Emit(items=items) | draft.WrongStmt(items):
                parts = items
            case _:
                continue
        if any(_in_expression(part, span) for part in parts):
            return True
    return False


def _in_expression(root: ir.Expr, span: Span) -> bool:
    """Return whether the evaluation of an expression always evaluates its part at `span`.

    Returns False if an `and`, `or`, `if` or quantifier may skip the part.
    """
    pending: list[Node] = [root]
    while pending:
        match pending.pop():
            case ir.Logic(left=first) | ir.Conditional(condition=first) | ir.Quantified(domain=first):
                pending.append(first)
            case node:
                if node.span is span:  # type: ignore[attr-defined]
                    return True
                pending.extend(children(node))
    return False
