"""Analysis of events: what the guard implies is known in the effect; rules find events that can never run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from koordgen.lang.analyze.expressions import analyze_expression
from koordgen.lang.analyze.facts.path import Condition
from koordgen.lang.analyze.rules.analysis import Analysis
from koordgen.lang.analyze.rules.hidden_event import AnalysedEvent, is_hidden
from koordgen.lang.analyze.rules.never_enabled import MOST_EARLIER, always_holds, can_run
from koordgen.lang.analyze.rules.opposite_guard import help_by_negation
from koordgen.lang.analyze.statements import analyze_block
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.draft import Atomic
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL, POISON


def analyze_events(written: Sequence[decl.Event], a: Analysis) -> list[tuple[decl.Event, Atomic | None]]:
    """Analyse the events. Returns them without their locks, each with its first `atomic`, or None."""
    found: list[tuple[decl.Event, Atomic | None]] = []
    earlier: list[AnalysedEvent] = []
    by_condition: dict[str, list[AnalysedEvent]] = {}  # events in `earlier`, by one condition of the guard
    transactions = "atomic" in a.source.text  # if False, no event is searched for `atomic`
    for event in written:
        atomic = _first_atomic(event) if transactions else None
        analyzed = _event(event, atomic is not None, earlier, by_condition, a)
        found.append((analyzed.event, atomic))
        earlier.append(analyzed)
        by_condition.setdefault(min(analyzed.conditions), []).append(analyzed)
    return found


def _first_atomic(event: decl.Event) -> Atomic | None:
    return next((node for node in walk(event.effect) if isinstance(node, Atomic)), None)


def _event(
    event: decl.Event,
    transaction: bool,
    earlier: Sequence[AnalysedEvent],
    by_condition: Mapping[str, Sequence[AnalysedEvent]],
    a: Analysis,
) -> AnalysedEvent:
    a.enter("guard")
    a.transaction = transaction
    assert a.path is not None
    first = _events_with_priority(event, transaction, earlier)
    for other in first[-MOST_EARLIER:]:
        if other.guard is not None:
            a.path = a.path.failing(other.guard)
    guard = analyze_expression(event.guard, a)
    sound = not a.refuted
    known = Condition(guard, a.path) if guard.type is BOOL else None
    own = _conditions(event.guard, a)
    always = False
    if not is_hidden(event, [other for other in earlier if other.always], first, a):
        can = known is None or can_run(event, known, first, a)
        asking_less = [other for text in own for other in by_condition.get(text, ()) if other.conditions <= own]
        if can and not is_hidden(event, asking_less, first, a):
            always = known is not None and always_holds(known)
    a.place = "effect"
    a.poisoned = known is None
    a.sites, a.refuted = [], []
    if known is not None:
        a.guard, a.path = known, a.path.passing(known)
    effect = analyze_block(event.effect, a)
    if sound:
        help_by_negation(event.guard.span, a)
    analyzed = decl.Event(event.name, guard, effect, None, event.priority, event.span)
    return AnalysedEvent(analyzed, known, own, always)


def _events_with_priority(
    event: decl.Event, transaction: bool, earlier: Sequence[AnalysedEvent]
) -> list[AnalysedEvent]:
    """Return the earlier events of the `priority:` block whose guards are certainly false when this event runs.

    Guards are evaluated on the state at the round's start. The effect of a transaction sees newer values of the shared
    variables, so for a transaction the events whose guards read shared variables are left out.
    """
    if event.priority is None:
        return []
    block = [other for other in earlier if other.event.priority == event.priority]
    return [o for o in block if not transaction or (o.guard and not _reads_shared(o.guard.node))]


def _reads_shared(guard: ir.Expr) -> bool:
    return any(isinstance(node, (ir.SlotRead, ir.SlotsRead, ir.SharedRead)) for node in walk(guard))


def _conditions(guard: ir.Expr, a: Analysis) -> frozenset[str]:
    """Return the texts of the conditions that a guard joins with 'and'."""
    pending, found = [guard], set[str]()
    while pending:
        node = pending.pop()
        if isinstance(node, ir.Make) and node.type is POISON and isinstance(node.items[0], ir.Logic):
            node = node.items[0]  # an 'and' in which one condition has an error
        if isinstance(node, ir.Logic) and node.op == "and":
            pending += [node.left, node.right]
        else:
            # `a.text` has only the first line of a condition, so longer conditions are also compared by line number.
            line = node.span.line if node.span.line != node.span.end_line else ""
            found.add(f"{a.text(node.span)} {line}")
    return frozenset(found)
