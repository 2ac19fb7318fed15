"""Constant folding: computes the values of numeric expressions that consist of literals and params."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import FLOAT, Type

RANGE = "a float is at most about 1.8e308"
FUNCTIONS: dict[str, Callable[[float], float]] = {
    name: getattr(math, name) for name in ("sqrt", "log", "asin", "acos", "exp", "sin", "cos", "tan", "atan")
}


Params = Mapping[str, ir.Expr]  # initial values of params
_NO_PARAMS: Params = {}


def number_of(node: ir.Expr, params: Params = _NO_PARAMS) -> float | None:
    """Return the value of a numeric expression; None if it is not constant or has no value."""
    try:
        return compute(node, params)
    except (ValueError, ArithmeticError):
        return None


def too_large(value: ir.Expr, params: Params) -> ir.Expr | None:
    """Return the innermost infinite part of an initial value, or None. Variables cannot store infinity."""
    for part in reversed(list(walk(value))):
        number = number_of(part, params) if isinstance(part, (ir.Binary, ir.Unary)) and part.type is FLOAT else None
        if number is not None and math.isinf(number):
            return part  # type: ignore[return-value]
    return None


def compute(node: ir.Expr, params: Params = _NO_PARAMS) -> float | None:
    """Return the value of a numeric expression; None if it is not constant.

    Raises ValueError or OverflowError if the outermost operation has no value.
    """
    match node:
        case ir.Const(int() | float() as value):
            return value
        case ir.ParamRead(name) if name in params:
            return number_of(params[name])
        case ir.Widen(operand):
            return number_of(operand, params)
        case ir.Unary("-", operand):
            positive = number_of(operand, params)
            return None if positive is None else -positive
        case ir.Builtin(name, (operand,)) if name in FUNCTIONS:
            argument = number_of(operand, params)
            return None if argument is None else FUNCTIONS[name](argument)
        case ir.Binary(op, left, right):
            first, second = number_of(left, params), number_of(right, params)
            return None if first is None or second is None else _combined(op, first, second, node.type)
        case _:
            return None


def _combined(op: str, first: float, second: float, type_: Type) -> float | None:
    match op:
        case "+":
            return first + second
        case "-":
            return first - second
        case "*":
            return first * second
        case "/":
            return first / second
        case "**" if type_ is FLOAT:
            return math.pow(first, second)
        case _:
            return None
