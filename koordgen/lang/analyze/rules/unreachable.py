"""K043: statements, branches and loops that can never run."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import unsat
from koordgen.lang.analyze.facts.linear import N_SYS, PID, And, AtLeastZero, BoolFact, Formula
from koordgen.lang.analyze.facts.terms import Flow, names_of
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.ir import expr as ir
from koordgen.lang.source import Span


def _is_impossible(condition: Formula, before: Flow) -> bool:
    """Return whether a condition contradicts the facts before it."""
    if condition is linear.UNKNOWN:
        return False
    names = names_of(condition)
    facts = before.relevant(names)
    if not facts and PID not in names and N_SYS not in names:
        # A condition without facts about its variables is impossible only if it contradicts itself. A single
        # comparison cannot contradict itself.
        match condition:
            case BoolFact():
                return False
            case AtLeastZero(value) if value.terms:
                return False
            case And((AtLeastZero(first), AtLeastZero(second))) if (
                len(first.terms) == 1 and first.constant == -second.constant
            ):
                return False
    return unsat((*facts, condition))


def check_statement(span: Span, a: Analysis) -> None:
    """Warn of the first statement that no path reaches."""
    a.warn("K043", "this statement can never run: no path reaches it", span)


def check_branch(condition: ir.Expr, passed: Formula, span: Span, before: Flow, a: Analysis) -> None:
    """Warn of a branch whose condition contradicts the facts before it."""
    if _is_impossible(passed, before):
        a.warn("K043", f"this branch can never run: {a.text(condition.span)} never holds here", span)


def check_loop(condition: ir.Expr, first: Formula, span: Span, before: Flow, a: Analysis) -> None:
    """Warn of a `while` whose condition is always false when the loop begins."""
    if not a.poisoned and _is_impossible(first, before):
        a.warn("K043", f"this loop can never run: {a.text(condition.span)} does not hold here", span)
