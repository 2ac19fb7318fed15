"""Expressions: operators, literals, conditionals, and the table of the checkers of all node classes."""

from __future__ import annotations

from koordgen.lang.check.base import (
    CHECKERS,
    NUMBERS,
    check_expr,
    condition,
    default,
    has_call,
    help_for_bool,
    is_display,
    report_missing_index,
    same_type,
    widened,
    with_article,
)
from koordgen.lang.check.context import Context
from koordgen.lang.check.expressions.call import check_call
from koordgen.lang.check.expressions.collection import (
    check_containment,
    check_index,
    check_list,
    check_map,
    check_quantified,
    check_set,
    check_slice,
    check_tuple,
)
from koordgen.lang.check.expressions.dialect import modern_logic, modern_not
from koordgen.lang.check.expressions.name import check_attribute, check_name, check_primed
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, POISON, STRING, PerRobot, Sequence, Type
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast

__all__ = ["arithmetic", "check_expr", "condition", "default", "widened"]

_LITERALS: dict[type, Type] = {int: INT, float: FLOAT, bool: BOOL, str: STRING}


def _literal(node: ast.Literal, c: Context, wanted: Type | None) -> ir.Expr:
    return ir.Const(node.value, _LITERALS[type(node.value)], node.span)


def _broken(node: ast.Broken, c: Context, wanted: Type | None) -> ir.Expr:
    return c.poison(node.span)


def _unary(node: ast.Unary, c: Context, wanted: Type | None) -> ir.Expr:
    op = node.op
    if op == "!":
        modern_not(node, c)
        op = "not"
    operand = check_expr(node.operand, c)
    type_ = operand.type
    if type_ is POISON:
        return c.poison(node.span, operand)
    if type_ is BOOL if op == "not" else type_ is INT or type_ is FLOAT or type_ is POINT:
        return ir.Unary(op, operand, type_, node.span)
    if isinstance(type_, PerRobot):
        return report_missing_index(operand, c)
    help = help_for_bool(operand, c, "==") if op == "not" else ""
    return c.error("K012", f"'{op}' does not apply to {with_article(type_)}", node.span, help, (), operand)


def _binary(node: ast.Binary, c: Context, wanted: Type | None) -> ir.Expr:
    if node.op == "<<":
        help = "write to the stream in a statement of its own: 'Log.stdout << a << b'"
        return c.error("K056", "'<<' writes to a stream and has no value", node.span, help)
    if node.op == "+" and is_display(node.left):
        if is_display(node.right):
            left = check_expr(node.left, c, wanted)
            return arithmetic("+", left, check_expr(node.right, c, left.type), node.span, c)
        right = check_expr(node.right, c)
        return arithmetic("+", check_expr(node.left, c, right.type), right, node.span, c)
    left = CHECKERS[type(node.left)](node.left, c, wanted)
    right = CHECKERS[type(node.right)](node.right, c, left.type)
    return arithmetic(node.op, left, right, node.span, c)


def arithmetic(op: str, left: ir.Expr, right: ir.Expr, span: Span, c: Context) -> ir.Expr:
    """Return the typed expression `left op right`.

    A division is marked as proved to have a value only if its divisor is a literal other than 0. The second check
    proves other divisions.
    """
    first, second = left.type, right.type
    if first is POISON or second is POISON:
        return c.poison(span, left, right)
    result: Type | None = None
    if (first is INT or first is FLOAT) and (second is INT or second is FLOAT):
        if first is not second:
            left, right = widened(left, FLOAT), widened(right, FLOAT)
        result = FLOAT if op == "/" else left.type
    elif op in ("+", "-") and first is POINT and second is POINT:
        result = POINT
    elif op in ("*", "/") and first is POINT and second in NUMBERS:
        right, result = widened(right, FLOAT), POINT
    elif op == "*" and first in NUMBERS and second is POINT:
        left, result = widened(left, FLOAT), POINT
    elif op == "+" and (first == STRING or (isinstance(first, Sequence) and first.name == "List")) and first == second:
        result = first
    if result is None:
        return _no_operator(op, left, right, span, c)
    return ir.Binary(op, left, right, op not in ("/", "//", "%") or _differs_from_zero(right), result, span)


