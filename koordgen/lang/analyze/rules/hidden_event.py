"""K042: an event that never runs, because an earlier event is enabled whenever this event is."""

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
    other = min(
        ahead or hiding, key=lambda analyzed: analyzed.event.span.line
    )  # the hiding event that is first in the text
    name, earlier = event.name, other.event.name
    label = Label(
        other.event.span,
        f"earlier event, enabled {'in every state' if other.always else f'whenever {name} is enabled'}",
    )
    why = (
        f"{earlier}'s guard always holds" if other.always else f"whenever its guard holds, the guard of {earlier} holds"
    )
    if ahead:
        message = f"the event {name} can never run: {why}, and {earlier} has priority"
        help = f"move {name} before {earlier}, or make the guard of {earlier} stricter"
    else:
        message = f"robots never run the event {name}: {why}, and robots run the first event in text order"
        help = (
            f"the language allows {name} to run, so proofs and explorations include it; if {earlier} is meant to go "
            "first, write both under 'priority:'; otherwise change a guard"
        )
        if event.priority is not None and other.event.priority == event.priority:
            help = (
                f"the language allows {name} to run, because a transaction sees what other robots have committed "
                "since the round's start; change a guard"
            )
    reporter.warn("K042", message, event.span, help, (label,))
    return True
