"""Events: a guard, what it tells the effect, and whether the event can ever run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from koordgen.lang.analyze import linear
from koordgen.lang.analyze.decide import unsat
from koordgen.lang.analyze.path import Condition, is_open
from koordgen.lang.analyze.walk import statements
from koordgen.lang.check import bounds
from koordgen.lang.check.base import condition
from koordgen.lang.check.context import Context
from koordgen.lang.check.names import unique
from koordgen.lang.check.statements.stmt import check_block
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import BOOL
from koordgen.lang.source import Span
from koordgen.lang.syntax import decl as ast
from koordgen.lang.syntax.expr import Expr, Logic
from koordgen.lang.syntax.stmt import Atomic, Block

MOST_EARLIER = 10  # guards with priority that are judged together with one; to leave others out is always right


class _Judged(NamedTuple):
    """An event that was checked: its `priority:` block, its guard, and what the guard joins by `and`, as written.
    `always`: the guard holds in every state."""

    name: str
    span: Span
    block: int | None
    guard: Condition | None
    conditions: frozenset[str]
    always: bool


class _Written(NamedTuple):
    """An event in the text: its clauses, its `priority:` block, and whether it contains `atomic`."""

    node: ast.Event
    pre: ast.Guard
    eff: ast.Effect
    block: int | None
    transaction: bool


def in_text_order(sections: Iterable[ast.Section]) -> list[tuple[ast.Event, int | None]]:
    """Every event of a program, each with the index of its `priority:` block."""
    found: list[tuple[ast.Event, int | None]] = []
    blocks = 0
    for section in sections:
        if isinstance(section, ast.Event):
            found.append((section, None))
        elif isinstance(section, ast.Priority):
            found += [(event, blocks) for event in section.events]
            blocks += 1
    return found


def events(written: list[tuple[ast.Event, int | None]], c: Context) -> list[tuple[decl.Event, Atomic | None]]:
    """The events, still without their locks, each with its first `atomic` if it has one."""
    found: list[tuple[decl.Event, Atomic | None]] = []
    names: dict[str, Span] = {}
    earlier: list[_Judged] = []
    by_condition: dict[str, list[_Judged]] = {}  # those of `earlier`, by one condition of their guards
    transactions = "atomic" in c.source.text  # else no event need be searched for one
    for node, block in written:
        unique(node.name, "events", node.span, names, c)
        clauses = _clauses(node, c)
        if clauses is None:
            continue
        guard, effect = clauses
        atomic = _first_atomic(effect.block) if transactions else None
        event, judged = _event(_Written(node, guard, effect, block, atomic is not None), earlier, by_condition, c)
        found.append((event, atomic))
        earlier.append(judged)
        by_condition.setdefault(min(judged.conditions), []).append(judged)
    return found


def lone_priorities(sections: Iterable[ast.Section], c: Context) -> None:
    """Warn of each `priority:` block of one event."""
    for section in sections:
        if isinstance(section, ast.Priority) and len(section.events) == 1:
            only = section.events[0].name
            help = f"indent the events that are ordered with {only} under the same 'priority:'"
            c.warn("K046", f"this priority block orders nothing: {only} is its only event", section.span, help)


def _conditions(guard: Expr, c: Context) -> frozenset[str]:
    """What a guard joins by `and`, as it is written."""
    pending, found = [guard], set[str]()
    while pending:
        node = pending.pop()
        if isinstance(node, Logic) and node.op in ("and", "&&"):
            pending += [node.left, node.right]
        else:
            spread = node.span.line != node.span.end_line  # of which only the first line is at hand: like no other
            found.add(f"{c.text(node.span)} {node.span.line if spread else ''}")
    return frozenset(found)


def _hidden(event: _Written, hiding: Sequence[_Judged], first: Sequence[_Judged], c: Context) -> bool:
    """Warn of an event whose guard holds only where that of an event of `hiding` holds. `first` are the events that
    have priority over it."""
    ahead = [other for other in hiding if other in first]
    if not hiding:
        return False
    other = min(ahead or hiding, key=lambda judged: judged.span.line)  # the first in the text is told
    label = Label(other.span, "stands before, and " + ("is always enabled" if other.always else "asks for no more"))
    why = f"{other.name}'s guard always holds" if other.always else f"whenever its guard holds, {other.name}'s does"
    name = event.node.name
    if ahead:
        message = f"the event {name} can never run: {why}, and {other.name} has priority"
        help = f"write it before {other.name}, or let {other.name} ask for more"
    else:
        message = f"robots never run the event {name}: {why}, and robots run the first event in text order"
        help = (
            f"the language allows it, so proofs and explorations include it; if {other.name} is meant to go first, "
            "write both under 'priority:'; otherwise change a guard"
        )
        if event.block is not None and other.block == event.block:
            help = (
                "the language allows it, because a transaction sees what other robots have committed since the round's "
                "start; change a guard"
            )
    c.warn("K042", message, event.node.span, help, (label,))
    return True


def _first(event: _Written, earlier: Sequence[_Judged]) -> list[_Judged]:
    """The events before it in its `priority:` block whose guards are known to be false of all that it sees. A
    transaction sees shared variables as they are, the guards were judged at the round's start: those are left out."""
    block = [other for other in earlier if event.block is not None and other.block == event.block]
    return [o for o in block if not event.transaction or (o.guard and not _reads_shared(o.guard.node))]


