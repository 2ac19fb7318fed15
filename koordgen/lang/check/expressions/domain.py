"""Functions and powers of numbers that are written out: one that has no value is told where it stands."""

from __future__ import annotations

from koordgen.lang.analyze.number import FUNCTIONS, RANGE, compute, number_of
from koordgen.lang.check.context import Context
from koordgen.lang.check.expressions.call import check_call
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.types import Type
from koordgen.lang.syntax import expr as ast

_TAKES = {"sqrt": "numbers from 0 up", "log": "numbers above 0", "asin": "numbers from -1 to 1"}
_TAKES["acos"] = _TAKES["asin"]


def check_called(node: ast.Call, c: Context, wanted: Type | None = None) -> ir.Expr:
    """A call, of which an error is told if it can have no value."""
    value = check_call(node, c, wanted)
    if type(value) is ir.Builtin and value.name in FUNCTIONS:
        name = value.name
        _judge(value, f"{name} takes {_TAKES.get(name, 'smaller numbers')}", c)
    return value


def judge_power(value: ir.Binary, c: Context) -> None:
    """Reports a power of floats that is no number."""
    base = number_of(value.left)
    low = "0 has no power below 0" if base == 0 else "a number below 0 has whole powers only"
    _judge(value, low, c)


def _judge(value: ir.Builtin | ir.Binary, help: str, c: Context) -> None:
    if c.path is None or c.poisoned:
        return
    span = value.span
    try:
        compute(value)
    except OverflowError:
        c.error("K057", f"{c.text(span)} is too large for a float", span, RANGE)
    except ValueError:
        c.error("K057", f"{c.text(span)} has no value", span, help)
