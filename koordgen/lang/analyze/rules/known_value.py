"""K012, K057: powers and functions of constant numbers that have no value."""

from __future__ import annotations

from koordgen.lang.analyze.facts.number import RANGE, compute, number_of
from koordgen.lang.analyze.facts.terms import term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import INT
from koordgen.lang.source import Span

_TAKES = {"sqrt": "numbers of at least 0", "log": "numbers above 0", "asin": "numbers from -1 to 1"}
_TAKES["acos"] = _TAKES["asin"]


def check_power(value: ir.Binary, a: Analysis) -> None:
    """Report a power of ints with a negative exponent, and a power of constant floats that has no value."""
    if value.type is INT:
        _check_exponent(value.right, value.span, a)
        return
    base = number_of(value.left)
    _check_value(value, "0 has no negative power" if base == 0 else "a negative number only has integral powers", a)


def _check_exponent(exponent: ir.Expr, span: Span, a: Analysis) -> None:
    value = term(exponent, a.flow) if a.flow is not None else None
    if value is not None and not value.terms and value.constant < 0:
        help = "the result is a float if one side of the power is a float: 2.0 ** -1"
        a.error("K012", f"an int to the power of {value.constant} is not an int", span, help)


def check_function(value: ir.Builtin, a: Analysis) -> None:
    """Report a call of a builtin function whose constant argument is outside of the function's domain."""
    _check_value(value, f"{value.name} takes {_TAKES.get(value.name, 'smaller numbers')}", a)


def _check_value(value: ir.Builtin | ir.Binary, help: str, a: Analysis) -> None:
    if a.path is None or a.poisoned:
        return
    span = value.span
    try:
        compute(value)
    except OverflowError:
        a.error("K057", f"{a.text(span)} is too large for a float", span, RANGE)
    except ValueError:
        a.error("K057", f"{a.text(span)} has no value", span, help)
