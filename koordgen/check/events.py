"""Events: a guard, what it tells the effect, and whether the event can ever run."""

from __future__ import annotations

from typing import NamedTuple

from koordgen.check import bounds, linear
from koordgen.check.base import condition
from koordgen.check.context import Context
from koordgen.check.decide import unsat
from koordgen.check.names import unique
from koordgen.check.path import Condition, is_open
from koordgen.check.stmt import check_block
from koordgen.check.walk import statements
from koordgen.diagnostics import Label
from koordgen.ir import decl
from koordgen.ir.types import BOOL
from koordgen.source import Span
from koordgen.syntax import decl as ast
from koordgen.syntax.expr import Expr, Logic
from koordgen.syntax.stmt import Atomic, Block


class _Earlier(NamedTuple):
    """An event that stands before others, and what its guard joins by `and`."""

    name: str
    span: Span
    conditions: frozenset[str]


def events(written: list[ast.Event], c: Context) -> list[tuple[decl.Event, Atomic | None]]:
    """The events, still without their locks, each with its first `atomic` if it has one."""
    found: list[tuple[decl.Event, Atomic | None]] = []
    names: dict[str, Span] = {}
    hiding: ast.Event | None = None
    earlier: dict[str, list[_Earlier]] = {}  # by one condition of their guards
    transactions = "atomic" in c.source.text  # else no event need be searched for one
    for node in written:
        unique(node.name, "events", node.span, names, c)
        clauses = _clauses(node, c)
        if clauses is None:
            continue
        guard, effect = clauses
        atomic = _first_atomic(effect.block) if transactions else None
        event, always = _event(node, guard, effect, atomic is not None, hiding, c)
        found.append((event, atomic))
        if hiding is None:
            _look_behind(node, _conditions(guard.condition, c), earlier, c)
            hiding = node if always else None
    return found


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


def _look_behind(node: ast.Event, own: frozenset[str], earlier: dict[str, list[_Earlier]], c: Context) -> None:
    """Warns of an event whose guard asks for all that an earlier one's asks for: that one is always chosen."""
    hiding = [place for text in own for place in earlier.get(text, ()) if place.conditions <= own]
    if hiding:
        other = min(hiding, key=lambda place: place.span.line)  # sets have no order: the first in the text is told
        label = Label(other.span, "stands before, and asks for no more")
        message = f"the event {node.name} can never run: whenever its guard holds, {other.name}'s does"
        help = f"write it before {other.name}, or let {other.name} ask for more"
        c.warn("K042", message, node.span, help, (label,))
        return
    earlier.setdefault(min(own), []).append(_Earlier(node.name, node.span, own))


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
    node: ast.Event, pre: ast.Guard, eff: ast.Effect, transaction: bool, hiding: ast.Event | None, c: Context
) -> tuple[decl.Event, bool]:
    """The event, and whether its guard always holds."""
    c.enter("guard")
    c.transaction = transaction
    assert c.path is not None
    guard = condition(pre.condition, c, "a guard")
    sound, always = not c.refuted, False
    known = Condition(guard, c.path) if guard.type is BOOL else None
    if hiding is not None:
        label = Label(hiding.span, "always enabled, and earlier")
        message = f"the event {node.name} can never run: {hiding.name} is always chosen first"
        c.warn("K042", message, node.span, labels=(label,))
    elif known is not None and not is_open(guard, c.mentions, 0) and known.formula != linear.UNKNOWN:
        if unsat((known.formula,)):
            c.warn("K041", f"the event {node.name} can never run: its guard never holds", pre.condition.span)
        always = unsat((linear.negate(known.formula),))
    c.place = "effect"
    c.poisoned = known is None
    c.sites, c.refuted = [], []
    if known is not None:
        c.guard, c.path = known, c.path.passing(known)
    effect = check_block(eff.block, c)
    if sound:
        bounds.help_by_negation(pre.condition.span, c)
    return decl.Event(node.name, guard, effect, None, node.span), always