def _differs_from_zero(number: ir.Expr) -> bool:
    number = number.operand if type(number) is ir.Widen else number
    return type(number) is ir.Const and bool(number.value)


def _no_operator(op: str, left: ir.Expr, right: ir.Expr, span: Span, c: Context) -> ir.Expr:
    for side in (left, right):
        if isinstance(side.type, PerRobot):
            return report_missing_index(side, c)
    help = ""
    if op == "+" and STRING in (left.type, right.type):
        help = _help_for_joined(left, right, c)
    elif op == "%" and left.type == STRING:
        help = "join strings with '+': 'n is ' + str(n)"
    elif BOOL in (left.type, right.type):
        held = left if left.type is BOOL else right
        help = "bools are joined with 'and' and 'or'"
        if left.type != right.type:
            help = f"to make a number of the bool, write '(1 if {c.text(held.span)} else 0)'"
    elif op == "*" and left.type is POINT and right.type is POINT:
        help = "multiply the coordinates of the points: p.x * q.x + p.y * q.y"
    elif op in ("+", "-") and POINT in (left.type, right.type):
        help = "add a Point to a Point: p + Point(x, y, z)"
    elif op == "+" and isinstance(left.type, Sequence) and same_type(left.type.element, right.type):
        verb = {"List": "append", "Queue": "push", "Set": "add"}[left.type.name]
        help = f"'xs.{verb}(x)' adds an element" + ("; xs + [x] is a longer list" if verb == "append" else "")
    message = f"'{op}' does not apply to {with_article(left.type)} and {with_article(right.type)}"
    return c.error("K012", message, span, help, (), left, right)


def _help_for_joined(left: ir.Expr, right: ir.Expr, c: Context) -> str:
    """Return the help for a string joined by `+` with a value that is not a string."""
    value = right if left.type == STRING else left
    if value.type in (*NUMBERS, BOOL, POINT):
        text = c.text(value.span)
        return f"write str({text})" if len(text) <= 40 else "str(...) makes a string of a number or a bool"
    return "join the parts of the value, or its length: str(len(...))"


def _compare(node: ast.Compare, c: Context, wanted: Type | None) -> ir.Expr:
    """Check a comparison or a chain of comparisons: `a < b < c` means `a < b and b < c`.

    The inner operands of a chain are evaluated twice, with the same value. Calls of ports could give two different
    values, so they are not allowed as inner operands.
    """
    if len(node.rest) == 1:
        ((op, right_node),) = node.rest
        if op == "in" or op == "not in":
            return check_containment(op, node.first, right_node, node.span, c)
        left, right = _sides(node.first, right_node, c)
        return _pair(op, left, right, node.span, c)
    return _chain(node, c)


def _sides(first: ast.Expr, second: ast.Expr, c: Context) -> tuple[ir.Expr, ir.Expr]:
    """Check both sides of a comparison. A display, such as `[]`, gets its type from the other side."""
    if is_display(first) and not is_display(second):
        right = check_expr(second, c)
        return check_expr(first, c, right.type), right
    left = CHECKERS[type(first)](first, c, None)
    return left, CHECKERS[type(second)](second, c, left.type)


def _chain(node: ast.Compare, c: Context) -> ir.Expr:
    result: ir.Expr | None = None
    poisoned = False
    left: ir.Expr | None = None
    before = node.first
    for op, right_node in node.rest:
        if op in ("in", "not in"):
            help = "join the two comparisons with 'and'"
            return c.error("K012", f"'{op}' is not allowed in a chain of comparisons", node.span, help)
        if left is None:
            left, right = _sides(before, right_node, c)
        else:
            if has_call(left, (ir.PortCall,)):
                help = "save the port's answer in a variable first"
                return c.error("K027", "a call of a port is not allowed within a chain of comparisons", left.span, help)
            right = check_expr(right_node, c, left.type)
        pair = _pair(op, left, right, node.span, c)
        poisoned = poisoned or pair.type is POISON
        result = pair if result is None else ir.Logic("and", result, pair, BOOL, node.span)
        left = right
    assert result is not None
    return c.poison(node.span, result) if poisoned else result


