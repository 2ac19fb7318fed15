"""Methods that change their object: `xs.append(v)` writes `xs` with a value that is longer by one."""

from __future__ import annotations

from typing import TypeGuard

from koordgen.lang.check import bounds
from koordgen.lang.check.base import argument, check_expr, fitting
from koordgen.lang.check.context import Context
from koordgen.lang.check.expressions.call import no_method, positional, skip
from koordgen.lang.check.expressions.name import module_named, word_of
from koordgen.lang.check.statements.target import Target, check_target, hoisted
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.builtins import UPDATES
from koordgen.lang.ir.types import INT, POISON, MapOf, Sequence, Type, list_of
from koordgen.lang.syntax import expr as ast

Update = tuple[Target, ir.Expr | None, ir.Expr]  # what is changed; what `pop` yields; the new value
_NAMES = {name for _, name in UPDATES} | {"pop"}


def updates(node: ast.Expr | None, c: Context) -> TypeGuard[ast.Call]:
    """Whether an expression is the call of a method that changes its object."""
    return (
        type(node) is ast.Call
        and type(node.function) is ast.Attribute
        and node.function.name in _NAMES
        and module_named(node.function.value, c) is None
    )


def pops(node: ast.Expr | None, c: Context) -> TypeGuard[ast.Call]:
    """Whether it also yields a value."""
    return updates(node, c) and isinstance(node.function, ast.Attribute) and node.function.name == "pop"


def check_update(node: ast.Call, c: Context) -> Update | None:
    """What a call for which `updates` holds does; None after reporting that it is wrong."""
    function = node.function
    assert isinstance(function, ast.Attribute)
    target = check_target(function.value, c)
    if target is None or target.read.type is POISON:
        skip(node, c)
        return None
    type_, name = target.read.type, function.name
    word = word_of(type_)
    if name == "pop" and word in ("List", "Queue"):
        return _pop(target, node, c)
    update = UPDATES.get((word, name))
    if update is None:
        skip(node, c)
        no_method(target.read, function, c)
        return None
    types = _arguments(type_, name)
    takes = f"{name} takes ({', '.join(map(str, types))})"
    nodes = positional(node, name, (len(types),), takes, c)
    if nodes is None:
        return None
    args = [
        argument(check_expr(arg, c, wanted), wanted, f"an argument of {name}", c)
        for arg, wanted in zip(nodes, types, strict=True)
    ]
    if any(arg.type is POISON for arg in args):
        return None
    if name == "insert":
        bounds.end_proved(args[0], node.args[0].span, c)
    return target, None, ir.Builtin(update, (target.read, *args), type_, node.span)


def _arguments(type_: Type, name: str) -> tuple[Type, ...]:
    """What an updating method of a type takes."""
    if name == "clear":
        return ()
    if isinstance(type_, MapOf):
        return (type_.key,)
    assert isinstance(type_, Sequence)
    if name == "extend":
        return (list_of(type_.element),)
    return (INT, type_.element) if name == "insert" else (type_.element,)


def _pop(target: Target, node: ast.Call, c: Context) -> Update | None:
    read, type_, span = target.read, target.read.type, node.span
    assert isinstance(type_, Sequence)
    many = (0,) if type_.name == "Queue" else (0, 1)
    help = "the front goes first" if type_.name == "Queue" else "pop() takes the last element, pop(i) that at i"
    nodes = positional(node, "pop", many, help, c)
    if nodes is None:
        return None
    if type_.name == "Queue":
        rest = ir.Builtin("without", (read, ir.Const(0, INT, span)), type_, span)
        return target, ir.Builtin("first", (read,), type_.element, span), rest
    if not nodes:
        last = ir.Binary("-", ir.Builtin("len", (read,), INT, span), ir.Const(1, INT, span), True, INT, span)
        value = ir.At(read, last, bounds.holds_some(read, c), type_.element, span)
        return target, value, ir.Builtin("popped", (read,), type_, span)
    index = hoisted(fitting(check_expr(nodes[0], c), INT, "an index", c), c)
    if index.type is POISON:
        return None
    proved = bounds.element_proved(read, index, span, c)
    return target, ir.At(read, index, proved, type_.element, span), ir.Builtin("without", (read, index), type_, span)
