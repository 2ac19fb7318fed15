"""Screening: array code that checks a sufficient condition of a formula for many observations at once.

An under-approximation: comparisons of floats keep a margin, so rounding in the arrays never makes a screening true
where the exact formula is false. Where a screening is false, the exact formula is evaluated.

A formula has no screening if a part may have no value, or needs more than numbers, Points and bools. A comparison with
NaN is false in a screening. A formula also has no screening if another operand could make the screening true in spite
of such a NaN.
"""

from __future__ import annotations

from koordgen.build.emit import expr as exact
from koordgen.build.emit.floats import may_meet_nan
from koordgen.build.emit.layout import brackets, chain, joined
from koordgen.build.emit.names import Names
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, Type

_NUMBERS = (INT, FLOAT)
_OPPOSITE = {">": "<=", ">=": "<", "<": ">=", "<=": ">", "==": "!=", "!=": "=="}


class _Unsupported(Exception):
    """Raised if a formula has no screening, so that each observation needs the exact formula."""


def text(formula: ir.Expr, names: Names) -> str:
    """Return the screening of an invariant; "" if the invariant has none. The screening reads a batch of arrays `b`."""
    return _attempted(formula, {}, names)


def text_of_each(formula: ir.Expr, names: Names) -> str:
    """Return the screening of an assumption for all robots at once; "" if the assumption has none.

    The robots are along the first axis of the arrays.
    """
    return _attempted(formula, {"": 0}, names)


def _attempted(formula: ir.Expr, axes: dict[str, int], names: Names) -> str:
    apart = names.attempt()
    try:
        found = _screened(formula, True, axes, apart)
    except _Unsupported:
        return ""
    names.used |= apart.used
    return found


def _screened(node: ir.Expr, wanted: bool, axes: dict[str, int], names: Names) -> str:
    """Return a condition that is true only if `node` is `wanted`. `axes`: the array axis of each quantified robot."""
    match node:
        case ir.Unary("not", operand):
            return _screened(operand, not wanted, axes, names)
        case ir.Logic(op, left, right):
            both = (op == "and") == wanted
            if not both and may_meet_nan(left):
                raise _Unsupported
            parts = [_screened(left, wanted, axes, names), _screened(right, wanted, axes, names)]
            return brackets(f"b.{'both' if both else 'either'}(", parts, ")")
        case ir.Quantified(kind, name, ir.Ids(), body):
            if (kind == "exists") == wanted and may_meet_nan(body):
                raise _Unsupported
            inner = _screened(body, wanted, {**axes, name: len(axes)}, names)
            return brackets(f"b.{'every' if (kind == 'forall') == wanted else 'some'}(", [str(len(axes)), inner], ")")
        case ir.Compare(op, left, right):
            return _compared(op if wanted else _OPPOSITE[op], left, right, axes, names)
        case ir.Contains(item, ir.Builtin("Rect" | "Ball" as region, (one, other))) if item.type == POINT:
            parts = [_value(part, axes, names) for part in (item, one, other)]
            return brackets(f"b.{'in' if wanted else 'out_of'}_{region.lower()}(", parts, ")")
        case _ if node.type == BOOL:
            shown = _value(node, axes, names)
            return shown if wanted else brackets("b.no(", [shown], ")")
        case _:
            raise _Unsupported


def _compared(op: str, left: ir.Expr, right: ir.Expr, axes: dict[str, int], names: Names) -> str:
    first, second = _value(left, axes, names), _value(right, axes, names)
    match left, right:
        case ((ir.TempRead() | ir.Pid()), (ir.TempRead() | ir.Pid())):  # comparison of the indices of two robots
            return chain(first, f"{op} {second}")
        case _ if left.type == BOOL and op in ("==", "!="):
            return chain(brackets("(", [first], ")"), joined(f"{op} ", brackets("(", [second], ")")))
        case _ if left.type not in _NUMBERS or op == "==":
            raise _Unsupported  # no margin would make this comparison sound
        case _ if op == "!=":
            return brackets("b.apart(", [first, second], ")")
        case _:
            return brackets("b.over(", [first, second] if op in (">", ">=") else [second, first], ")")


def _value(node: ir.Expr, axes: dict[str, int], names: Names) -> str:
    """Return the array expression of a number, a Point or a bool whose evaluation cannot fail."""
    match node:
        case ir.Const(value) if node.type in (*_NUMBERS, BOOL):
            return exact.literal(value) if not isinstance(value, (int, float)) or value >= 0 else f"({value!r})"
        case ir.NSys():
            return "b.n_sys"
        case ir.ParamRead(name) if _plain(node.type):
            param = names.use(names.params[name])
            return f"b.point({param})" if node.type == POINT else param
        case ir.Pid():
            return "b.robot(0)"
        case ir.PortRead(module, port, primed) if _plain(node.type):
            prime = "'" if primed else ""
            return f"b.each({exact.literal(f'{module}.{port}{prime}')}, 0)"
        case ir.TempRead(name) if name in axes:
            return f"b.robot({axes[name]})"
        case ir.SharedRead(name) if _plain(node.type):
            return f"b.one({exact.literal(name)})"
        case ir.LocalOf(name, robot) | ir.SlotRead(name, robot) if _plain(node.type):
            return f"b.each({exact.literal(name)}, {_axis(robot, axes)})"
        case ir.PortOf(module, port, robot) if _plain(node.type):
            return f"b.each({exact.literal(f'{module}.{port}')}, {_axis(robot, axes)})"
        case ir.Widen(operand):
            return _value(operand, axes, names)
        case ir.Unary("-", operand):
            return brackets("-(", [_value(operand, axes, names)], ")")
        case _:
            return _made(node, axes, names)


def _made(node: ir.Expr, axes: dict[str, int], names: Names) -> str:
    match node:
        case ir.Binary("+" | "-" | "*" as op, left, right) if _plain(left.type) and _plain(right.type):
            last = joined(f"{op} ", _value(right, axes, names))
            return brackets("(", [chain(_value(left, axes, names), last)], ")")
        case ir.Binary("/", left, (ir.Const(by) | ir.Widen(ir.Const(by)))) if by and _plain(left.type):
            return brackets("(", [chain(_value(left, axes, names), f"/ {by!r}")], ")")
        case ir.Field(operand, name) if operand.type == POINT:
            return joined(brackets("(", [_value(operand, axes, names)], ")"), f"[{'xyz'.index(name)}]")
        case ir.Builtin("distance" | "Point" as name, args):
            return brackets(f"b.{name.lower()}(", [_value(arg, axes, names) for arg in args], ")")
        case _:
            raise _Unsupported


def _plain(type_: Type) -> bool:
    return type_ in (INT, FLOAT, BOOL, POINT)


def _axis(robot: ir.Expr, axes: dict[str, int]) -> int:
    if isinstance(robot, ir.TempRead) and robot.name in axes:
        return axes[robot.name]
    raise _Unsupported