def _reads_shared(guard: ir.Expr) -> bool:
    return any(isinstance(node, (ir.SlotRead, ir.SlotsRead, ir.SharedRead)) for node in walk(guard))


def _clauses(node: ast.Event, c: Context) -> tuple[ast.Guard, ast.Effect] | None:
    guards = [g for g in node.clauses if isinstance(g, ast.Guard)]
    effects = [e for e in node.clauses if isinstance(e, ast.Effect)]
    for clauses, word in ((guards, "pre"), (effects, "eff")):
        if len(clauses) != 1:
            many = "no" if not clauses else "more than one"
            span = clauses[1].span if clauses else node.span
            c.error("K019", f"the event {node.name} has {many} '{word}:'", span, f"each event has one '{word}:'")
    return (guards[0], effects[0]) if guards and effects else None


def _first_atomic(block: Block) -> Atomic | None:
    found = [statement for statement in statements(block) if isinstance(statement, Atomic)]
    return min(found, key=lambda a: (a.span.line, a.span.column)) if found else None


def _event(
    event: _Written, earlier: Sequence[_Judged], by_condition: Mapping[str, Sequence[_Judged]], c: Context
) -> tuple[decl.Event, _Judged]:
    node, pre, eff, block, transaction = event
    c.enter("guard")
    c.transaction = transaction
    assert c.path is not None
    first = _first(event, earlier)
    for other in first[-MOST_EARLIER:]:
        if other.guard is not None:
            c.path = c.path.failing(other.guard)
    guard = condition(pre.condition, c, "a guard")
    sound = not c.refuted
    known = Condition(guard, c.path) if guard.type is BOOL else None
    own = _conditions(pre.condition, c)
    always = False
    if not _hidden(event, [other for other in earlier if other.always], first, c):
        can = known is None or _can_run(event, known, first, c)
        asking_less = [other for text in own for other in by_condition.get(text, ()) if other.conditions <= own]
        if can and not _hidden(event, asking_less, first, c):
            always = known is not None and _always_holds(known, c)
    c.place = "effect"
    c.poisoned = known is None
    c.sites, c.refuted = [], []
    if known is not None:
        c.guard, c.path = known, c.path.passing(known)
    effect = check_block(eff.block, c)
    if sound:
        bounds.help_by_negation(pre.condition.span, c)
    judged = _Judged(node.name, node.span, block, known, own, always)
    return decl.Event(node.name, guard, effect, None, block, node.span), judged


def _can_run(event: _Written, guard: Condition, first: Sequence[_Judged], c: Context) -> bool:
    """Return whether a guard may hold where the guards of `first` are false. Warn where it cannot."""
    if (not first and is_open(guard.node, c.mentions, 0)) or guard.formula == linear.UNKNOWN:
        return True
    name, span = event.node.name, event.pre.condition.span
    if unsat((guard.formula,)):
        c.warn("K041", f"the event {name} can never run: its guard never holds", span)
        return False
    nearest = first[-MOST_EARLIER:]
    failed = [linear.negate(other.guard.formula) for other in nearest if other.guard is not None]
    if failed and unsat((guard.formula, *failed)):
        labels = tuple([Label(other.span, "has priority") for other in nearest])
        message = f"the event {name} can never run: its guard holds only where that of an event with priority does"
        c.warn("K042", message, event.node.span, "write it before these, or let them ask for more", labels)
        return False
    return True


def _always_holds(guard: Condition, c: Context) -> bool:
    if is_open(guard.node, c.mentions, 0) or guard.formula == linear.UNKNOWN:
        return False
    return unsat((linear.negate(guard.formula),))
