"""K032, K033: divisors must differ from zero."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.terms import nonzero, term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.evidence import (
    counterexample,
    example_text,
    help_at_run_time,
    is_refuted,
    is_right_by_default,
    robots_of,
)
from koordgen.lang.ir import expr as ir
from koordgen.lang.source import Span


def divisor_proved(divisor: ir.Expr, span: Span, a: Analysis) -> bool:
    """Return whether a divisor is proved to differ from zero. Reports a divisor that is, or may be, zero."""
    if type(divisor) is ir.Widen and type(divisor.operand) is ir.Const:
        divisor = divisor.operand
    if type(divisor) is ir.Const and divisor.value:
        return True
    if a.flow is None or a.poisoned:
        return False
    bad = linear.negate(nonzero(divisor, a.flow))
    if is_refuted(bad, a):
        return True
    if is_right_by_default(bad, a):
        return False
    text = a.text(divisor.span)
    value = term(divisor, a.flow)
    if value is not None:
        example, certain = counterexample(bad, bad, (value,), a)
        if example is not None and certain:
            if value.terms:
                robot, _ = robots_of(bad, value, example, a)
                message = f"{robot} divides by {text}, which is 0 ({example_text(example, value)})"
                help = f"leave such robots out with 'if {text} != 0:' around the division, or divide by another number"
            else:
                message = "this divides by 0" if text == "0" else f"this divides by {text}, which is 0"
                help = "a division by 0 has no value: divide by another number"
            a.site_error("K032", message, span, help)
            return False
    a.warn(
        "K033",
        f"{text} may be zero",
        divisor.span,
        f"{help_at_run_time(a)}; 'if {text} != 0:' around the statement proves that {text} is not 0",
    )
    return False
