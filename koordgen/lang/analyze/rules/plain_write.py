"""K044: an event without `atomic` writes a variable that transactions write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.draft import Atomic
from koordgen.lang.ir.tree import statements
from koordgen.lang.reporter import Reporter
from koordgen.lang.source import Span


def check_plain_writes(
    found: Sequence[tuple[decl.Event, Atomic | None]], used: Sequence[set[str]], reporter: Reporter
) -> None:
    """Warn of events that are not atomic and write a variable that a transaction writes.

    `found` lists the events, each with its first `atomic`, or None if the event is not atomic. `used` lists for each
    event the set of its shared variables if the event is a transaction, else an empty set.
    """
    guarded: dict[str, tuple[str, Span]] = {}
    for (event, atomic), names in zip(found, used, strict=True):
        if names and atomic is not None:
            for place, _ in _writes(event.effect):
                guarded.setdefault(place.name, (event.name, atomic.span))
    for (event, _), names in zip(found, used, strict=True):
        reported: set[str] = set()
        for place, span in () if names else _writes(event.effect):
            if place.name in guarded and place.name not in reported:
                reported.add(place.name)
                other, at = guarded[place.name]
                label = Label(at, f"{other} writes {place.name} as a transaction")
                message = f"a plain write to {place.name} bypasses the transactions that write it"
                help = f"write {place.name} under 'atomic:' in this event as well"
                reporter.warn("K044", message, span, help, (label,))


def _writes(block: stmt.Block) -> Iterator[tuple[stmt.OwnSlot | stmt.SharedPlace, Span]]:
    """Yield the writes to shared variables, in the order of the text."""
    for statement in statements(block):
        if isinstance(statement, stmt.Assign) and isinstance(statement.place, (stmt.OwnSlot, stmt.SharedPlace)):
            yield statement.place, statement.span
