"""Checks of statements: the types of their values, and the variables and ports that they write."""

from __future__ import annotations

from typing import cast

from koordgen.lang.check.base import check_expr, condition, converted, default, with_article
from koordgen.lang.check.context import STATEMENTS, Context, Out, check_block
from koordgen.lang.check.expressions.collection import declare
from koordgen.lang.check.expressions.expr import arithmetic
from koordgen.lang.check.expressions.name import declared_port, module_named
from koordgen.lang.check.statements.loop import check_counted, check_for, check_while
from koordgen.lang.check.statements.target import (
    AssignmentTarget,
    check_target,
    check_update,
    declaration,
    is_pop,
    is_update,
)
from koordgen.lang.check.types import resolve
from koordgen.lang.ir import draft, stmt
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, NAMED, POINT, POISON, STREAM, STRING, PerRobot, Type, list_of
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast
from koordgen.lang.syntax import stmt as tree
from koordgen.lang.syntax.types import NamedType

__all__ = ["check_block", "default"]


def _assign(node: tree.Assign, c: Context, out: Out) -> None:
    target = check_target(node.target, c)
    if target is None:
        c.hoisted.clear()
        out.append(draft.WrongStmt((_unassigned(node, c),), node.span))
        return
    type_ = target.read.type
    if not node.op and is_pop(node.value, c):
        _assign_popped(node, target, c, out)
        return
    value = check_expr(node.value, c, type_)
    if node.op:
        value = arithmetic(node.op, target.read, value, node.span, c)
    if value.type is not type_:
        value = converted(value, type_, c.text(node.target.span), c)
    write(target, value, bool(node.op), node.span, c, out)


def _unassigned(node: tree.Assign, c: Context) -> ir.Expr:
    """Check and return the value of an assignment whose target is wrong.

    If the target is an undeclared variable, the help of its error shows a declaration, which needs the value's type.
    """
    at, target = len(c.found) - 1, node.target
    forgotten = isinstance(target, ast.Name) and c.owners.get(target.name) is target
    if is_pop(node.value, c):
        update = check_update(node.value, c)
        value = (update[1] if update is not None else None) or c.poison(node.span)
        c.hoisted.clear()
    else:
        value = check_expr(node.value, c, POISON)
    type_ = value.type
    if not forgotten or not isinstance(target, ast.Name) or c.found[at].help != declaration(target.name):
        return value
    if isinstance(node.value, ast.ListDisplay) and not node.value.items:
        type_ = list_of(POINT)  # an example of a type, for the declaration that the help shows
    known = type_ is not POISON and not isinstance(type_, PerRobot)
    span, text = node.value.span, c.text(node.value.span)
    kept = known and not node.op and span.line == span.end_line and len(text) <= 40
    help = declaration(target.name, str(type_) if known else "Type", text if kept else "...")
    if c.place in ("init", "effect"):
        help += f"; declare {target.name} under 'local:' to keep it for later events"
    c.found[at] = replace(c.found[at], help=help)
    return value


def write(target: AssignmentTarget, value: ir.Expr, reads: bool, span: Span, c: Context, out: Out) -> None:
    """Append the IR of `target = value` to `out`. `reads` is True if the new value depends on the old value."""
    place = target.place
    hoist(span, c, out)
    if c.place == "init" and type(place) is stmt.SharedPlace:
        if (reads or not target.whole) and place.name not in c.written:
            help = "build the value in a variable of the block, then assign that variable to the shared one"
            c.error("K023", f"init cannot change {place.name}, only set it: it is shared", span, help)
        else:
            c.written.add(place.name)
    if value.type is POISON or target.read.type is POISON:
        new = c.poison(span, value) if target.whole else c.poison(span, target.read, value)
    else:
        new = value if target.whole else target.put(value)
    out.append(stmt.Assign(cast(stmt.Place, place), new, span))


def hoist(span: Span, c: Context, out: Out) -> None:
    """Append to `out` the declarations that must be evaluated before the statement at `span`."""
    for let in c.hoisted:
        out.append(replace(let, span=span))
    c.hoisted.clear()


