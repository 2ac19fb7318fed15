"""K021: a robot may only write its own slot of an allread variable."""

from __future__ import annotations

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.terms import term
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.evidence import is_impossible
from koordgen.lang.ir.draft import SlotPlace

_PID = linear.variable(linear.PID)


def check_own(place: SlotPlace, a: Analysis) -> None:
    """Report the index of a written slot unless the index is proved to be `pid`."""
    if a.flow is None or a.poisoned:
        return
    value = term(place.index, a.flow)
    if value is not None and is_impossible(linear.negate(linear.equal(value, _PID)), a):
        return
    message = f"{a.text(place.span)} may be another robot's slot; a robot writes {place.name}[pid] only"
    a.error("K021", message, place.span, f"write {place.name}[pid] = ...")
