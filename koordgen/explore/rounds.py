"""Every end of a round's program step, from a packed fleet: what each robot may do, in every order that matters.

A plain event reads the store of the round's start, so it does the same wherever in the round it comes. Two events of
two robots commute unless both write one allwrite variable, or one of them is atomic and reads what the other writes
(a slot has one writer). Events that commute with all others form the first phase, in which robots step by ascending
pid; the others form one phase for each group that is linked by such conflicts, in which every order is tried. Any
order of a round can be sorted into this one by exchanging neighbours that commute, so nothing is lost.
"""

from __future__ import annotations

from typing import NamedTuple

from koordgen.explore.machine import Choice, Machine, Packed
from koordgen.ir import decl, expr, stmt
from koordgen.node import nodes

Node = tuple[int, Packed]  # who has stepped, as bits; the fleet then
Came = tuple[Node, int, int]  # from where, by which robot, by which event


class Phase(NamedTuple):
    """Events by index, the plain and the atomic ones; whether the order of robots makes a difference."""

    plain: tuple[int, ...]
    atomic: tuple[int, ...]
    ordered: bool


def phases(program: decl.Program, independence: bool) -> tuple[Phase, ...]:
    """All events, by groups that commute with one another. Without `independence` one group in every order."""
    events = range(len(program.events))
    if not independence:
        return (_phase(program, events, True),) if program.events else ()
    allwrite = {v.name for v in program.shared if v.kind == "allwrite"}
    access = [_access(event) for event in program.events]

    def conflict(a: int, b: int) -> bool:
        (reads, writes), (others_reads, others_writes) = access[a], access[b]
        return bool(writes & others_writes & allwrite or writes & others_reads or reads & others_writes)

    groups: list[list[int]] = []
    for event in events:
        linked = [group for group in groups if any(conflict(event, other) for other in group)]
        if linked or conflict(event, event):
            groups = [group for group in groups if group not in linked]
            groups.append(sorted([event, *(other for group in linked for other in group)]))
        else:
            groups.append([event])
    free = [g[0] for g in groups if len(g) == 1 and not conflict(g[0], g[0])]
    bound = [_phase(program, group, True) for group in groups if group[0] not in free]
    return ((_phase(program, free, False),) if free else ()) + tuple(bound)


def _phase(program: decl.Program, events: range | list[int], ordered: bool) -> Phase:
    plain = tuple(e for e in events if program.events[e].lock is None)
    return Phase(plain, tuple(e for e in events if e not in plain), ordered)


def _access(event: decl.Event) -> tuple[set[str], set[str]]:
    """The shared variables that an event reads as they are when it runs, and those that it may write."""
    reads, writes = set(), set()
    for node in nodes((event.guard, event.effect)):
        match node:
            case expr.SlotRead(name) | expr.SlotsRead(name) | expr.SharedRead(name) if event.lock is not None:
                reads.add(name)
            case stmt.OwnSlot(name) | stmt.SharedPlace(name):
                writes.add(name)
            case _:
                pass
    return reads, writes


class Rounds:
    """The rounds of one machine. What a robot may do is computed once for each own and store."""

    def __init__(self, machine: Machine, independence: bool = True) -> None:
        self.machine = machine
        self.phases = phases(machine.program, independence)
        self._known: dict[tuple[int, bool, int, int, Packed], tuple[Choice, ...]] = {}

    def ends(self, fleet: Packed) -> dict[Node, Came | None]:
        """Every fleet that the program's step may leave, skipping included, each with how it came about. Every fleet
        within a round is among them: those who have not stepped yet may skip."""
        found: dict[Node, Came | None] = {(0, fleet): None}
        begun = fleet[self.machine.n_sys :]
        for number, phase in enumerate(self.phases):
            if phase.ordered:
                pending = list(found)
                for node in pending:  # grows meanwhile
                    for pid in range(self.machine.n_sys):
                        pending += self._stepped(found, number, pid, node, begun)
            else:
                for pid in range(self.machine.n_sys):
                    for node in list(found):
                        self._stepped(found, number, pid, node, begun)
        return found

    def _stepped(self, found: dict[Node, Came | None], number: int, pid: int, node: Node, begun: Packed) -> list[Node]:
        """What one robot's step adds, if it has taken none."""
        mask, fleet = node
        if mask >> pid & 1:
            return []
        added = []
        for choice in self._choices(number, pid, fleet, begun):
            following = (mask | 1 << pid, self.machine.applied(fleet, pid, choice))
            if following not in found:
                found[following] = (node, pid, choice.event)
                added.append(following)
        return added

    def _choices(self, number: int, pid: int, fleet: Packed, begun: Packed) -> tuple[Choice, ...]:
        phase = self.phases[number]
        found: tuple[Choice, ...] = ()
        if phase.plain:
            found = self._of(number, False, phase.plain, pid, fleet[pid], begun)
        if phase.atomic:
            found += self._of(number, True, phase.atomic, pid, fleet[pid], fleet[self.machine.n_sys :])
        return found

    def _of(
        self, number: int, atomic: bool, events: tuple[int, ...], pid: int, own: int, seen: Packed
    ) -> tuple[Choice, ...]:
        key = (number, atomic, pid, own, seen)
        found = self._known.get(key)
        if found is None:
            discards = len(self.machine.discards)
            found = self.machine.choices(events, pid, own, seen)
            if len(self.machine.discards) == discards:  # what is discarded is told anew each time
                self._known[key] = found
        return found


def steps(found: dict[Node, Came | None], node: Node) -> list[tuple[int, int, Packed]]:
    """How a round came to a node: robot, event and the fleet after it, in their order."""
    taken: list[tuple[int, int, Packed]] = []
    while (came := found[node]) is not None:
        before, pid, event = came
        taken.append((pid, event, node[1]))
        node = before
    return taken[::-1]
