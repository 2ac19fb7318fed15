"""Checks of events: their clauses `pre:` and `eff:`, and the `priority:` blocks that order events."""

from __future__ import annotations

from collections.abc import Iterable

from koordgen.lang.check.base import condition
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import unique
from koordgen.lang.check.statements.stmt import check_block
from koordgen.lang.ir import decl
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast


def in_text_order(sections: Iterable[ast.Section]) -> list[tuple[ast.Event, int | None]]:
    """Return all events in the order of the text, each with the index of its `priority:` block, or None."""
    found: list[tuple[ast.Event, int | None]] = []
    blocks = 0
    for section in sections:
        if isinstance(section, ast.Event):
            found.append((section, None))
        elif isinstance(section, ast.Priority):
            found += [(event, blocks) for event in section.events]
            blocks += 1
    return found


def events(written: list[tuple[ast.Event, int | None]], c: Context) -> tuple[decl.Event, ...]:
    """Check the events.

    Returns the events that have a guard and an effect, in the order of the text. Their locks are assigned later.
    """
    found: list[decl.Event] = []
    names: dict[str, Span] = {}
    for node, block in written:
        unique(node.name, "events", node.span, names, c)
        clauses = _clauses(node, c)
        if clauses is not None:
            c.enter("guard")
            guard = condition(clauses[0].condition, c, "a guard")
            c.place = "effect"
            effect = check_block(clauses[1].block, c)
            found.append(decl.Event(node.name, guard, effect, None, block, node.span))
    return tuple(found)


def lone_priorities(sections: Iterable[ast.Section], c: Context) -> None:
    """Warn of each `priority:` block that has a single event."""
    for section in sections:
        if isinstance(section, ast.Priority) and len(section.events) == 1:
            only = section.events[0].name
            help = f"write the events that have a lower or higher priority than {only} in the same 'priority:' block"
            c.warn("K046", f"{only} is the only event of this 'priority:' block", section.span, help)


def _clauses(node: ast.Event, c: Context) -> tuple[ast.Guard, ast.Effect] | None:
    guards = [g for g in node.clauses if isinstance(g, ast.Guard)]
    effects = [e for e in node.clauses if isinstance(e, ast.Effect)]
    for clauses, word in ((guards, "pre"), (effects, "eff")):
        if len(clauses) != 1:
            many = "no" if not clauses else "more than one"
            span = clauses[1].span if clauses else node.span
            c.error("K019", f"the event {node.name} has {many} '{word}:'", span, f"each event has one '{word}:'")
    return (guards[0], effects[0]) if guards and effects else None
