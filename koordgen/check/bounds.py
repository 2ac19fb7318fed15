"""Indices and divisors: shown right for every robot of every fleet, shown wrong by an example, or left to run time."""

from __future__ import annotations

from koordgen.check import linear
from koordgen.check.context import Context, Site
from koordgen.check.decide import Example, find, relevant, unsat
from koordgen.check.facts import nonzero, term
from koordgen.check.linear import N_SYS, PID, Formula, Linear
from koordgen.ir import expr as ir
from koordgen.node import replace
from koordgen.source import Span

_PID, _SIZE, _ZERO = linear.variable(PID), linear.variable(N_SYS), linear.constant(0)
_LAST = linear.combine(_SIZE, linear.constant(-1))


def index_proved(index: ir.Expr, span: Span, c: Context) -> bool:
    """Whether 0 <= index < N_SYS here, always; a wrong or doubtful one is reported."""
    if isinstance(index, ir.Pid):
        return True
    if c.flow is None or c.poisoned:
        return False
    text = c.text(span)
    value = term(index, c.flow)
    if value is None:
        c.warn("K031", f"{text} may name no robot", span, _AT_RUN_TIME)
        return False
    sides = (linear.at_least(value, _SIZE), linear.less(value, _ZERO))
    bad = linear.Or(sides)
    if _holds_never(bad, c):
        return True
    for side in sides:
        example, certain = _refuted(side, bad, value, c)
        if example is None:
            continue
        robot, shown = _who(side, value, example, c)
        such = _example(example, value)
        if certain:
            c.refuted.append(len(c.found))
            c.error("K030", f"{robot} reads {text}: index {shown} names no robot ({such})", span)
        else:
            c.warn("K031", f"{robot} may read {text}: index {shown} names no robot ({such})", span, _AT_RUN_TIME)
        return False
    c.warn("K031", f"{text} may name no robot", span, _AT_RUN_TIME)
    return False


_AT_RUN_TIME = "it is checked at run time: a robot for which it fails discards the event and holds"


def divisor_proved(divisor: ir.Expr, span: Span, c: Context) -> bool:
    """Whether a divisor differs from zero here, always; a wrong or doubtful one is reported."""
    if isinstance(divisor, ir.Widen) and isinstance(divisor.operand, ir.Const):
        divisor = divisor.operand
    if isinstance(divisor, ir.Const) and divisor.value:
        return True
    if c.flow is None or c.poisoned:
        return False
    bad = linear.negate(nonzero(divisor, c.flow))
    if _holds_never(bad, c):
        return True
    text = c.text(divisor.span)
    value = term(divisor, c.flow)
    if value is not None:
        example, certain = _refuted(bad, bad, value, c)
        if example is not None and certain:
            c.refuted.append(len(c.found))
            if value.terms:
                robot, _ = _who(bad, value, example, c)
                message = f"{robot} divides by {text}, which is 0 ({_example(example, value)})"
            else:
                message = "this divides by 0" if text == "0" else f"this divides by {text}, which is 0"
            c.error("K032", message, span)
            return False
    help = f"'if {text} != 0:' around it shows that it is not"
    c.warn("K033", f"{text} may be zero", divisor.span, f"{_AT_RUN_TIME}; {help}")
    return False


def is_own(index: ir.Expr, c: Context) -> bool:
    """Whether an index is `pid` here, always."""
    if isinstance(index, ir.Pid) or c.flow is None or c.poisoned:
        return True
    value = term(index, c.flow)
    return value is not None and _never(linear.negate(linear.equal(value, _PID)), c)


def help_by_negation(c: Context) -> None:
    """Where the opposite guard would make every index and divisor of the event right, says so."""
    if not c.refuted or c.guard is None:
        return
    opposite = linear.negate(c.guard)
    if unsat((opposite,)):
        return
    if all(unsat((*relevant((opposite, *site.facts), site.bad), site.bad)) for site in c.sites):
        text = c.guard_text if c.guard_text.startswith("(") and c.guard_text.endswith(")") else f"({c.guard_text})"
        for position in c.refuted:
            help = f"with `pre: not {text}` every index and divisor of this event would be right"
            c.found[position] = replace(c.found[position], help=help)


def _holds_never(bad: Formula, c: Context) -> bool:
    assert c.flow is not None
    c.sites.append(Site(tuple(f for f in c.flow.facts if f is not c.guard), bad))
    return _never(bad, c)


def _never(condition: Formula, c: Context) -> bool:
    """Whether a condition cannot hold here."""
    assert c.flow is not None
    return unsat((*relevant(c.flow.facts, condition), condition))


def _refuted(side: Formula, bad: Formula, value: Linear, c: Context) -> tuple[Example | None, bool]:
    """An example of a robot for which `side` holds, and whether that is certain: no matter what else is the case,
    or because `bad` holds whenever one gets here."""
    assert c.flow is not None
    if any(not isinstance(v, str) or (v not in (PID, N_SYS) and v not in c.defaults) for v in linear.variables(value)):
        return None, False
    example = find((*c.flow.facts, side), c.defaults)
    if example is None:
        return None, False
    return example, example.certain or _never(linear.negate(bad), c)


def _who(side: Formula, value: Linear, example: Example, c: Context) -> tuple[str, str]:
    """The robots for which it goes wrong, and the index in their terms: ("robot N_SYS - 1", "N_SYS")."""
    assert c.flow is not None
    here = linear.constant(example.values[PID])
    for robot in (_LAST, here):
        if _never(linear.And((side, linear.negate(linear.equal(_PID, robot)))), c):
            return f"robot {linear.show(robot)}", _index(linear.substitute(value, PID, robot), value, example)
    return "a robot", _index(value, value, example)


def _index(shown: Linear, value: Linear, example: Example) -> str:
    if all(isinstance(var, str) for var, _ in shown.terms):
        return linear.show(shown)
    return str(linear.value_of(value, example.values))


def _example(example: Example, value: Linear) -> str:
    others = [n for n in dict.fromkeys(linear.variables(value)) if isinstance(n, str) and n not in (PID, N_SYS)]
    given = "".join(f", {n.rpartition(' ')[2]} = {example.values[n]}" for n in others)
    return f"for example pid = {example.values[PID]} of N_SYS = {example.values[N_SYS]}{given}"
