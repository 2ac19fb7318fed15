"""K035: a `while` that is not proved to end.

The proof: the condition compares a number, or a length, with a value that the loop does not change, and every path
through the loop moves the number towards this value by a constant step.
"""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.lang.analyze.facts.flow import variable_of
from koordgen.lang.analyze.facts.induction import conjuncts, writes
from koordgen.lang.ir import draft, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import children, statements, walk
from koordgen.lang.ir.types import POISON
from koordgen.lang.node import Node
from koordgen.lang.reporter import Reporter

_LONGER = frozenset(("appended", "inserted"))
_SHORTER = frozenset(("popped", "without", "removed", "set_without", "map_without"))
_HELP = (
    "a round must end: compare a number in the condition, and let every path through the loop "
    "change the number by a step"
)


class _Wrong(Exception):
    """Raised for a path through a loop that moves the number in the wrong direction, or not at all."""


def check_end(node: stmt.While, reporter: Reporter) -> None:
    """Warn of a loop that is not proved to end, unless the loop contains an error."""
    if not _ends(node) and not any(_is_wrong(part) for part in walk(node)):
        reporter.warn("K035", "nothing shows that this loop ends", node.span, _HELP)


def _is_wrong(part: object) -> bool:
    return isinstance(part, draft.UnparsedStmt) or getattr(part, "type", None) is POISON


def _ends(node: stmt.While) -> bool:
    for part in conjuncts(node.condition):
        match part:
            case ir.Const(False):
                return True
            case ir.Compare(op, first, second):
                for moved, other, up in ((first, second, ("<", "<=")), (second, first, (">", ">="))):
                    down = (">", ">=") if up == ("<", "<=") else ("<", "<=")
                    step = 1 if op in up else -1 if op in down else 0
                    if step and _moves_towards(moved, other, step, node.block):
                        return True
            case _:
                pass
    return not _returns_to_start(node.block)


def _moves_towards(moved: ir.Expr, other: ir.Expr, step: int, block: stmt.Block) -> bool:
    if isinstance(moved, ir.Widen):
        moved = moved.operand
    match moved:
        case ir.Builtin("len", (ir.LocalRead() | ir.TempRead() | ir.SharedRead() as read,)):
            length = True
        case ir.LocalRead() | ir.TempRead() | ir.SharedRead() as read:
            length = False
        case _:
            return False
    if _is_changed(other, block):
        return False
    try:
        return _follow(block, variable_of(read) or "", length, step, False)
    except _Wrong:
        return False


def _is_changed(bound: ir.Expr, block: stmt.Block) -> bool:
    """Return whether a block may change a bound's value. A write of an element does not change the length of a list."""
    written = list(writes(block))
    changed, resized = {name for name, _ in written}, {name for name, same_length in written if not same_length}
    pending: list[Node] = [bound]
    while pending:
        part = pending.pop()
        match part:
            case ir.Builtin("len", (ir.LocalRead() | ir.TempRead() | ir.SharedRead() as read,)):
                if variable_of(read) in resized:
                    return True
            case _:
                if variable_of(part) in changed:
                    return True
                pending.extend(children(part))
    return False


def _follow(block: Sequence[draft.Draft], name: str, length: bool, step: int, moved: bool) -> bool:
    """Return whether every path to the end of the block moves the number in the direction of `step`.

    The number is the variable `name`, or its length. Returns True if no path reaches the end of the block.
    """
    for statement in block:
        match statement:
            case stmt.If(_, then, orelse):
                followed = [_follow(way, name, length, step, moved) for way in (then, orelse)]
                moved = all(followed)
            case stmt.For(block=inner) | stmt.While(block=inner):
                for part in statements(inner):
                    _moves(part, name, length, step)
            case stmt.Continue():
                if not moved:
                    raise _Wrong
                return True
            case stmt.Break() | stmt.Return() | stmt.Stop():
                return True
            case _:
                moved = _moves(statement, name, length, step) or moved
    return moved


def _moves(statement: draft.Draft, name: str, length: bool, step: int) -> bool:
    """Return whether a statement moves the variable `name`, or its length, in the direction of `step`.

    Raises _Wrong if the statement changes the variable in another way.
    """
    if not isinstance(statement, stmt.Assign) or variable_of(statement.place) != name:
        return False
    if not length:
        if _step(name, statement.value) * step > 0:
            return True
        raise _Wrong
    match statement.value:
        case ir.Builtin("updated", (read, *_)) if variable_of(read) == name:
            return False
        case ir.Builtin(update, (read, *_)) if variable_of(read) == name:
            if update in (_LONGER if step > 0 else _SHORTER):
                return True
        case _:
            pass
    raise _Wrong


def _step(name: str, value: ir.Expr) -> float:
    """Return the amount by which `name = value` changes the variable; 0 if the amount is not known."""
    match value:
        case ir.Binary("+" | "-" as sign, first, by) if variable_of(first) == name:
            return _number(by) if sign == "+" else -_number(by)
        case ir.Binary("+", by, second) if variable_of(second) == name:
            return _number(by)
        case _:
            return 0


def _number(node: ir.Expr) -> float:
    match node:
        case ir.Const(int() | float() as value) | ir.Widen(ir.Const(int() as value)):
            return value
        case _:
            return 0


def _returns_to_start(block: Sequence[draft.Draft]) -> bool:
    """Return whether the loop may run a second time: some path reaches the block's end or a `continue`."""
    for statement in block:
        match statement:
            case stmt.Continue():
                return True
            case stmt.Break() | stmt.Return() | stmt.Stop():
                return False
            case stmt.If(_, then, orelse):
                if _continues(then) or _continues(orelse):
                    return True
                if not _returns_to_start(then) and not _returns_to_start(orelse):
                    return False
            case _:
                pass
    return True


def _continues(block: Sequence[draft.Draft]) -> bool:
    """Return whether some path through a block reaches a `continue` of the enclosing loop."""
    for statement in block:
        match statement:
            case stmt.Continue():
                return True
            case stmt.If(_, then, orelse):
                if _continues(then) or _continues(orelse):
                    return True
            case _:
                pass
    return False
