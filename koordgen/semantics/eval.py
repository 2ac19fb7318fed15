"""What an expression means: pure, over what one robot sees at one moment.

Numbers are Python's: ints without bound inside an event, floats of 64 bits, `/` a true quotient (of two ints as well),
`//` and `%` floored with the divisor's sign. What Python refuses (division by zero, a square root of a negative number,
an int too large for a float) discards the event; NaN and infinity may arise and only must not leave the robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, assert_never

from koordgen.diagnostics import InternalError
from koordgen.ir import expr as ir
from koordgen.ir.types import BOOL, FLOAT, INT, POINT, Scalar
from koordgen.source import Span


class Vector(NamedTuple):
    """A Point: x east, y north, z up, in metres, local ENU frame."""

    x: float
    y: float
    z: float


Value = int | float | bool | Vector


class Discarded(Exception):
    """Why an event is discarded whole, and where."""

    def __init__(self, reason: str, span: Span) -> None:
        super().__init__(f"line {span.line}: {reason}")
        self.reason = reason
        self.span = span


class View(NamedTuple):
    """What one robot sees: `slots` by allread name and pid, `cells` by allwrite name, `ports` by "Module.port"."""

    pid: int
    n_sys: int
    params: Mapping[str, Value]
    locals: Mapping[str, Value]
    temps: Mapping[str, Value]
    slots: Mapping[str, Sequence[Value]]
    cells: Mapping[str, Value]
    ports: Mapping[str, Value]


def evaluate(node: ir.Expr, view: View) -> Value:
    """The value of a checked expression. Raises Discarded."""
    try:
        return _value(node, view)
    except (ArithmeticError, ValueError) as error:  # raised by Python's own arithmetic below `node`
        raise Discarded(str(error), node.span) from None


def holds(node: ir.Expr, view: View) -> bool:
    """The value of a condition. Raises Discarded."""
    value = evaluate(node, view)
    if not isinstance(value, bool):
        raise InternalError(f"a condition yields {value!r}")
    return value


def _value(node: ir.Expr, view: View) -> Value:
    match node:
        case ir.Const(value):
            return value
        case ir.Pid():
            return view.pid
        case ir.NSys():
            return view.n_sys
        case ir.ParamRead(name):
            return view.params[name]
        case ir.LocalRead(name):
            return view.locals[name]
        case ir.TempRead(name):
            return view.temps[name]
        case ir.SharedRead(name):
            return view.cells[name]
        case ir.SlotRead(name, index):
            place = _number(_value(index, view))
            if not 0 <= place < view.n_sys:
                raise Discarded(f"index {place} names no robot (0 to {view.n_sys - 1})", node.span)
            return view.slots[name][int(place)]
        case ir.PortRead(module, port):
            return view.ports[f"{module}.{port}"]
        case ir.Widen(operand):
            return float(_number(_value(operand, view)))
        case ir.Unary("not", operand):
            return not _value(operand, view)
        case ir.Unary(_, operand):
            positive = _value(operand, view)
            if isinstance(positive, Vector):
                return Vector(-positive.x, -positive.y, -positive.z)
            return -positive
        case ir.Binary(op, left, right):
            return arithmetic(op, _value(left, view), _value(right, view))
        case ir.Compare(op, left, right):
            return _compared(op, _value(left, view), _value(right, view))
        case ir.Logic(op, left, right):
            first = _value(left, view)
            return first if bool(first) == (op == "or") else _value(right, view)
        case ir.Conditional(condition, then, orelse):
            return _value(then if _value(condition, view) else orelse, view)
        case ir.Coordinate(operand, axis):
            return float(getattr(_value(operand, view), axis))
        case ir.Builtin(name, args):
            return _called(name, [_value(a, view) for a in args])
        case _:
            assert_never(node)


def arithmetic(op: str, left: Value, right: Value) -> Value:
    """One operator on two values of agreeing types; raises ArithmeticError as Python does."""
    if isinstance(left, Vector) and isinstance(right, Vector):
        sign = 1.0 if op == "+" else -1.0
        return Vector(left.x + sign * right.x, left.y + sign * right.y, left.z + sign * right.z)
    if isinstance(left, Vector):
        by = _number(right)
        if op == "*":
            return Vector(left.x * by, left.y * by, left.z * by)
        return Vector(left.x / by, left.y / by, left.z / by)
    if isinstance(right, Vector):
        return arithmetic(op, right, left)
    match op:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/":
            return left / right
        case "//":
            return left // right
        case "%":
            return left % right
        case _:
            raise InternalError(f"no operator {op}")


def _compared(op: str, left: Value, right: Value) -> bool:
    match op:
        case "==":
            return left == right
        case "!=":
            return left != right
    first, second = _number(left), _number(right)
    match op:
        case "<":
            return first < second
        case "<=":
            return first <= second
        case ">":
            return first > second
        case _:
            return first >= second


def _called(name: str, args: list[Value]) -> Value:
    match name, args:
        case "distance", [Vector() as p, Vector() as q]:
            return math.hypot(p.x - q.x, p.y - q.y, p.z - q.z)
    numbers = [_number(a) for a in args]
    match name, numbers:
        case "Point", [x, y, z]:
            return Vector(x, y, z)
        case "abs", [x]:
            return abs(x)
        case "sqrt", [x]:
            return math.sqrt(x)
        case "min", [x, y]:
            return min(x, y)
        case "max", [x, y]:
            return max(x, y)
        case _:
            raise InternalError(f"no builtin {name} of {len(args)} arguments")


def _number(value: Value) -> int | float:
    if isinstance(value, Vector):
        raise InternalError(f"{value} is no number")
    return value


def may_stay(value: Value) -> bool:
    """Whether a local variable may keep a value: ints of 64 bits (one that is squared every round would
    soon hang the robot)."""
    return not isinstance(value, int) or -(2**63) <= value < 2**63


def may_leave(value: Value) -> bool:
    """Whether a value may go to a port or to another robot: no NaN, no infinity, ints of 64 bits."""
    match value:
        case bool():
            return True
        case int():
            return -(2**63) <= value < 2**63
        case float():
            return math.isfinite(value)
        case Vector():
            return all(map(math.isfinite, value))
        case _:
            assert_never(value)


def default(type_: Scalar) -> Value:
    """The value of a variable or port that was given none."""
    return _DEFAULTS[type_]


_DEFAULTS: dict[Scalar, Value] = {INT: 0, FLOAT: 0.0, BOOL: False, POINT: Vector(0.0, 0.0, 0.0)}
