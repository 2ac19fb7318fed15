"""Whether the end of a `while` can be seen: its condition compares a number, or a length, with what the loop leaves
alone, and every way through the loop moves the number towards it by a constant step."""

from __future__ import annotations

from koordgen.lang.analyze.walk import nodes, statements
from koordgen.lang.check.context import Context
from koordgen.lang.check.statements.target import updates
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree

_LONGER, _SHORTER = ("append", "insert", "push"), ("pop", "remove")


class _Wrong(Exception):
    """Something moves the number another way, or not at all."""


def ends(node: tree.While, c: Context) -> bool:
    """Whether the loop's end can be seen."""
    if any(isinstance(part, (ast.Broken, tree.BrokenStmt)) for part in nodes(node)):
        return True
    for part in _conjuncts(node.condition):
        match part:
            case ast.Literal(False):
                return True
            case ast.Compare(first, ((op, second),)):
                for moved, other, up in ((first, second, ("<", "<=")), (second, first, (">", ">="))):
                    down = (">", ">=") if up == ("<", "<=") else ("<", "<=")
                    step = 1 if op in up else -1 if op in down else 0
                    if step and _towards(moved, other, step, node.block, c):
                        return True
            case _:
                pass
    return not _returns_to_start(node.block)


def _conjuncts(node: ast.Expr) -> list[ast.Expr]:
    if isinstance(node, ast.Logic) and node.op in ("and", "&&"):
        return _conjuncts(node.left) + _conjuncts(node.right)
    return [node]


def _towards(moved: ast.Expr, other: ast.Expr, step: int, block: tree.Block, c: Context) -> bool:
    match moved:
        case ast.Name(name):
            length = False
        case ast.Call(ast.Name("len"), (ast.Name(name),)):
            length = True
        case _:
            return False
    fixed = {part.name for part in nodes(other) if isinstance(part, ast.Name)}
    if fixed & _roots(block, c):
        return False
    try:
        return _follow(block, name, length, step, False, c)
    except _Wrong:
        return False


def _follow(block: tree.Block, name: str, length: bool, step: int, moved: bool, c: Context) -> bool:
    """Whether the number has moved when the end of the block is reached (True also where it never is)."""
    for statement in block:
        match statement:
            case tree.If(branches, orelse):
                ways = [*(branch.block for branch in branches), orelse]
                followed = [_follow(way, name, length, step, moved, c) for way in ways]
                moved = all(followed)
            case tree.Atomic(inner):
                moved = _follow(inner, name, length, step, moved, c)
            case tree.For(block=inner) | tree.CountedFor(block=inner) | tree.While(block=inner):
                _follow_inner(inner, name, length, step, c)
            case tree.Continue():
                if not moved:
                    raise _Wrong
                return True
            case tree.Break() | tree.Return() | tree.Stop():
                return True
            case _:
                moved = _moves(statement, name, length, step, c) or moved
    return moved


def _follow_inner(block: tree.Block, name: str, length: bool, step: int, c: Context) -> None:
    for statement in statements(block):
        _moves(statement, name, length, step, c)


def _moves(statement: tree.Stmt, name: str, length: bool, step: int, c: Context) -> bool:
    """Whether a statement moves the number by a step the right way; raises _Wrong where it changes otherwise."""
    value: ast.Expr | None = None
    match statement:
        case tree.Assign(ast.Name(written), op, value) if written == name:
            if not length and _step(name, op, value) * step > 0:
                return True
            raise _Wrong
        case tree.Assign(value=value) | tree.Declare(value=value) | tree.Evaluate(value):
            pass
        case _:
            return False
    if not (updates(value, c) and isinstance(value.function, ast.Attribute) and _root(value.function.value) == name):
        return False
    whole = isinstance(value.function.value, ast.Name)
    if length and whole and value.function.name in (_LONGER if step > 0 else _SHORTER):
        return True
    raise _Wrong


def _step(name: str, op: str, value: ast.Expr) -> float:
    """By how much `name op= value` moves it; 0 where that is not told."""
    match op, value:
        case "", ast.Binary("+" | "-" as sign, ast.Name(first), ast.Literal(int() | float() as by)) if first == name:
            return by if sign == "+" else -by
        case "", ast.Binary("+", ast.Literal(int() | float() as by), ast.Name(second)) if second == name:
            return by
        case "+" | "-", ast.Literal(int() | float() as by):
            return by if op == "+" else -by
        case _:
            return 0


def _roots(block: tree.Block, c: Context) -> set[str]:
    """The names of all that a block changes."""
    found: set[str] = set()
    for statement in statements(block):
        match statement:
            case tree.Assign(target, _, value):
                found.update((_root(target), _root(value.function) if updates(value, c) else ""))
            case tree.Declare(value=value) | tree.Evaluate(value) if updates(value, c):
                found.add(_root(value.function))
            case _:
                pass
    return found


def _root(node: ast.Expr) -> str:
    while isinstance(node, (ast.Index, ast.Attribute, ast.Slice)):
        node = node.value
    return node.name if isinstance(node, ast.Name) else ""


def _returns_to_start(block: tree.Block) -> bool:
    """Whether the loop may run a second time: its block ends, or goes on with the next."""
    for statement in block:
        match statement:
            case tree.Continue():
                return True
            case tree.Break() | tree.Return() | tree.Stop():
                return False
            case tree.If(branches, orelse):
                ways = [*(branch.block for branch in branches), orelse]
                if any(_continues(way) for way in ways):
                    return True
                if not any(_returns_to_start(way) for way in ways):
                    return False
            case tree.Atomic(inner):
                if _continues(inner):
                    return True
                if not _returns_to_start(inner):
                    return False
            case _:
                pass
    return True


def _continues(block: tree.Block) -> bool:
    """Whether some way through a block goes on with the loop around it."""
    for statement in block:
        match statement:
            case tree.Continue():
                return True
            case tree.If(branches, orelse):
                if _continues(orelse) or any(_continues(branch.block) for branch in branches):
                    return True
            case tree.Atomic(inner):
                if _continues(inner):
                    return True
            case _:
                pass
    return False
