"""Exploration of a system of several applications, and the description of a violation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.system import SystemState, initial_system, view
from koordgen.lang.semantics.values import Value
from koordgen.verify.explore.breadth_first import (
    BreadthFirstSearch,
    ExplorationBounds,
    ExplorationProgress,
    PackedRunState,
)
from koordgen.verify.explore.invariants import Invariants
from koordgen.verify.explore.machine import DiscardedEvent, Packed
from koordgen.verify.explore.rounds import Node, Predecessor
from koordgen.verify.explore.search import DEADLOCK, LOOP, WELL_DEFINED
from koordgen.verify.explore.system.environment import SystemEnvironmentSteps
from koordgen.verify.explore.system.guarantees import Guarantees
from koordgen.verify.explore.system.machine import SystemMachine
from koordgen.verify.explore.system.rounds import BrokenStep, SystemRounds
from koordgen.verify.prove.report.model import Conjunct, failing_conjunct
from koordgen.verify.prove.report.reach import ENVIRONMENT


class SystemRunState(NamedTuple):
    """State of a run of a system, with the step that led to the state.

    `event`: the step: "" for the first state, "init", an event's name, or "(environment)".
    `instance`: the instance that ran the event; None for other steps."""

    state: SystemState
    event: str
    instance: int | None
    round: int


class SystemViolation(NamedTuple):
    """Violation of a property of a system, with a run that leads to the violation.

    `application`: index of the application that declares the property or the event; None for a deadlock.
    `name`: the violated property: the name of an invariant or a guarantee, LOOP with a line, WELL_DEFINED or DEADLOCK.
    `failed`: the conjunct that is false in the last state, or in the last step; None for other violations.
    `reason`: explanation of the violation if `failed` is None.
    `culprit`: the instance and its next event, if the failure is that this event has no result; otherwise None.
    `of_agents`: whether a run to this violation is known that agents can execute.
    `shortest`: number of rounds of the shortest run that the language allows; None if `run_states` is this short."""

    application: int | None
    name: str
    line: int
    run_states: tuple[SystemRunState, ...]
    failed: Conjunct | None
    reason: str
    culprit: tuple[int, str] | None = None
    of_agents: bool = True
    shortest: int | None = None


class SystemResult(NamedTuple):
    """Result of an exploration of a system.

    `stopped`: the reason why the exploration ended early; empty if everything was explored.
    `unseen`: events that were never enabled, with the indices of their applications.
    `unchecked`: the invariants and guarantees that cannot be evaluated, with the indices of their applications."""

    violation: SystemViolation | None
    progress: ExplorationProgress
    stopped: str
    unseen: tuple[tuple[int, decl.Event], ...]
    unchecked: tuple[tuple[int, str], ...]


class SystemSearch(BreadthFirstSearch[SystemViolation]):
    """One exploration of a system, without symmetry and without reduction of private states.

    `as_agents`: explore only rounds that agents can execute. `run` raises MissingEnvironment."""

    around: SystemEnvironmentSteps

    def __init__(
        self, machine: SystemMachine, around: SystemEnvironmentSteps, bounds: ExplorationBounds,
        clock: Callable[[], float], show: Callable[[ExplorationProgress], None], independence: bool = True,
        deadlock: bool = True, as_agents: bool = False,
    ) -> None:  # fmt: skip
        self.machine = machine
        self.invariants = [Invariants(each) for each in machine.machines]
        self.guarantees = [Guarantees(each) for each in machine.machines]
        self._judged: list[dict[Packed, bool]] = [{} for _ in machine.machines]
        rounds = SystemRounds(machine, self.guarantees, independence, as_agents)
        self.rounds: SystemRounds = rounds
        self.exact: SystemRounds = rounds
        super().__init__(around, any(each.sensors for each in machine.machines), bounds, clock, show, deadlock)

    def run(self) -> SystemResult:
        """Explore until all states are explored, a violation is found, or a limit is reached."""
        violation, stopped = self._found()
        machines = enumerate(self.machine.machines)
        unseen = [(a, e) for a, m in machines for i, e in enumerate(m.program.events) if i not in m.enabled]
        unchecked = [
            (a, name)
            for a, each in enumerate(zip(self.invariants, self.guarantees, strict=True))
            for name in (*each[0].unchecked, *each[1].unchecked)
        ]
        return SystemResult(violation, self.progress(), stopped, tuple(unseen), tuple(unchecked))

    def _starts(self) -> Iterator[tuple[Packed, Packed]]:
        system = self.machine.system
        for sensors in self.around.starts():
            state = initial_system(system, sensors)
            if all(self._is_start(view(system, state, a), a) for a in range(len(system.applications))):
                before = self.machine.packed(state)
                after_init = self.machine.after_init(before)
                yield from [(before, after) for after in after_init] if not self._has_failed() else [(before, before)]

    def _is_start(self, state: State, application: int) -> bool:
        """Return whether a state of an application satisfies its `initially` properties."""
        program = self.machine.system.applications[application].program
        rules = [p for p in program.properties if p.kind == "initially"]
        try:
            return all(holds_property(rule, program, state) for rule in rules)
        except Discarded:
            return False

    def _after_init(self, before: Packed) -> list[Packed]:
        return self.machine.after_init(before)

    def _all_stopped(self, fleet: Packed) -> bool:
        return all(
            self.machine.machines[a].owns.values[fleet[place]].stopped
            for (a, _), place in zip(self.machine.units, self.machine.own_places, strict=True)
        )

    def _is_broken(self, fleet: Packed) -> bool:
        return not all(self._holds(self.machine.view(fleet, a), a) for a in range(len(self.machine.machines)))

    def _holds(self, seen: Packed, application: int) -> bool:
        """Return whether an application's invariants and state guarantees hold in a packed state of the application."""
        known = self._judged[application]
        held = known.get(seen)
        if held is None:
            broken = self.invariants[application].broken(seen) or self.guarantees[application].broken(seen)
            held = known[seen] = broken is None
        return held

    def _has_failed(self) -> bool:
        return self.machine.failure() is not None or bool(self.rounds.broken)

    def _forget_failures(self) -> None:
        self.machine.forget_failures()
        self.rounds.broken.clear()

    def _event_name(self, unit: int, event: int) -> str:
        return self.machine.machines[self.machine.units[unit][0]].program.events[event].name

    def _shown(self, run: Sequence[PackedRunState]) -> tuple[SystemRunState, ...]:
        """Return a run with states of the executable semantics."""
        return tuple([
            SystemRunState(self.machine.state(fleet, number + (event == ENVIRONMENT)), event, unit, number)
            for fleet, event, unit, number in run
        ])  # fmt: skip

    def _deadlocked(self, fleet: Packed) -> SystemViolation:
        shown = self._shown(self._run_to(fleet))
        return SystemViolation(None, DEADLOCK, 0, shown, None, "no event is ever enabled again")

    def _broken(self, run: list[PackedRunState]) -> SystemViolation:
        """Return the violation of the first invariant or state guarantee that is false in the last state of a run.

        The executable semantics decides which conjunct is false."""
        for a, machine in enumerate(self.machine.machines):
            state = self.machine.view_state(run[-1].fleet, a)
            for property_ in self.invariants[a].properties:
                if failed := failing_conjunct(property_, machine.program, state):
                    return SystemViolation(a, property_.name, property_.span.line, self._shown(run), failed, "")
            for guarantee, variable, _ in self.guarantees[a].states:
                values = {guarantee.before: _value(state, variable)}
                if failed := failing_conjunct(guarantee, machine.program, state, values):
                    return SystemViolation(a, guarantee.name, guarantee.span.line, self._shown(run), failed, "")
        raise InternalError("a compiled property is false, but all properties are true by the executable semantics")

    def _failed_init(self, before: Packed) -> SystemViolation:
        failure = self.machine.failure()
        assert failure is not None
        return self._discarded(*failure, [PackedRunState(before, "", None, 0)], 0)

    def _failed_in(self, fleet: Packed) -> SystemViolation:
        run, at = self._run_and_end(fleet)
        number = run[-1].round + 1
        self._forget_failures()
        found = self.exact.ends_with_predecessors(at)
        failure = self.machine.failure()
        if failure is None:
            return self._broken_step(self.rounds.broken[0], found, run, number)
        a, discard = failure
        machine = self.machine.machines[a]
        # an atomic event reads the writes of other instances in this round
        if machine.program.events[discard.event].lock is not None:
            bit = 1 << self.machine.units.index((a, discard.pid))
            seen = [n for n in found if self.machine.view(n[1], a)[machine.n_sys :] == discard.seen]
            node = min((n for n in seen if not n[0] & bit), key=lambda node: node[0].bit_count())
            run += self._steps_taken(found, node, number)
        return self._discarded(a, discard, run, number)

    def _broken_step(
        self, broken: BrokenStep, found: dict[Node, Predecessor | None], run: list[PackedRunState], number: int
    ) -> SystemViolation:
        """Return the violation of a step guarantee. `run`: a run to the start of the round in which it is broken."""
        a, guarantee, machine = broken.exporter, broken.guarantee, self.machine.machines[broken.exporter]
        run += self._steps_taken(found, broken.before, number)
        event = self._event_name(broken.instance, broken.event)
        run.append(PackedRunState(broken.after, event, broken.instance, number))
        old, new = (self.machine.view_state(fleet, a) for fleet in (broken.before[1], broken.after))
        variable = next(export.variable for export in machine.program.exports if guarantee in export.guarantees)
        values = {guarantee.before: _value(old, variable), guarantee.after: _value(new, variable)}
        failed = failing_conjunct(guarantee, machine.program, new, values)
        if failed is None:
            raise InternalError("a compiled guarantee is false, but it is true by the executable semantics")
        shown = failed._replace(names={**values, **failed.names})
        return SystemViolation(a, guarantee.name, guarantee.span.line, self._shown(run), shown, "")

    def _discarded(
        self, application: int, found: DiscardedEvent, run: list[PackedRunState], number: int
    ) -> SystemViolation:
        """Return the violation that a discarded event, or an event with a false loop invariant, causes.

        `number`: the number of the round in which the event runs.
        `run`: a run to the state in which the event runs."""
        unit = self.machine.units.index((application, found.pid))
        event = self._event_name(unit, found.event) if found.event >= 0 else "init"
        name, robot = self.machine.system.applications[application].name, self.machine.instances[unit].robot
        by = f"{event} of {name} on robot {robot}"
        if found.choice is None:
            reason = f"{by} has no result: {found.reason}"
            culprit = (unit, event)
            return SystemViolation(application, WELL_DEFINED, found.line, self._shown(run), None, reason, culprit)
        begun = next(each for each in reversed(run) if each.round < number or not number).fleet
        own = begun[self.machine.own_places[unit]]
        after = self.machine.applied(run[-1].fleet, unit, own, found.choice)
        run.append(PackedRunState(after, event, unit, number))
        reason = f"{found.reason} in {by}"
        return SystemViolation(application, f"{LOOP}{found.line}", found.line, self._shown(run), None, reason)


def _value(state: State, variable: str) -> Value:
    slots = state.store.slots
    return slots[variable] if variable in slots else state.store.cells[variable]
