"""K042: an event whose guard holds only if an earlier event's guard holds, which then runs instead."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from koordgen.lang.analyze.facts.path import Condition
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.reporter import Reporter


class AnalysedEvent(NamedTuple):
    """Event with the results of its analysis.

    `guard` is None if the guard has an error. `conditions` is the set of the texts of the conditions that the guard
    joins with 'and'. `always` is True if the guard holds in every state.
    """

    event: decl.Event
    guard: Condition | None
    conditions: frozenset[str]
    always: bool


def is_hidden(
    event: decl.Event, hiding: Sequence[AnalysedEvent], first: Sequence[AnalysedEvent], reporter: Reporter
) -> bool:
    """Warn of an event that can never run because its guard holds only if the guard of an event in `hiding` holds.

    `first` lists the events that have priority over the event. Returns whether the event was reported.
    """
    ahead = [other for other in hiding if any(other is earlier for earlier in first)]
    if not hiding:
        return False
    other = min(ahead or hiding, key=lambda analyzed: analyzed.event.span.line)  # the first in the text
    name, earlier = event.name, other.event.name
    label = Label(
        other.event.span,
        f"earlier event, enabled {'in every state' if other.always else 'in all of these cases, too'}",
    )
    why = f"{earlier}'s guard always holds" if other.always else f"whenever its guard holds, that of {earlier} holds"
    if ahead:
        message = f"the event {name} can never run: {why}, and {earlier} has priority"
        help = f"move it before {earlier}, or make the guard of {earlier} stricter"
    else:
        message = f"robots never run the event {name}: {why}, and robots run the first event in text order"
        help = (
            f"the language allows it, so proofs and explorations include it; if {earlier} is meant to go first, "
            "write both under 'priority:'; otherwise change a guard"
        )
        if event.priority is not None and other.event.priority == event.priority:
            help = (
                "the language allows it, because a transaction sees what other robots have committed since the round's "
                "start; change a guard"
            )
    reporter.warn("K042", message, event.span, help, (label,))
    return True