def _assign_popped(node: tree.Assign, target: AssignmentTarget, c: Context, out: Out) -> None:
    """Check `x = q.pop()`, which reads an element of `q`, assigns it to `x`, and removes it from `q`.

    If `x` is a part of a variable, `q` is written first and `x` last. This order is also used if the removal reads `x`,
    as in `i = xs.pop(i)`: a new value of `i` would remove another element than the element that was read.
    """
    assert isinstance(node.value, ast.Call)
    update = check_update(node.value, c)
    if update is None:
        c.hoisted.clear()
        out.append(draft.WrongStmt((), node.span))
        return
    queue, value, rest = update
    assert value is not None
    value = converted(value, target.read.type, c.text(node.target.span), c)
    if target.whole and queue.whole and target.read not in set(walk(rest)):
        write(target, value, False, node.span, c, out)
        write(queue, rest, True, node.span, c, out)
        return
    if value.type is not POISON:
        name = c.mint("popped")
        hoist(node.span, c, out)
        out.append(stmt.Let(name, value.type, value, node.span))
        value = ir.TempRead(name, value.type, node.span)
    write(queue, rest, True, node.span, c, out)
    write(target, value, False, node.span, c, out)


def _declare(node: tree.Declare, c: Context, out: Out) -> None:
    type_ = _type(node, c)
    update = None
    if node.value is None:
        if type_ is POISON and (c.temp(node.name) is not None or node.name in c.entities):
            out.append(draft.WrongStmt((), node.span))  # for example `assert b`, which is parsed like a declaration
            return
        value = default(type_, node.span, c)
    elif is_pop(node.value, c):
        update = check_update(node.value, c)
        value = (update[1] if update is not None else None) or c.poison(node.span)
    else:
        value = check_expr(node.value, c, type_)
    value = converted(value, type_, node.name, c)
    temp = declare(node.name, type_, node.name_span, c)
    hoist(node.span, c, out)
    out.append(
        stmt.Let(temp.unique, type_, value, node.span) if temp is not None else draft.WrongStmt((value,), node.span)
    )
    if update is not None:
        write(update[0], update[2], True, node.span, c, out)


def _type(node: tree.Declare, c: Context) -> Type:
    """Return the type of a declaration.

    Reports a statement of another language that is parsed like a declaration, such as `global n`.
    """
    written = node.type
    if isinstance(written, NamedType) and written.name not in NAMED and written.name not in c.types:
        from koordgen.lang.syntax.habits import FOREIGN

        if written.name in FOREIGN and written.name not in c.broken:
            c.error("K016", f"Koord has no '{written.name}'", written.span, FOREIGN[written.name])
            return POISON
    return resolve(written, c)


def _evaluate(node: tree.Evaluate, c: Context, out: Out) -> None:
    value = node.value
    if is_update(value, c):
        update = check_update(value, c)
        if update is not None:
            write(update[0], update[2], True, node.span, c, out)
        else:
            out.append(draft.WrongStmt((), node.span))
        c.hoisted.clear()
    elif isinstance(value, ast.Binary) and value.op == "<<":
        _emit(value, node.span, c, out)
    elif isinstance(value, ast.Compare) and value.rest[0][0] == "==":
        c.error("K024", "this comparison does nothing", node.span, "'=' assigns")
        out.append(draft.WrongStmt((), node.span))
    else:
        checked = check_expr(value, c)
        out.append(draft.WrongStmt((checked,), node.span))
        if checked.type is POISON:
            return
        if isinstance(value, ast.Call):
            help = f"assign the result: x = {c.text(node.span)}"
            c.error(
                "K024",
                "the result of this call is not used",
                node.span,
                help if len(help) < 68 else "assign the result",
            )
        else:
            c.error("K024", "this value is not used", node.span)


# Streams


def _emit(node: ast.Binary, span: Span, c: Context, out: Out) -> None:
    """Check a statement that writes to a stream: `Log.stdout << a << b`."""
    parts: list[ast.Expr] = []
    head: ast.Expr = node
    while isinstance(head, ast.Binary) and head.op == "<<":
        parts.append(head.right)
        head = head.left
    items = tuple([_as_string(check_expr(part, c), c) for part in reversed(parts)])
    module = module_named(head.value, c) if isinstance(head, ast.Attribute) else None
    port = declared_port(module, head, c) if module is not None and isinstance(head, ast.Attribute) else None
    if module is not None and port is not None and port.type is STREAM and c.place != "function":
        out.append(stmt.Emit(module.name, port.name, items, span))
        return
    if module is None:
        items = (*items, check_expr(head, c))
        if items[-1].type is not POISON:
            help = "declare a stream: 'using Log:' with 'stream stdout' under it"
            c.error("K056", f"{c.text(head.span)} is not a stream", head.span, help)
    elif port is not None and port.type is STREAM:
        help = "write to the stream in the event that calls the function"
        c.error("K027", "a function has no effects: it cannot write to a stream", span, help)
    elif port is not None and port.type is not POISON:
        c.error("K056", f"{module.name}.{port.name} is {with_article(port.type)}, not a stream", head.span)
    out.append(draft.WrongStmt(items, span))


