"""Semantics of arithmetic and comparison operators on numbers, Points, strings and lists."""

from __future__ import annotations

import math
from typing import TypeVar

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.semantics.exact import is_exact, power, within_exact
from koordgen.lang.semantics.values import Value, as_, has_nan, same
from koordgen.runtime.values.points import NotANumber, Point

T = TypeVar("T")

MAX_EXPONENT = 1024
MAX_BITS = 4096  # limit on the size of an int, in bits
SMALL_BITS = 64  # MAX_BITS does not limit a sum or difference if one operand has at most this many bits


def as_real(value: Value) -> int | float:
    """Return a value unchanged. Raises InternalError if it is not an int, a float or an exact number."""
    if not isinstance(value, (int, float)) and not is_exact(value):
        raise InternalError(f"{value!r} is not a number")
    return value  # type: ignore[return-value]


def arithmetic(op: str, left: Value, right: Value) -> Value:
    """Return the result of an arithmetic operator for two values of matching types.

    Raises ArithmeticError or ValueError if the operation has no result.
    """
    match left, right:
        case Point(), Point():
            if op == "+":
                return _point(left.x + right.x, left.y + right.y, left.z + right.z)
            return _point(left.x - right.x, left.y - right.y, left.z - right.z)
        case Point(), _:
            by = as_real(right)
            if op == "*":
                return _point(left.x * by, left.y * by, left.z * by)
            return _point(left.x / by, left.y / by, left.z / by)
        case _, Point():
            return arithmetic(op, right, left)
        case (str(), str()) | (tuple(), tuple()):
            return left + right  # type: ignore[operator]
        case _:
            return sized(op, as_real(left), as_real(right))


def _point(x: float, y: float, z: float) -> Point:
    return Point(within_exact(x), within_exact(y), within_exact(z))


def sized(op: str, left: int | float, right: int | float) -> int | float:
    """Return the result of an operator for two numbers; the size of an int is limited.

    Raises ValueError if the result is an int of more than MAX_BITS bits. A sum or difference is not limited if one
    operand has at most SMALL_BITS bits.
    """
    ints = isinstance(left, int) and isinstance(right, int)
    if ints and op == "*" and left.bit_length() + right.bit_length() > MAX_BITS + 1:  # type: ignore[union-attr]
        raise ValueError(_TOO_LONG)
    found = _of_numbers(op, left, right)
    if not ints or (op in "+-" and min(left.bit_length(), right.bit_length()) <= SMALL_BITS):  # type: ignore[union-attr]
        return within_exact(found)
    return within_bits(found)


def within_bits(number: T) -> T:
    """Return a number unchanged. Raises ValueError for an int of more than MAX_BITS bits."""
    if isinstance(number, int) and number.bit_length() > MAX_BITS:
        raise ValueError(_TOO_LONG)
    return number


def _of_numbers(op: str, left: int | float, right: int | float) -> int | float:
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
        case "**":
            return _power(left, right)
        case _:
            raise InternalError(f"no operator {op}")


def _power(base: int | float, exponent: int | float) -> int | float:
    if isinstance(base, float) or isinstance(exponent, float):
        return math.pow(base, exponent)
    if is_exact(base, exponent):
        return power(base, exponent)  # type: ignore[return-value]
    if exponent < 0:
        raise ValueError("an int to the power of a negative one")
    if exponent > MAX_EXPONENT and abs(base) > 1:
        raise ValueError(f"an exponent above {MAX_EXPONENT}")
    if abs(base) > 1 and (abs(base).bit_length() - 1) * exponent >= MAX_BITS:
        raise ValueError(_TOO_LONG)
    return as_(int, base**exponent)


_TOO_LONG = f"an int of more than {MAX_BITS} bits"


def compared(op: str, left: Value, right: Value) -> bool:
    """Compare two values of one type. Raises NotANumber if one of the values contains NaN."""
    if has_nan(left) or has_nan(right):
        raise NotANumber
    match op:
        case "==":
            return same(left, right)
        case "!=":
            return not same(left, right)
        case _ if isinstance(left, str):
            return _ordered(op, left, as_(str, right))
        case _:
            return _ordered(op, as_real(left), as_real(right))


def _ordered(op: str, first: int | float | str, second: int | float | str) -> bool:
    match op:
        case "<":
            return first < second  # type: ignore[operator]
        case "<=":
            return first <= second  # type: ignore[operator]
        case ">":
            return first > second  # type: ignore[operator]
        case ">=":
            return first >= second  # type: ignore[operator]
        case _:
            raise InternalError(f"no comparison {op}")
