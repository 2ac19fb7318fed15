"""Transactions: which shared variables go together under one lock, and what bypasses it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from koordgen.lang.analyze import linear
from koordgen.lang.analyze.decide import unsat
from koordgen.lang.check.context import Context
from koordgen.lang.diagnostics import Label
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import statements, walk
from koordgen.lang.node import replace
from koordgen.lang.source import Span
from koordgen.lang.syntax.stmt import Atomic

Found = list[tuple[decl.Event, Atomic | None]]
Groups = tuple[tuple[str, ...], ...]


def locked(found: Found, shared: tuple[decl.Shared, ...], c: Context) -> tuple[tuple[decl.Event, ...], Groups]:
    """The events with their locks, and the groups of shared variables, in the order of their first declarations.
    A transaction without shared variables needs no lock: it is as any event."""
    used = [_shared_in(event) if atomic else set() for event, atomic in found]
    if not any(used):
        return tuple([event for event, _ in found]), ()
    groups = _groups(used, [v.name for v in shared])
    number = {name: index for index, group in enumerate(groups) for name in group}
    _plain_writes(found, used, c)
    events = [
        replace(event, lock=number[min(names)]) if names else event
        for (event, _), names in zip(found, used, strict=True)
    ]
    return tuple(events), groups


def _shared_in(event: decl.Event) -> set[str]:
    """The shared variables that an event reads or writes, its guard included."""
    kinds = (expr.SlotRead, expr.SlotsRead, expr.SharedRead, stmt.OwnSlot, stmt.SharedPlace)
    return {node.name for node in walk((event.guard, event.effect)) if isinstance(node, kinds)}


def _groups(used: list[set[str]], declared: list[str]) -> Groups:
    """What is connected by events, as groups."""
    leader = {name: name for names in used for name in names}

    def top(name: str) -> str:
        while leader[name] != name:
            leader[name] = name = leader[leader[name]]
        return name

    for names in used:
        for name in names:
            leader[top(name)] = top(min(names))
    groups: dict[str, list[str]] = {}
    for name in declared:
        if name in leader:
            groups.setdefault(top(name), []).append(name)
    return tuple([tuple(group) for group in groups.values()])


def _plain_writes(found: Found, used: list[set[str]], c: Context) -> None:
    """Warns of plain events that write what a transaction writes."""
    guarded: dict[str, tuple[str, Span]] = {}
    for (event, atomic), names in zip(found, used, strict=True):
        if names and atomic is not None:
            for place, _ in _writes(event.effect):
                guarded.setdefault(place.name, (event.name, atomic.span))
    for (event, _), names in zip(found, used, strict=True):
        told: set[str] = set()
        for place, span in () if names else _writes(event.effect):
            if place.name in guarded and place.name not in told:
                told.add(place.name)
                other, at = guarded[place.name]
                label = Label(at, f"{other} writes it as a transaction")
                message = f"a plain write to {place.name} bypasses the transactions that write it"
                c.warn("K044", message, span, "write it under 'atomic:' here as well", (label,))


def _writes(block: stmt.Block) -> Iterator[tuple[stmt.OwnSlot | stmt.SharedPlace, Span]]:
    """The writes to shared variables, in the order of the text."""
    for statement in statements(block):
        if isinstance(statement, stmt.Assign) and isinstance(statement.place, (stmt.OwnSlot, stmt.SharedPlace)):
            yield statement.place, statement.span


_OTHER = "other pid"


def only_one_robot(c: Context) -> bool:
    """Whether two robots can never be here in one round: one and another of them, each with its own pid, variables and
    ports, but with the same params and the same shared variables, contradict the guard, or what is known here."""
    if c.flow is None:
        return True
    # Shared variables that this event has written are a robot's own until the round ends.
    own = {f"shared {name}" for name in c.written_shared}
    here = [fact for fact in c.flow.facts if own.isdisjoint(linear.variables(fact))]
    return _contradictory(here) or (c.guard is not None and _contradictory([c.guard.formula]))


def _contradictory(facts: list[linear.Formula]) -> bool:
    """Whether the facts cannot hold of two robots."""
    pid, another, size = linear.variable(linear.PID), linear.variable(_OTHER), linear.variable(linear.N_SYS)
    return unsat((*facts, *map(_renamed, facts), linear.less(pid, another), linear.less(another, size)))


def _renamed(item: linear.Formula) -> linear.Formula:
    """A condition as it is for another robot."""
    match item:
        case linear.AtLeastZero(term):
            return linear.AtLeastZero(_term(term))
        case linear.Fact(key, holds):
            return linear.Fact(_key(key), holds)
        case linear.And(parts):
            return linear.And(tuple([_renamed(part) for part in parts]))
        case linear.Or(parts):
            return linear.Or(tuple([_renamed(part) for part in parts]))
        case linear.Unknown():
            return item
        case _:
            assert_never(item)


def _is_common(name: str) -> bool:
    return name.startswith(("param ", "shared "))


def _key(key: object) -> object:
    return key if isinstance(key, str) and _is_common(key) else (_OTHER, key)


def _term(term: linear.Linear) -> linear.Linear:
    return linear.Linear(tuple([(_variable(var), factor) for var, factor in term.terms]), term.constant)


def _variable(var: linear.Var) -> linear.Var:
    match var:
        case str():
            return var if var == linear.N_SYS or _is_common(var) else f"other {var}"
        case linear.Quotient(operand, divisor):
            return linear.Quotient(_term(operand), divisor)
        case linear.Remainder(operand, divisor):
            return linear.Remainder(_term(operand), _term(divisor))
        case linear.Choice(condition, then, orelse):
            return linear.Choice(_renamed(condition), _term(then), _term(orelse))
        case linear.Length(of):
            return linear.Length(_key(of))
        case linear.Value(of):
            return linear.Value(_key(of))
        case _:
            assert_never(var)
