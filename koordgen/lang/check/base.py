"""Shared parts of expression checks: dispatch, conversion to an expected type, default values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeGuard

from koordgen.lang.check.context import Context
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.decl import Record
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import (
    BOOL,
    FLOAT,
    GRID,
    INT,
    POINT,
    POISON,
    POSE,
    STRING,
    MapOf,
    PerRobot,
    RecordType,
    Sequence,
    TupleOf,
    Type,
)
from koordgen.lang.source import Span
from koordgen.lang.syntax import expr as ast

NUMBERS = (INT, FLOAT)
# Checker function of each class of expression in the syntax tree; expr.py fills this table. A look-up in a table is
# fast, which matters because dispatch takes most of the time of a check.
CHECKERS: dict[type, Callable[[Any, Context, Type | None], ir.Expr]] = {}
_DISPLAYS = frozenset((ast.ListDisplay, ast.SetDisplay, ast.MapDisplay, ast.Tuple))


def check_expr(node: ast.Expr, c: Context, wanted: Type | None = None) -> ir.Expr:
    """Return the typed form of an expression. Its type is POISON if it is wrong; the error is then already reported.

    `wanted` is the type that the context expects, if this type is known. An empty display, such as `[]`, gets the type
    `wanted`, and ints in a display are converted to floats. The result may be of another type than `wanted`.
    """
    return CHECKERS[type(node)](node, c, wanted)


def condition(node: ast.Expr, c: Context, what: str) -> ir.Expr:
    """Check an expression that must be a bool; `what` names the expression in the message of an error."""
    checked = CHECKERS[type(node)](node, c, None)
    if checked.type is BOOL or checked.type is POISON:
        return checked
    return c.error(
        "K013",
        f"{what} must be a bool, not {with_article(checked.type)}",
        node.span,
        help_for_bool(checked, c),
        (),
        checked,
    )


def help_for_bool(value: ir.Expr, c: Context, op: str = "!=") -> str:
    """Return the help for a value of another type where a bool is expected.

    The help suggests a comparison with `op`: `!=` for the value itself, `==` for its negation.
    """
    type_, text = value.type, c.text(value.span)
    if type_ in NUMBERS:
        return f"compare the number: '{text} {op} 0'"
    if isinstance(type_, (Sequence, MapOf)):
        return f"compare the length: 'len({text}) {'>' if op == '!=' else '=='} 0'"
    if type_ == STRING:
        return f"compare the string: '{text} {op} \"\"'"
    return "compare the value with '=='"


def is_poisoned(parts: Iterable[ir.Expr]) -> bool:
    """Return whether one of several expressions has an error that is already reported."""
    return any(part.type is POISON for part in parts)


def same_type(first: Type, second: Type) -> bool:
    return first is second or first == second


def widened(value: ir.Expr, type_: Type) -> ir.Expr:
    """Convert an int to a float if `type_` is float; return any other value unchanged."""
    return ir.Widen(value, FLOAT, value.span) if type_ is FLOAT and value.type is INT else value


def converted(value: ir.Expr, type_: Type, what: str, c: Context) -> ir.Expr:
    """Return the value converted to a type. If the types do not match, report this and return poison."""
    found = value.type
    if found is type_ or found is POISON or type_ is POISON:
        return value
    if type_ is FLOAT and found is INT:
        return ir.Widen(value, FLOAT, value.span)
    if found == type_:
        return value
    return report_mismatch(value, type_, what, c)


def converted_argument(value: ir.Expr, type_: Type, what: str, c: Context) -> ir.Expr:
    """Return an argument converted to its parameter's type.

    An allread variable without an index, which has a value for each robot, is accepted where a List is expected.
    """
    found = value.type
    listed = isinstance(found, PerRobot) and isinstance(type_, Sequence) and type_.name == "List"
    if listed and same_type(found.element, type_.element):  # type: ignore[union-attr]
        return value
    return converted(value, type_, what, c)


def report_mismatch(value: ir.Expr, type_: Type, what: str, c: Context) -> ir.Expr:
    """Report that a value is not of the expected type."""
    found, help = value.type, ""
    if isinstance(found, PerRobot) and not isinstance(type_, PerRobot):
        return report_missing_index(value, c)
    if type_ is INT and found is FLOAT:
        divides = isinstance(value, ir.Binary) and value.op == "/"
        help = (
            "'/' gives a float; '//' of two ints gives an int"
            if divides
            else "a float is never converted to an int automatically"
        )
        help += "" if divides else ": use floor, ceil or round"
    elif same_type(type_, STRING):
        help = "str(...) makes a string of a number or a bool"
    elif type_ is POINT and isinstance(found, TupleOf):
        help = "write Point(x, y, z)"
    elif type_ is BOOL and found in NUMBERS:
        help = help_for_bool(value, c)
    elif type_ in NUMBERS and found is BOOL:
        help = f"write '1 if {c.text(value.span)} else 0'"
    return c.error("K012", f"{what} is {with_article(type_)}, not {with_article(found)}", value.span, help, (), value)


def report_missing_index(value: ir.Expr, c: Context) -> ir.Expr:
    """Report that an allread variable stands without an index where a single value is expected."""
    text = c.text(value.span)
    return c.error("K017", f"{text} has a value for each robot and needs an index", value.span, _index_help(text, c))


def _index_help(text: str, c: Context) -> str:
    if c.place in ("function", "contract"):
        return f"{text}[i] is the value of robot i"
    return f"{text}[i] is the value of robot i" if c.place == "property" else f"{text}[pid] is the value of this robot"


def with_article(type_: Type) -> str:
    """Return a type's name with its article: "an int"."""
    text = str(type_)
    return f"an {text}" if text[0] in "aeiouAEIO" else f"a {text}"


def default(type_: Type, span: Span, c: Context) -> ir.Expr:
    """Return the initial value of a variable whose declaration gives no initial value."""
    match type_:
        case RecordType(name, fields):
            record = c.entities.get(name)
            items = record.defaults if isinstance(record, Record) else [default(t, span, c) for _, t in fields]
            return ir.Make(tuple(items), type_, span)
        case TupleOf(items):
            return ir.Make(tuple([default(item, span, c) for item in items]), type_, span)
        case PerRobot():
            return c.poison(span)
    if type_ is POISON:
        return c.poison(span)
    if type_ == STRING:
        return ir.Const("", type_, span)
    if type_ is INT or type_ is FLOAT or type_ is BOOL:
        return ir.Const(0 if type_ is INT else 0.0 if type_ is FLOAT else False, type_, span)
    nought = ir.Const(0, INT, span)
    zero = ir.Const(0.0, FLOAT, span)
    if type_ is POINT:
        return ir.Builtin("Point", (zero, zero, zero), POINT, span)
    if type_ is POSE:
        return ir.Builtin("Pose", (default(POINT, span, c), zero), POSE, span)
    if type_ is GRID:
        return ir.Builtin("Grid", (nought, nought, ir.Const(1.0, FLOAT, span)), GRID, span)
    return ir.Make((), type_, span)


def is_display(node: ast.Expr) -> TypeGuard[ast.ListDisplay | ast.SetDisplay | ast.MapDisplay | ast.Tuple]:
    """Return whether an expression is a display (`[a]`, `{a}`, `{a: b}`, `(a, b)`).

    The type of a display depends on the type that its context expects.
    """
    return type(node) in _DISPLAYS


def has_call(node: ir.Expr, kinds: tuple[type, ...] = (ir.Call, ir.ExternCall, ir.PortCall)) -> bool:
    """Return whether an expression contains a call, of one of the node classes in `kinds`."""
    return any(isinstance(part, kinds) for part in walk(node))
