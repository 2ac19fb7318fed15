"""K041, K042: an event whose guard never holds, or holds only if an event with priority can run."""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import unsat
from koordgen.lang.analyze.facts.path import Condition, is_open
from koordgen.lang.analyze.rules.hidden_event import AnalysedEvent
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.reporter import Reporter

MOST_EARLIER = 10  # limit on the guards with priority that are considered; with more guards, warnings may be missed
_NOTHING: frozenset[str] = frozenset()


def can_run(event: decl.Event, guard: Condition, first: Sequence[AnalysedEvent], reporter: Reporter) -> bool:
    """Return whether an event's guard may hold while the guards of the events in `first` are false.

    If the guard cannot hold, warns that the event can never run.
    """
    if (not first and is_open(guard.node, _NOTHING)) or guard.formula == linear.UNKNOWN:
        return True
    name = event.name
    if unsat((guard.formula,)):
        reporter.warn("K041", f"the event {name} can never run: its guard never holds", event.guard.span)
        return False
    nearest = first[-MOST_EARLIER:]
    failed = [linear.negate(other.guard.formula) for other in nearest if other.guard is not None]
    if failed and unsat((guard.formula, *failed)):
        labels = tuple([Label(other.event.span, "has priority") for other in nearest])
        message = f"the event {name} can never run: its guard holds only if the guard of an event with priority holds"
        help = f"move {name} before the events with priority, or make the guards of these events stricter"
        reporter.warn("K042", message, event.span, help, labels)
        return False
    return True


def always_holds(guard: Condition) -> bool:
    """Return whether a guard holds in every state."""
    if is_open(guard.node, _NOTHING) or guard.formula == linear.UNKNOWN:
        return False
    return unsat((linear.negate(guard.formula),))
