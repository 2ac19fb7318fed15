"""Locks of transactions: groups of shared variables with a common lock, and the events that need each lock."""

from __future__ import annotations

from collections.abc import Sequence

from koordgen.lang.analyze.rules.plain_write import check_plain_writes
from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.draft import Atomic
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import replace
from koordgen.lang.reporter import Reporter

Found = Sequence[tuple[decl.Event, Atomic | None]]
Groups = tuple[tuple[str, ...], ...]


def with_locks(
    found: Found, shared: tuple[decl.Shared, ...], reporter: Reporter
) -> tuple[tuple[decl.Event, ...], Groups]:
    """Return the events with their locks, and the groups of shared variables that each lock protects.

    The groups are in the order of the declarations. A transaction that uses no shared variable needs no lock and is
    treated as an event that is not atomic.
    """
    used = [_shared_in(event) if atomic else set() for event, atomic in found]
    if not any(used):
        return tuple([event for event, _ in found]), ()
    groups = _groups(used, [v.name for v in shared])
    number = {name: index for index, group in enumerate(groups) for name in group}
    check_plain_writes(found, used, reporter)
    events = [
        replace(event, lock=number[min(names)]) if names else event
        for (event, _), names in zip(found, used, strict=True)
    ]
    return tuple(events), groups


def _shared_in(event: decl.Event) -> set[str]:
    """Return the shared variables that an event reads or writes, its guard included."""
    kinds = (expr.SlotRead, expr.SlotsRead, expr.SharedRead, stmt.OwnSlot, stmt.SharedPlace)
    return {node.name for node in walk((event.guard, event.effect)) if isinstance(node, kinds)}


def _groups(used: list[set[str]], declared: list[str]) -> Groups:
    """Return groups of variables; all variables that one transaction uses are in the same group (union-find)."""
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