def _pair(op: str, left: ir.Expr, right: ir.Expr, span: Span, c: Context) -> ir.Expr:
    first, second = left.type, right.type
    if first is POISON or second is POISON:
        return c.poison(span, left, right)
    if (first is INT or first is FLOAT) and (second is INT or second is FLOAT):
        if first is not second:
            left, right = widened(left, FLOAT), widened(right, FLOAT)
        return ir.Compare(op, left, right, BOOL, span)
    for side in (left, right):
        if isinstance(side.type, PerRobot):
            return report_missing_index(side, c)
    if not same_type(first, second):
        message = f"{with_article(first)} and {with_article(second)} cannot be compared"
        return c.error("K012", message, span, _help_for_compared(left, right, c), (), left, right)
    if op not in ("==", "!=") and first != STRING:
        help = "compare their coordinates, or distances" if first is POINT else "only '==' and '!=' compare these"
        return c.error(
            "K012",
            f"'{op}' does not apply to {with_article(first)} and {with_article(second)}",
            span,
            help,
            (),
            left,
            right,
        )
    return ir.Compare(op, left, right, BOOL, span)


def _help_for_compared(left: ir.Expr, right: ir.Expr, c: Context) -> str:
    """Return the help for a comparison of two values whose types do not match."""
    for value, other in ((left, right), (right, left)):
        if other.type == STRING and value.type in NUMBERS:
            return f"write str({c.text(value.span)})"
        if other.type is BOOL and value.type in NUMBERS and not isinstance(value, ir.Const):
            return help_for_bool(value, c).replace("compare the number", "make the number a bool")
    return ""


def _logic(node: ast.Logic, c: Context, wanted: Type | None) -> ir.Expr:
    op = modern_logic(node, c)
    left = check_expr(node.left, c)
    right = check_expr(node.right, c)
    value = ir.Logic(op, left, right, BOOL, node.span)
    if left.type is POISON or right.type is POISON:
        return c.poison(node.span, value)
    for side in (left, right):
        if side.type is not BOOL:
            message = f"'{op}' joins bools, not {with_article(side.type)}"
            return c.error("K013", message, side.span, help_for_bool(side, c), (), value)
    return value


def _conditional(node: ast.Conditional, c: Context, wanted: Type | None) -> ir.Expr:
    held = condition(node.condition, c, "the condition of 'if'")
    turned = wanted is None and is_display(node.then) and not is_display(node.orelse)
    checked: list[ir.Expr] = []
    for side in (node.orelse, node.then) if turned else (node.then, node.orelse):
        checked.append(check_expr(side, c, wanted))
        wanted = wanted or checked[0].type
    then, orelse = reversed(checked) if turned else checked
    then, orelse = widened(then, orelse.type), widened(orelse, then.type)
    value = ir.Conditional(held, then, orelse, then.type, node.span)
    if held.type is POISON or then.type is POISON or orelse.type is POISON:
        return c.poison(node.span, value)
    if isinstance(then.type, PerRobot):
        return report_missing_index(then, c)
    if not same_type(then.type, orelse.type):
        message = (
            f"one branch is {with_article(then.type)}, the other {with_article(orelse.type)}: both must be of one type"
        )
        return c.error("K012", message, node.span, "", (), value)
    return value


CHECKERS.update(
    {
        ast.Name: check_name,
        ast.Literal: _literal,
        ast.Attribute: check_attribute,
        ast.Primed: check_primed,
        ast.Index: check_index,
        ast.Slice: check_slice,
        ast.Call: check_call,
        ast.Tuple: check_tuple,
        ast.ListDisplay: check_list,
        ast.SetDisplay: check_set,
        ast.MapDisplay: check_map,
        ast.Unary: _unary,
        ast.Binary: _binary,
        ast.Compare: _compare,
        ast.Logic: _logic,
        ast.Conditional: _conditional,
        ast.Quantified: check_quantified,
        ast.Broken: _broken,
    }
)
