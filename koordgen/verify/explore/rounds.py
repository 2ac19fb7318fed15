"""Results of one round: the states of the fleet after every order of events that can matter.

Partial-order reduction: orders of events that surely lead to the same state are tried only once. Two events of two
robots conflict in two cases: both write the same allwrite variable, or one event is atomic and reads a variable that
the other event writes. All other events commute. A plain event reads the shared variables as they were at the start of
the round. A slot has only one writer. Guards that decide priority are read at the start of the round.

Events that commute with all events form the first phase, in which robots step by ascending pid. Each group of events
that conflicts connect forms a later phase, in which every order of robots is tried. Swapping neighbours that commute
turns any order of events into an order of phases, so no result is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, TypeVar

from koordgen.lang.ir import decl, expr, stmt
from koordgen.lang.ir.tree import walk
from koordgen.verify.explore.machine import Machine, Packed, RobotStep

T = TypeVar("T")
# bit mask of the robots that have run an event, and the state of the fleet after these events
Node = tuple[int, Packed]
# step that led to a node: (node before the step, pid of the robot, index of the event)
Predecessor = tuple[Node, int, int]


class EventPhase(NamedTuple):
    """Events of one phase, by index.

    `alone`: events that read no shared variables except the slots of the robot that runs the event.
    `plain`: plain events that are not in `alone`.
    `atomic`: atomic events that are not in `alone`.
    `ordered`: whether the order of robots makes a difference, so that every order is tried.
    `ranked`: whether another event has priority over an event of this phase, by a `priority:` block."""

    alone: tuple[int, ...]
    plain: tuple[int, ...]
    atomic: tuple[int, ...]
    ordered: bool
    ranked: bool


def event_phases(program: decl.Program, independence: bool, idle: Collection[int] = ()) -> tuple[EventPhase, ...]:
    """Group the events of a program, except the events in `idle`, into the phases of a round.

    Events of different phases commute. `independence`: whether the partial-order reduction is used. Without it, one
    phase contains all events, and every order of the robots is tried."""
    events = [event for event in range(len(program.events)) if event not in idle]
    if not independence:
        return (phase(program, events, True),) if events else ()
    allwrite = {v.name for v in program.shared if v.kind == "allwrite"}
    access = {event: shared_access(program.events[event]) for event in events}

    def conflict(a: int, b: int) -> bool:
        (reads, writes), (others_reads, others_writes) = access[a], access[b]
        return bool(writes & others_writes & allwrite or writes & others_reads or reads & others_writes)

    free, bound = conflict_groups(events, conflict)
    ordered = tuple([phase(program, group, True) for group in bound])
    return ((phase(program, free, False),) if free else ()) + ordered


def conflict_groups(events: Sequence[T], conflict: Callable[[T, T], bool]) -> tuple[list[T], list[list[T]]]:
    """Group events by their conflicts: the events without any conflict, and the groups that conflicts connect.

    An event can conflict with itself, if two robots run it."""
    groups: list[list[T]] = []
    for event in events:
        linked = [group for group in groups if any(conflict(event, other) for other in group)]
        if linked or conflict(event, event):
            groups = [group for group in groups if group not in linked]
            groups.append(sorted([event, *(other for group in linked for other in group)], key=events.index))
        else:
            groups.append([event])
    free = [g[0] for g in groups if len(g) == 1 and not conflict(g[0], g[0])]
    return free, [group for group in groups if group[0] not in free]


def phase(program: decl.Program, events: Sequence[int], ordered: bool) -> EventPhase:
    """Return the phase with these events of a program."""
    alone = tuple([e for e in events if _reads_alone(program, program.events[e])])
    plain = tuple([e for e in events if e not in alone and program.events[e].lock is None])
    atomic = tuple([e for e in events if e not in alone and e not in plain])
    return EventPhase(alone, plain, atomic, ordered, any(program.earlier(program.events[e]) for e in events))


def _reads_alone(program: decl.Program, event: decl.Event) -> bool:
    earlier = tuple([other.guard for other in program.earlier(event)])
    for node in walk((*earlier, event.guard, event.effect)):
        match node:
            case expr.SlotRead(_, expr.Pid()):
                pass
            case expr.SlotRead() | expr.SlotsRead() | expr.SharedRead():
                return False
            case _:
                pass
    return True


def shared_access(event: decl.Event) -> tuple[set[str], set[str]]:
    """Return the shared variables that an event reads when it runs, and the variables that it may write.

    A plain event reads all variables as of the start of the round, so the first set of a plain event is empty."""
    reads, writes = set(), set()
    for node in walk((event.guard, event.effect)):
        match node:
            case expr.SlotRead(name) | expr.SlotsRead(name) | expr.SharedRead(name) if event.lock is not None:
                reads.add(name)
            case stmt.OwnSlot(name) | stmt.SharedPlace(name):
                writes.add(name)
            case _:
                pass
    return reads, writes


class RoundExplorer:
    """Explorer of single rounds of one program.

    `alike`: whether the program treats all robots alike. If so, the possible steps of a robot are computed once for all
        orders of the other robots' slots.
    `representative`: function that replaces a robot's private state after its step by the private state that represents
        it in the search. Arguments: the pid, the number of the private state, and the shared variables. No robot reads
        the replaced state before the end of the round.
    `as_agents`: explore only rounds that agents can execute (`is_order_of_agents` of the semantics).
    `phases`: the phases of a round; by default those of the program."""

    def __init__(
        self, machine: Machine, independence: bool = True, idle: Collection[int] = (), alike: bool = False,
        representative: Callable[[int, int, Packed], int] | None = None, as_agents: bool = False,
        phases: tuple[EventPhase, ...] | None = None,
    ) -> None:  # fmt: skip
        self.machine, self.alike, self.representative, self.as_agents = machine, alike, representative, as_agents
        self.phases = event_phases(machine.program, independence, idle) if phases is None else phases
        self._known: dict[tuple[tuple[int, ...], int, int, Packed], tuple[RobotStep, ...]] = {}
        self._prior: dict[tuple[tuple[int, ...], int, int, Packed], tuple[int, ...]] = {}
        self._alone: dict[Packed, tuple[RobotStep, ...]] = {}

    def ends(self, fleet: Packed) -> Collection[Node]:
        """Return every possible result of a round that starts in the state `fleet`.

        A result names the robots that ran an event. In the first result, all robots skip. Any robot may skip, so the
        state after each step within the round is also a result of the round."""
        if self.as_agents:
            return self.ends_with_predecessors(fleet)
        found: list[Node] = [(0, fleet)]
        n_sys = self.machine.n_sys
        begun = fleet[n_sys:]
        for number, phase in enumerate(self.phases):
            if phase.ordered:
                found = list(self._every_order(found, number, begun))
            elif phase.atomic:
                for pid in range(n_sys):
                    found += self._of_one(found, number, pid, begun)
            else:
                # a robot that has not run an event in this round still has its private state of the round's start, and
                # plain events read the shared variables of the round's start
                for pid in range(n_sys):
                    if choices := self.choices(number, pid, fleet, begun):
                        found += self._all_of_one(found, pid, choices)
        return found

    def _of_one(self, found: list[Node], number: int, pid: int, begun: Packed) -> list[Node]:
        return [
            (mask | 1 << pid, self.machine.applied(at, pid, choice))
            for mask, at in found
            if not mask >> pid & 1
            for choice in self.choices(number, pid, at, begun)
        ]

    def _all_of_one(self, found: list[Node], pid: int, choices: tuple[RobotStep, ...]) -> list[Node]:
        bit, slot, machine = 1 << pid, self.machine.n_sys + pid, self.machine
        new = []
        for mask, at in found:
            if not mask & bit:
                for choice in choices:
                    if choice.cells == machine.nothing:
                        end = (*at[:pid], choice.own, *at[pid + 1 : slot], choice.slots, *at[slot + 1 :])
                    else:
                        end = machine.applied(at, pid, choice)
                    new.append((mask | bit, end))
        return new

    def _every_order(self, found: list[Node], number: int, begun: Packed) -> Collection[Node]:
        seen = dict.fromkeys(found)
        pending = list(seen)
        robots = range(self.machine.n_sys)
        for mask, at in pending:  # the loop body appends to `pending`
            for pid in robots:
                if not mask >> pid & 1:
                    for choice in self.choices(number, pid, at, begun):
                        node = (mask | 1 << pid, self.machine.applied(at, pid, choice))
                        if node not in seen:
                            seen[node] = None
                            pending.append(node)
        return pending

    def ends_with_predecessors(self, fleet: Packed) -> dict[Node, Predecessor | None]:
        """Return all possible results of a round from the state `fleet`, each with the step that led to it.

        None stands for no step: the result in which all robots skip."""
        if self.as_agents:
            return self._ends_of_agents(fleet)
        found: dict[Node, Predecessor | None] = {(0, fleet): None}
        begun = fleet[self.machine.n_sys :]
        for number, phase in enumerate(self.phases):
            if phase.ordered:
                pending = list(found)
                for node in pending:  # the loop body appends to `pending`
                    for pid in range(self.machine.n_sys):
                        pending += self._stepped(found, pid, node, self.choices(number, pid, node[1], begun))
            else:
                for pid in range(self.machine.n_sys):
                    for node in list(found):
                        self._stepped(found, pid, node, self.choices(number, pid, node[1], begun))
        return found

    def _ends_of_agents(self, fleet: Packed) -> dict[Node, Predecessor | None]:
        """Return the results of a round for all orders that agents execute, with the last step of each result.

        Agents first commit transactions, at most one for each lock, then run plain events by ascending pid. All events
        read the shared variables of the round's start. This is exact, because no transaction writes a variable that a
        transaction under another lock reads."""
        machine, events = self.machine, self.machine.program.events
        found: dict[Node, Predecessor | None] = {(0, fleet): None}
        begun = fleet[machine.n_sys :]
        first = {pid: machine.first(pid, fleet[pid], begun) for pid in range(machine.n_sys)}
        chosen = {pid: event for pid, event in first.items() if event is not None}
        rivals = {
            pid: sum(1 << other for other, e in chosen.items() if events[e].lock == events[event].lock is not None)
            for pid, event in chosen.items()
        }
        for pid in sorted(chosen, key=lambda pid: (events[chosen[pid]].lock is None, pid)):
            choices = self._of((chosen[pid],), pid, fleet[pid], begun)
            for node in list(found):
                if not node[0] & rivals[pid]:
                    self._stepped(found, pid, node, choices)
        return found

    def _stepped(
        self, found: dict[Node, Predecessor | None], pid: int, node: Node, choices: tuple[RobotStep, ...]
    ) -> list[Node]:
        """Add the nodes that the steps `choices` of a robot lead to from a node, and return the new nodes.

        A robot that has already run an event in the round makes no further step."""
        mask, fleet = node
        if mask >> pid & 1:
            return []
        added = []
        for choice in choices:
            following = (mask | 1 << pid, self.machine.applied(fleet, pid, choice))
            if following not in found:
                found[following] = (node, pid, choice.event)
                added.append(following)
        return added

    def choices(self, number: int, pid: int, fleet: Packed, begun: Packed) -> tuple[RobotStep, ...]:
        """Return the possible steps of a robot in a phase of a round.

        `number`: index of the phase. `fleet`: the present state. `begun`: the shared variables at the round's start."""
        phase, slot = self.phases[number], self.machine.n_sys + pid
        found: tuple[RobotStep, ...] = ()
        if phase.alone:
            key = (number, pid, fleet[pid], fleet[slot])
            known = self._alone.get(key)
            if known is None:
                events = self._having_priority(phase, phase.alone, pid, fleet[pid], begun)
                known = self._found(self._alone, key, events, pid, fleet[pid], begun)
            found = known
        if phase.plain:
            events = self._having_priority(phase, phase.plain, pid, fleet[pid], begun)
            found += self._of(events, pid, fleet[pid], begun)
        if phase.atomic:
            events = self._having_priority(phase, phase.atomic, pid, fleet[pid], begun)
            found += self._of(events, pid, fleet[pid], fleet[self.machine.n_sys :])
        return found

    def _having_priority(
        self, phase: EventPhase, events: tuple[int, ...], pid: int, own: int, begun: Packed
    ) -> tuple[int, ...]:
        if not phase.ranked:
            return events
        key = (events, pid, own, begun)
        found = self._prior.get(key)
        if found is None:
            any_order = self._any_order(*key) if self.alike else key
            found = self._prior.get(any_order)
            if found is None:
                found = self._prior[any_order] = self.machine.prior(events, pid, own, begun)
            self._prior[key] = found
        return found

    def _of(self, events: tuple[int, ...], pid: int, own: int, seen: Packed) -> tuple[RobotStep, ...]:
        key = (events, pid, own, seen)
        found = self._known.get(key)
        if found is None:
            any_order = self._any_order(*key) if self.alike else key
            found = self._known.get(any_order)
            if found is None:
                found = self._found(self._known, any_order, events, pid, own, seen)
            if any_order in self._known:
                self._known[key] = found
        return found

    def _found(
        self,
        known: dict[Any, tuple[RobotStep, ...]],
        key: Any,
        events: tuple[int, ...],
        pid: int,
        own: int,
        seen: Packed,
    ) -> tuple[RobotStep, ...]:
        discards = len(self.machine.discards)
        found = self.machine.choices(events, pid, own, seen)
        if self.representative is not None:
            found = tuple([c._replace(own=self.representative(pid, c.own, _with(seen, pid, c.slots))) for c in found])
        # do not store results with discarded events, so that `Machine.discards` records these events each time
        if len(self.machine.discards) == discards:
            known[key] = found
        return found

    def _any_order(self, events: tuple[int, ...], pid: int, own: int, seen: Packed) -> Any:
        others = sorted(seen[:pid] + seen[pid + 1 : -1])
        return events, -1, own, (seen[pid], *others, seen[-1])


def _with(seen: Packed, pid: int, slots: int) -> Packed:
    return (*seen[:pid], slots, *seen[pid + 1 :])


def steps_to(found: dict[Node, Predecessor | None], node: Node) -> list[tuple[int, int, Packed]]:
    """Return the steps of a round that lead to a node, in the order of execution.

    A step consists of the pid of the robot, the index of the event, and the state of the fleet after the event."""
    taken: list[tuple[int, int, Packed]] = []
    while (came := found[node]) is not None:
        before, pid, event = came
        taken.append((pid, event, node[1]))
        node = before
    return taken[::-1]
