"""K030, K031: an index of an allread variable must name a robot of the fleet."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.linear import N_SYS
from koordgen.lang.analyze.facts.terms import term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.evidence import (
    ZERO,
    counterexample,
    example_text,
    help_at_run_time,
    is_refuted,
    is_right_by_default,
    is_wrong_in_a_run,
    missing_condition,
    robots_of,
    unproved_side,
)
from koordgen.lang.ir import expr as ir
from koordgen.lang.source import Span

_SIZE = linear.variable(N_SYS)


def index_proved(index: ir.Expr, span: Span, a: Analysis) -> bool:
    """Return whether 0 <= index < N_SYS is proved. If not, report that the index is, or may be, out of range."""
    if type(index) is ir.Pid:
        return True
    if a.flow is None or a.poisoned:
        return False
    value = term(index, a.flow)
    if value is not None:
        sides = (linear.at_least(value, _SIZE), linear.less(value, ZERO))
        bad = linear.Or(sides)
        if is_refuted(bad, a):
            return True
        if is_right_by_default(bad, a):
            return False
        text = a.text(span)
        for side in sides:
            example, certain = counterexample(side, bad, (value,), a)
            if example is None:
                continue
            robot, shown = robots_of(side, value, example, a)
            such = example_text(example, value)
            if certain:
                a.site_error("K030", f"{robot} reads {text}: index {shown} names no robot ({such})", span)
            else:
                a.warn(
                    "K031", f"{robot} may read {text}: index {shown} names no robot ({such})", span, help_at_run_time(a)
                )
            return False
        if is_wrong_in_a_run(value, _SIZE, "N_SYS", "names no robot", span, a):
            return False
    open_ = unproved_side(value, _SIZE, a.text(index.span), "N_SYS", a)
    test = open_ or f"0 <= {a.text(index.span)} < N_SYS"
    check = f"'if {test}:' around the statement proves that the index names a robot"
    help = (
        help_at_run_time(a)
        if a.place in ("property", "assume", "guarantee", "provided") or len(check) > 116
        else f"{help_at_run_time(a)}; {check}"
    )
    a.warn("K031", f"{a.text(span)} may name no robot{missing_condition(open_)}", span, help)
    return False
