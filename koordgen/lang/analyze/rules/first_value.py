"""K057: initial values of params, variables and fields must exist and be storable.

Initial values are known at build time. The rule evaluates them with the executable semantics (`lang.semantics`), which
is imported on demand, because most initial values are literals and need no evaluation.
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

_EXISTS = "write a value that exists: an initial value is evaluated before the robots start"
_FITS = "robots store ints of 64 bits, floats up to about 1.8e308, and as much as the declared capacities allow"


class InitialValueFlaw(NamedTuple):
    """Reason why robots cannot store an initial value.

    `span` is the part of the expression that has no value, or None if all parts have values. `reason` is the predicate
    of a sentence whose subject is this part, or the variable if `span` is None.
    """

    span: Span | None
    reason: str
    help: str


def check_initial_value(name: str, value: ir.Expr, type_: Type, a: Analysis) -> None:
    """Report an initial value that does not exist, or that robots cannot store."""
    wrong = flaw_of(value, type_, {name: param.default for name, param in a.params.items()})
    if wrong is not None:
        what = f"the initial value of {name}" if wrong.span is None else a.text(wrong.span)
        a.error("K057", f"{what} {wrong.reason}", wrong.span or value.span, wrong.help)


def flaw_of(value: ir.Expr, type_: Type, params: Mapping[str, ir.Expr]) -> InitialValueFlaw | None:
    """Return why an initial value of this type is wrong.

    Returns None if the initial value is right, or has an error that is already reported. `params` maps the name
    of each param to its value.
    """
    if _is_literal(value):
        return None
    read = {part.name: params[part.name] for part in walk(value) if isinstance(part, ir.ParamRead)}
    if any(isinstance(part, ir.Expr) and part.type is POISON for part in walk((value, *read.values()))):
        return None
    infinite = too_large(value, params)
    if infinite is not None:
        return InitialValueFlaw(infinite.span, "is too large for a float", RANGE)
    return _evaluated(value, type_, read)


def _is_literal(value: ir.Expr) -> bool:
    """Return whether an initial value consists of literals only, which the parser has checked."""
    match value:
        case ir.Const():
            return True
        case ir.Widen(part) | ir.Unary("-", part):
            return _is_literal(part)
        case ir.Make(parts) | ir.Builtin("Point" | "Pose", parts):
            return all(map(_is_literal, parts))
        case _:
            return False


def _evaluated(value: ir.Expr, type_: Type, params: Mapping[str, ir.Expr]) -> InitialValueFlaw | None:
    from koordgen.lang.semantics.eval import Discarded, evaluate, view_of
    from koordgen.lang.semantics.exec import Budget
    from koordgen.lang.semantics.values import Value, flaw

    def call(name: str, args: tuple[Value, ...]) -> Value:
        raise AssertionError(f"an initial value calls {name}")

    view = view_of(1, {}, call, call, Budget().spend)
    try:
        view = view._replace(params={name: evaluate(default, view) for name, default in params.items()})
        wrong = flaw(evaluate(value, view), type_)
    except Discarded as discarded:
        return InitialValueFlaw(discarded.span, f"has no value: {discarded.reason}", _EXISTS)
    return InitialValueFlaw(None, f"would be {wrong}", _FITS) if wrong else None
