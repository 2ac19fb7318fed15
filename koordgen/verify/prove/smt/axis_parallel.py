"""Stricter, linear forms of consistency obligations: points that occur together lie on a line parallel to an axis.

A consistency obligation asks for one model of its facts. If only squares of distances make it nonlinear, a model with
such points is as good as any other, and a solver finds it in a twentieth of the time. APPROXIMATION (sound): every
model of the stricter form is a model of the obligation, so `sat` counts; any other answer says nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

from koordgen.lang.node import replace
from koordgen.verify.prove.smt import term as t
from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation


def axis_parallel(obligation: Obligation) -> Obligation | None:
    """Return the stricter form of an obligation; None if it has none."""
    if obligation.expected != "sat" or obligation.too_large or not obligation.logic.startswith("QF_UFN"):
        return None
    facts: list[LabelledFormula] = []
    for fact in obligation.facts:
        if fact.term.traits & t.NONLINEAR:
            stricter = _stricter(fact.term)
            if stricter is None:
                return None
            fact = replace(fact, term=stricter)
        facts.append(fact)
    return replace(obligation, logic=obligation.logic.replace("QF_UFN", "QF_UFL"), facts=tuple(facts))


def _stricter(fact: t.Term) -> t.Term | None:
    """Return a linear term that implies `d*d = x*x + y*y + z*z`; None if the fact is not of this form."""
    if not (isinstance(fact, t.Op) and fact.name == "="):
        return None
    distance = _root(fact.args[0])
    gaps = [_root(summand) for summand in _summands(fact.args[1])]
    known = [gap for gap in gaps if gap is not None]
    if distance is None or len(known) < len(gaps) or any(x.traits & t.NONLINEAR for x in (distance, *known)):
        return None
    zero = t.real(0)
    ways = []
    for axis, gap in enumerate(known):
        others = [t.equals(other, zero) for place, other in enumerate(known) if place != axis]
        ways.append(t.all_of([*others, t.or_(t.equals(distance, gap), t.equals(distance, t.negate(gap)))]))
    return t.any_of(ways)


def _summands(term: t.Term) -> Iterator[t.Term]:
    if isinstance(term, t.Op) and term.name == "+":
        for arg in term.args:
            yield from _summands(arg)
    else:
        yield term


def _root(square: t.Term) -> t.Term | None:
    """Return the term whose square is given; None if it is not a square."""
    is_square = isinstance(square, t.Op) and square.name == "*" and square.args[0] is square.args[1]
    return square.args[0] if is_square and isinstance(square, t.Op) else None