def _as_string(value: ir.Expr, c: Context) -> ir.Expr:
    """Return an expression for the string that a stream shows for a value."""
    type_ = value.type
    if type_ is POISON or type_ == STRING:
        return value
    if type_ is INT or type_ is FLOAT or type_ is BOOL or type_ is POINT:
        return ir.Builtin("str", (value,), STRING, value.span)
    help = "write the parts of the value, or its length, to the stream"
    return c.error("K056", f"a stream cannot show {with_article(type_)}", value.span, help, (), value)


# Control flow


def _if(node: tree.If, c: Context, out: Out) -> None:
    """Check `if`. Each `elif` becomes an If node in the `orelse` of the If before it."""
    checked: list[tuple[ir.Expr, stmt.Block, Span]] = []
    for branch in node.branches:
        held = condition(branch.condition, c, "the condition of 'if'")
        checked.append((held, check_block(branch.block, c), branch.span))
    orelse = check_block(node.orelse, c) if node.orelse else ()
    for held, block, span in reversed(checked):
        orelse = (stmt.If(held, block, orelse, span),)
    out.extend(orelse)


def _atomic(node: tree.Atomic, c: Context, out: Out) -> None:
    """Check `atomic:`.

    One `atomic:` makes the whole event a transaction. In the IR a marker, `draft.Atomic`, stands in its place, followed
    by the statements of its block.
    """
    if c.atomic:
        c.error("K045", "'atomic' is nested in 'atomic'", node.span, "remove the inner 'atomic:'")
    elif c.place == "function":
        c.error(
            "K045", "a function cannot be atomic", node.span, "put 'atomic:' around the function's call in an event"
        )
    elif c.place == "init":
        help = "remove 'atomic:': robots cannot read shared variables in init, so no update can be lost"
        c.error("K045", "init cannot be atomic", node.span, help)
    out.append(draft.Atomic(node.span))
    c.atomic += 1
    out.extend(check_block(node.block, c))
    c.atomic -= 1


def _return(node: tree.Return, c: Context, out: Out) -> None:
    if c.place != "function":
        value = check_expr(node.value, c)
        c.error("K028", "'return' is outside of a function", node.span, "'stop' stops a robot for good")
    else:
        value = check_expr(node.value, c, c.result)
        if c.result is None:
            c.result = value.type
        value = converted(value, c.result, "the result", c)
    out.append(stmt.Return(value, node.span))


def _break(node: tree.Break, c: Context, out: Out) -> None:
    if not c.loops:
        c.error("K028", "'break' is outside of a loop", node.span)
    out.append(stmt.Break(node.span))


def _continue(node: tree.Continue, c: Context, out: Out) -> None:
    if not c.loops:
        c.error("K028", "'continue' is outside of a loop", node.span)
    out.append(stmt.Continue(node.span))


def _stop(node: tree.Stop, c: Context, out: Out) -> None:
    if c.place == "function":
        c.error("K027", "a function cannot stop its robot", node.span, "return a result, and write 'stop' in the event")
    out.append(stmt.Stop(node.span))


def _nothing(node: tree.Pass, c: Context, out: Out) -> None:
    pass


def _broken(node: tree.BrokenStmt, c: Context, out: Out) -> None:
    out.append(draft.UnparsedStmt(node.span))


STATEMENTS.update(
    {
        tree.Assign: _assign,
        tree.Declare: _declare,
        tree.If: _if,
        tree.For: check_for,
        tree.CountedFor: check_counted,
        tree.While: check_while,
        tree.Atomic: _atomic,
        tree.Evaluate: _evaluate,
        tree.Return: _return,
        tree.Break: _break,
        tree.Continue: _continue,
        tree.Pass: _nothing,
        tree.Stop: _stop,
        tree.BrokenStmt: _broken,
    }
)
