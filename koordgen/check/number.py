"""Numbers that are written out, and what is made of them."""

from __future__ import annotations

import math
from collections.abc import Callable

from koordgen.ir import expr as ir
from koordgen.ir.types import FLOAT, Type

FUNCTIONS: dict[str, Callable[[float], float]] = {
    name: getattr(math, name) for name in ("sqrt", "log", "asin", "acos", "exp", "sin", "cos", "tan", "atan")
}


def number_of(node: ir.Expr) -> float | None:
    """The value of an expression of numbers that are written out, if it has one."""
    try:
        return compute(node)
    except (ValueError, ArithmeticError):
        return None


def compute(node: ir.Expr) -> float | None:
    """The same; ValueError and OverflowError where a function or a power has none, though its parts have."""
    match node:
        case ir.Const(int() | float() as value):
            return value
        case ir.Widen(operand):
            return number_of(operand)
        case ir.Unary("-", operand):
            positive = number_of(operand)
            return None if positive is None else -positive
        case ir.Builtin(name, (operand,)) if name in FUNCTIONS:
            argument = number_of(operand)
            return None if argument is None else FUNCTIONS[name](argument)
        case ir.Binary(op, left, right):
            first, second = number_of(left), number_of(right)
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
