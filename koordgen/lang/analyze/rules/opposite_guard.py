"""Help for K030, K032 and K034: suggests the negated guard if this guard would make an event right."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import relevant, unsat
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.node import replace
from koordgen.lang.source import Span


def help_by_negation(written: Span, a: Analysis) -> None:
    """Suggest the negated guard if this guard would make every index and divisor of the event right.

    `written` is the span of the guard.
    """
    if not a.refuted or a.guard is None:
        return
    opposite = linear.negate(a.guard.formula)
    if unsat((opposite,)):
        return
    if all(unsat((*relevant((opposite, *site.facts), site.bad), site.bad)) for site in a.sites):
        text = a.text(written)
        text = text if text.startswith("(") and text.endswith(")") else f"({text})"
        for position in a.refuted:
            help = f"with `pre: not {text}` every index and divisor of this event would be right"
            a.found[position] = replace(a.found[position], help=help)
