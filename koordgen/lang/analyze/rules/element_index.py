"""K030, K034, K036: indices of lists, queues and strings must be in range.

Unlike in Python, a negative index does not count from the end: it is out of range.
"""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.linear import Formula, Linear
from koordgen.lang.analyze.facts.terms import has_length, length, term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.evidence import (
    ZERO,
    counterexample,
    example_text,
    help_at_run_time,
    is_impossible,
    is_refuted,
    is_right_by_default,
    is_wrong_in_a_run,
    missing_condition,
    robots_of,
    unproved_side,
)
from koordgen.lang.ir import expr as ir
from koordgen.lang.source import Span


def element_proved(operand: ir.Expr, index: ir.Expr, span: Span, a: Analysis) -> bool:
    """Return whether 0 <= index < len(operand) is proved.

    Reports an index that is, or may be, out of range.
    """
    if a.flow is None or a.poisoned:
        return False
    value, size = term(index, a.flow), length(operand, a.flow)
    if value is not None and not value.terms and value.constant < 0:
        text = a.text(operand.span)
        help = f"{text}[len({text}) - {-value.constant}]" + (" is the last" if value.constant == -1 else "")
        a.error("K036", f"{a.text(index.span)} is negative: an index does not count from the end", index.span, help)
        return False
    many, at = f"len({a.text(operand.span)})", a.text(index.span)
    if value is not None and size is not None:
        sides = (linear.at_least(value, size), linear.less(value, ZERO))
        bad = linear.Or(sides)
        if is_refuted(bad, a):
            return True
        if is_right_by_default(bad, a) or _element_refuted(sides, bad, value, size, span, a):
            return False
        if is_wrong_in_a_run(value, size, many, "is out of range", span, a):
            return False
    open_ = f"{many} > {at}" if isinstance(index, ir.Const) else unproved_side(value, size, at, many, a)
    check = f"'if {open_ or f'0 <= {at} < {many}'}:' around the statement proves that the index is in range"
    help = f"{help_at_run_time(a)}; {check}" if len(check) <= 112 else help_at_run_time(a)
    a.warn("K034", f"{a.text(span)} may be out of range{missing_condition(open_)}", span, help)
    return False


def _element_refuted(
    sides: tuple[Formula, Formula], bad: Formula, value: Linear, size: Linear, span: Span, a: Analysis
) -> bool:
    """Report an index that is wrong in all states, or in some state. Returns whether an error was reported."""
    text = a.text(span)
    if is_impossible(linear.negate(bad), a) and not is_impossible(linear.TRUE, a):
        many = "" if size.terms else f": there are {size.constant} elements" if size.constant != 1 else ": there is one"
        a.error("K030", f"{text} is out of range{many}", span)
        return True
    for side in sides:
        example, certain = counterexample(side, bad, (value, size), a)
        if example is None:
            continue
        robot, shown = robots_of(side, value, example, a)
        count, case = linear.show(size), example_text(example, value)
        if certain:
            a.site_error("K030", f"{robot} reads {text}: index {shown} of {count} elements ({case})", span)
        else:
            message = f"{robot} may read {text}: index {shown} of {count} elements ({case})"
            a.warn("K034", message, span, help_at_run_time(a))
        return True
    return False


def end_proved(end: ir.Expr, span: Span, a: Analysis) -> bool:
    """Return whether the end of a slice, or the position of an insertion, is proved to be >= 0.

    A position that is not proved to be >= 0 is reported.
    """
    if a.flow is None or a.poisoned:
        return False
    value = term(end, a.flow)
    if value is not None and not value.terms:
        if value.constant >= 0:
            return True
        help = f"write len(...) - {-value.constant}"
        a.error("K036", f"{a.text(end.span)} is negative: an index does not count from the end", end.span, help)
        return False
    if value is not None and is_refuted(linear.less(value, ZERO), a):
        return True
    text = a.text(end.span)
    help = f"{help_at_run_time(a)}; 'if {text} >= 0:' around the statement proves that {text} is not negative"
    a.warn("K034", f"{a.text(span)}: {text} may be negative", end.span, help)
    return False


def has_element(values: ir.Expr, a: Analysis) -> bool:
    """Return whether a list, queue or string is proved to be non-empty."""
    many = length(values, a.flow) if a.flow is not None and has_length(values.type) else None
    return many is not None and is_impossible(linear.less(many, linear.constant(1)), a)
