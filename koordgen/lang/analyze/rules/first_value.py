"""K057: first values of params, variables and fields are known in advance; one that robots may not keep is an error.

The semantics evaluates them. It is imported where something is to be evaluated: most first values are literals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from koordgen.lang.analyze.facts.number import RANGE, too_large
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import POISON, Type
from koordgen.lang.source import Span

_EXISTS = "write a value that exists: a first value is evaluated before the robots start"
_FITS = "robots keep ints of 64 bits, floats up to about 1.8e308, and what the declared capacities hold"


class Flaw(NamedTuple):
    """Why a first value is none that robots may keep. `span` is the expression without a value; None where all have
    one. `reason` follows on its text then, and else on the name of the variable."""

    span: Span | None
    reason: str
    help: str


def judge_first_value(name: str, value: ir.Expr, type_: Type, a: Analysis) -> None:
    """Report a first value that does not exist, or that robots may not keep."""
    wrong = flaw_of(value, type_, {name: param.default for name, param in a.params.items()})
    if wrong is not None:
        what = f"the first value of {name}" if wrong.span is None else a.text(wrong.span)
        a.error("K057", f"{what} {wrong.reason}", wrong.span or value.span, wrong.help)


def flaw_of(value: ir.Expr, type_: Type, params: Mapping[str, ir.Expr]) -> Flaw | None:
    """Return what is wrong with the first value of something of that type, if something is; `params` are the values of
    params. What contains an error that was reported is not judged."""
    if _plain(value):
        return None
    read = {part.name: params[part.name] for part in walk(value) if isinstance(part, ir.ParamRead)}
    if any(isinstance(part, ir.Expr) and part.type is POISON for part in walk((value, *read.values()))):
        return None
    infinite = too_large(value, params)
    if infinite is not None:
        return Flaw(infinite.span, "is too large for a float", RANGE)
    return _evaluated(value, type_, read)


def _plain(value: ir.Expr) -> bool:
    """Return whether a first value is made of literals alone: these are judged where they are read."""
    match value:
        case ir.Const():
            return True
        case ir.Widen(part) | ir.Unary("-", part):
            return _plain(part)
        case ir.Make(parts) | ir.Builtin("Point" | "Pose", parts):
            return all(map(_plain, parts))
        case _:
            return False


def _evaluated(value: ir.Expr, type_: Type, params: Mapping[str, ir.Expr]) -> Flaw | None:
    from koordgen.lang.semantics.eval import Discarded, evaluate, view_of
    from koordgen.lang.semantics.exec import Budget
    from koordgen.lang.semantics.values import Value, flaw

    def call(name: str, args: tuple[Value, ...]) -> Value:
        raise AssertionError(f"{name} is called in a first value")

    view = view_of(1, {}, call, call, Budget().spend)
    try:
        view = view._replace(params={name: evaluate(default, view) for name, default in params.items()})
        wrong = flaw(evaluate(value, view), type_)
    except Discarded as discarded:
        return Flaw(discarded.span, f"has no value: {discarded.reason}", _EXISTS)
    return Flaw(None, f"would be {wrong}", _FITS) if wrong else None
