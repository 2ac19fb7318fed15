"""Rounds of a system: all states that one round can lead to, by any order of the instances.

Partial-order reduction, as for one program: events of two instances conflict if both write the same allwrite variable,
or if one is atomic and reads a shared variable that the other writes. Variables are compared by their names in the
store, so an importer's event can conflict with an event of the exporter. In addition, writes of slots conflict if the
allread variable has a step guarantee, since the guarantee compares the slots of all robots; and events of two
applications conflict if both applications run on one robot and both events write a port of the same name. All instances
read their robot's ports as they were at the round's start, so no other events conflict by ports.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.ports import clears
from koordgen.lang.ir.tree import walk
from koordgen.lang.semantics.composition import System
from koordgen.verify.explore.machine import Packed, RobotStep
from koordgen.verify.explore.rounds import (
    EventPhase,
    Node,
    Predecessor,
    RoundExplorer,
    conflict_groups,
    phase,
    shared_access,
)
from koordgen.verify.explore.system.guarantees import Guarantees
from koordgen.verify.explore.system.machine import SystemMachine

SystemEvent = tuple[int, int]  # index of an application, and of an event in its program
Variable = tuple[int, str]  # index of the application that declares a shared variable, and the variable's name


class BrokenStep(NamedTuple):
    """Step that broke a step guarantee.

    `before`: the node from which the instance took the step. `after`: the state after it.
    `exporter`: the index of the application that guarantees."""

    before: Node
    instance: int
    event: int
    after: Packed
    exporter: int
    guarantee: decl.Guarantee


class _Access(NamedTuple):
    """Shared variables that an event reads when it runs and that it writes, and ports that it writes."""

    reads: frozenset[Variable]
    writes: frozenset[Variable]
    ports: frozenset[str]


def system_phases(
    system: System, ordered: Collection[Variable], independence: bool
) -> tuple[tuple[bool, tuple[EventPhase, ...]], ...]:
    """Group the events of all applications into the phases of a round.

    For each phase, returns whether every order of instances is tried, and the phase of each application.
    `ordered`: the variables with a step guarantee. `independence`: whether the partial-order reduction is used."""
    programs = [application.program for application in system.applications]
    events = [(a, e) for a, program in enumerate(programs) for e in range(len(program.events))]
    access = {(a, e): _access(system, a, programs[a].events[e]) for a, e in events}
    together = [frozenset(application.members) for application in system.applications]
    shared = {(a, v.name) for a in range(len(programs)) for v in system.own(a) if v.kind == "allwrite"} | {*ordered}

    def conflict(one: SystemEvent, other: SystemEvent) -> bool:
        (reads, writes, ports), (others_reads, others_writes, others_ports) = access[one], access[other]
        if ports & others_ports and together[one[0]] & together[other[0]] and one[0] != other[0]:
            return True
        return bool(writes & others_writes & shared or writes & others_reads or reads & others_writes)

    free, bound = conflict_groups(events, conflict) if independence else ([], [events])
    groups = [(False, free), *[(True, group) for group in bound]]
    return tuple([
        (in_order, tuple([phase(p, [e for b, e in group if b == a], in_order) for a, p in enumerate(programs)]))
        for in_order, group in groups
        if group
    ])  # fmt: skip


def _access(system: System, application: int, event: decl.Event) -> _Access:
    reads, writes = (
        frozenset([(system.owner(application, name), name) for name in names]) for names in shared_access(event)
    )
    program = system.applications[application].program
    commanded = [f"{n.module}.{n.port}" for n in walk(event.effect) if isinstance(n, stmt.PortPlace)]
    cleared = [sensor for name in commanded for sensor in clears(program).get(name, ())]
    return _Access(reads, writes, frozenset([*commanded, *cleared]))


class SystemRounds:
    """Explorer of single rounds of a system.

    `guarantees`: those of each application.
    `as_agents`: explore only rounds that agents can execute.
    `broken`: the steps that broke a step guarantee, in order."""

    def __init__(
        self, machine: SystemMachine, guarantees: Sequence[Guarantees], independence: bool = True,
        as_agents: bool = False,
    ) -> None:  # fmt: skip
        self.machine, self.as_agents = machine, as_agents
        self.broken: list[BrokenStep] = []
        self._guarantees = [(index, each) for index, each in enumerate(guarantees) if each.steps]
        ordered = [(index, name) for index, each in self._guarantees for name in each.ordered]
        phases = system_phases(machine.system, ordered, independence)
        self._ordered = [in_order for in_order, _ in phases]
        self._explorers = [
            RoundExplorer(each, phases=tuple([of[index] for _, of in phases]))
            for index, each in enumerate(machine.machines)
        ]
        self._locks = machine.system.locks()

    def ends(self, fleet: Packed) -> Collection[Node]:
        """Return every possible result of a round that starts in the state `fleet`.

        A result names the instances that ran an event. In the first result, all instances skip."""
        return self.ends_with_predecessors(fleet)

    def ends_with_predecessors(self, fleet: Packed) -> dict[Node, Predecessor | None]:
        """Return all possible results of a round, each with the step that led to it; None stands for no step."""
        if self.as_agents:
            return self._ends_of_agents(fleet)
        found: dict[Node, Predecessor | None] = {(0, fleet): None}
        numbers = range(len(self.machine.instances))
        for index, in_order in enumerate(self._ordered):
            if in_order:
                pending = list(found)
                for node in pending:  # the loop body appends to `pending`
                    for number in numbers:
                        if not node[0] >> number & 1:
                            choices = self._choices(index, number, node[1], fleet)
                            pending += self._stepped(found, number, node, fleet, choices)
            else:
                for number in numbers:
                    choices = self._choices(index, number, fleet, fleet)
                    for node in list(found) if choices else []:
                        self._stepped(found, number, node, fleet, choices)
        return found

    def _choices(self, index: int, number: int, fleet: Packed, begun: Packed) -> tuple[RobotStep, ...]:
        """Return the possible steps of an instance in a phase, with its ports as they were at the round's start.

        `begun`: the state of the system at the round's start."""
        a, pid = self.machine.units[number]
        now, start = self.machine.view(fleet, a), self.machine.view(begun, a)
        if now[pid] != start[pid]:
            now = (*now[:pid], start[pid], *now[pid + 1 :])
        return self._explorers[a].choices(index, pid, now, start[self.machine.machines[a].n_sys :])

    def _stepped(
        self, found: dict[Node, Predecessor | None], number: int, node: Node, begun: Packed,
        choices: tuple[RobotStep, ...],
    ) -> list[Node]:  # fmt: skip
        """Add the nodes that the steps `choices` of an instance lead to from a node, and return the new nodes.

        An instance that has already run an event in the round makes no further step."""
        mask, fleet = node
        if mask >> number & 1:
            return []
        added, own = [], begun[self.machine.own_places[number]]
        for choice in choices:
            after = self.machine.applied(fleet, number, own, choice)
            for exporter, guarantees in self._guarantees:
                views = self.machine.view(fleet, exporter), self.machine.view(after, exporter)
                if broken := guarantees.broken_step(*views):
                    self.broken.append(BrokenStep(node, number, choice.event, after, exporter, broken))
            following = (mask | 1 << number, after)
            if following not in found:
                found[following] = (node, number, choice.event)
                added.append(following)
        return added

    def _ends_of_agents(self, fleet: Packed) -> dict[Node, Predecessor | None]:
        """Return the results of a round for all orders that agents execute, with the last step of each result.

        Commits come first, at most one for each lock of the system, then plain events by instance. All events read the
        state of the round's start."""
        machine = self.machine
        found: dict[Node, Predecessor | None] = {(0, fleet): None}
        chosen = {number: event for number in range(len(machine.instances)) if (event := self._first(number, fleet))}
        rivals = {
            number: sum(1 << other for other, (_, held) in chosen.items() if held == lock is not None)
            for number, (_, lock) in chosen.items()
        }
        for number in sorted(chosen, key=lambda number: (chosen[number][1] is None, number)):
            a, pid = machine.units[number]
            seen = machine.view(fleet, a)
            choices = machine.machines[a].choices(
                (chosen[number][0],), pid, seen[pid], seen[machine.machines[a].n_sys :]
            )
            for node in list(found):
                if not node[0] & rivals[number]:
                    self._stepped(found, number, node, fleet, choices)
        return found

    def _first(self, number: int, fleet: Packed) -> tuple[int, int | None] | None:
        """Return the event that an agent runs for an instance, and its lock in the system; None if it runs none."""
        a, pid = self.machine.units[number]
        machine, seen = self.machine.machines[a], self.machine.view(fleet, a)
        event = machine.first(pid, seen[pid], seen[machine.n_sys :])
        if event is None:
            return None
        lock = machine.program.events[event].lock
        return event, None if lock is None else self._locks[a, lock]
