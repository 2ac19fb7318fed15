"""Exploration of one program: properties, reductions, and the description of a violation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.step import initial
from koordgen.verify.explore.breadth_first import (
    BreadthFirstSearch,
    ExplorationBounds,
    ExplorationProgress,
    PackedRunState,
)
from koordgen.verify.explore.environment import EnvironmentSteps
from koordgen.verify.explore.invariants import Invariants
from koordgen.verify.explore.machine import DiscardedEvent, Machine, Packed, RobotStep
from koordgen.verify.explore.reduction import StateReduction, VariableRead
from koordgen.verify.explore.rounds import RoundExplorer
from koordgen.verify.explore.symmetry import asymmetry, sorted_robots
from koordgen.verify.prove.report.model import Conjunct, failing_conjunct
from koordgen.verify.prove.report.reach import ENVIRONMENT, RunState

WELL_DEFINED, DEADLOCK = "(well-defined)", "(deadlock)"
LOOP = "line "  # prefix in the name of a violated loop invariant; the number of its line follows


class FoundViolation(NamedTuple):
    """Violation of a property, with a run that leads to the violation.

    `name`: the violated property: the name of an invariant, LOOP with a line, WELL_DEFINED or DEADLOCK.
    `failed`: the conjunct of the invariant that is false in the last state; None if no invariant is violated.
    `reason`: explanation of the violation if `failed` is None.
    `culprit`: the event (or `init`) without a result, in the state in which it runs; None for other violations.
    `of_agents`: whether agents can execute every round of the run (`is_order_of_agents` of the semantics).
    `shortest`: number of rounds of the shortest run that the language allows; None if `run_states` is this short."""

    name: str
    line: int
    run_states: tuple[RunState, ...]
    failed: Conjunct | None
    reason: str
    culprit: RunState | None = None
    of_agents: bool = True
    shortest: int | None = None


class ExplorationResult(NamedTuple):
    """Result of an exploration.

    `stopped`: the reason why the exploration ended early; empty if everything was explored.
    `unseen`: events that were never enabled.
    `unchecked`: names of the invariants that cannot be evaluated.
    `apart`: the reason why the symmetry reduction is off; empty if the reduction is on.
    `forgotten`: names of the local variables that are removed from states because no event reads them."""

    violation: FoundViolation | None
    progress: ExplorationProgress
    stopped: str
    unseen: tuple[decl.Event, ...]
    unchecked: tuple[str, ...]
    apart: str
    forgotten: tuple[str, ...]


class _Restart(Exception):
    """Raised to restart the search without the reduction of private states."""


class Search(BreadthFirstSearch[FoundViolation]):
    """One exploration of a program.

    `as_agents`: explore only rounds that agents can execute. In these rounds, the order of pids matters, and the guard
        of an event can prevent all later events. So symmetry and the reduction of private states are off.

    `run` raises MissingEnvironment."""

    around: EnvironmentSteps

    def __init__(
        self, machine: Machine, around: EnvironmentSteps, bounds: ExplorationBounds, clock: Callable[[], float],
        show: Callable[[ExplorationProgress], None], symmetry: bool = True, independence: bool = True,
        deadlock: bool = True, forgetting: bool = True, as_agents: bool = False,
    ) -> None:  # fmt: skip
        self.machine = machine
        self.invariants = Invariants(machine)
        alike = symmetry and not as_agents
        self.apart = (around.apart or asymmetry(machine.program)) if alike else "it is switched off"
        self.independence, self.as_agents = independence, as_agents
        self.forgetting = StateReduction(machine) if forgetting and not as_agents else None
        super().__init__(around, bool(machine.sensors), bounds, clock, show, deadlock)

    def _fresh(self) -> None:
        super()._fresh()
        idle, representative = (self.forgetting.idle, self.forgetting.own) if self.forgetting else ((), None)
        self.rounds = RoundExplorer(
            self.machine, self.independence, idle, not self.apart, representative, self.as_agents
        )
        # explorer without representatives of private states
        self.exact = RoundExplorer(self.machine, self.independence, idle, as_agents=self.as_agents)
        # (pid, private state, own slots) -> representatives of the possible private states after the environment's step
        self._then: dict[Packed, tuple[int, ...]] = {}

    def run(self) -> ExplorationResult:
        """Explore until all states are explored, a violation is found, or a limit is reached."""
        violation, stopped = self._found()
        unseen = [e for i, e in enumerate(self.machine.program.events) if i not in self.machine.enabled]
        forgotten = self.forgetting.locals if self.forgetting else ()
        unchecked = self.invariants.unchecked
        return ExplorationResult(violation, self.progress(), stopped, tuple(unseen), unchecked, self.apart, forgotten)

    def _settled(self) -> tuple[FoundViolation | None, str]:
        """Run the search, and repeat it with fewer reductions whenever a reduction does not apply."""
        while True:
            try:
                return self._explored()
            except VariableRead as read:
                assert self.forgetting is not None
                self.forgetting.keep(read.name)
            except _Restart:
                self.machine.watch({})
                self.forgetting = None
            self.machine.discards.clear()
            self._fresh()

    def alike(self, fleet: Packed) -> Packed:
        """Return the representative of the state `fleet`, by symmetry and the reduction of private states."""
        return self._sorted(self.forgetting.fleet(fleet) if self.forgetting else fleet)

    def _sorted(self, fleet: Packed) -> Packed:
        return fleet if self.apart else sorted_robots(fleet)

    def _moved(self, end: Packed) -> Iterator[Packed]:
        if self.forgetting is None or not self.machine.sensors:
            return self.around.moved(end)
        n_sys, seen = self.machine.n_sys, end[self.machine.n_sys :]
        return (owns + seen for owns in product(*[self._moved_robot(pid, end[pid], seen) for pid in range(n_sys)]))

    def _moved_robot(self, pid: int, own: int, seen: Packed) -> tuple[int, ...]:
        key = (pid, own, seen[pid])
        found = self._then.get(key)
        if found is None:
            assert self.forgetting is not None
            then = [self.forgetting.own(pid, new, seen) for new in self.around.moves(pid, own)]
            found = self._then[key] = tuple(dict.fromkeys(then))
        return found

    def _starts(self) -> Iterator[tuple[Packed, Packed]]:
        program, machine = self.machine.program, self.machine
        rules = [p for p in program.properties if p.kind == "initially"]
        for sensors in self.around.starts():
            state = initial(program, machine.n_sys, sensors)
            try:
                allowed = all(holds_property(rule, program, state) for rule in rules)
            except Discarded:
                allowed = False
            if allowed:
                before = machine.packed(state)
                after_init = machine.after_init(before)
                yield from [(before, after) for after in after_init] if not machine.discards else [(before, before)]

    def _after_init(self, before: Packed) -> list[Packed]:
        return self.machine.after_init(before)

    def _all_stopped(self, fleet: Packed) -> bool:
        owns = self.machine.owns.values
        return all(owns[own].stopped for own in fleet[: self.machine.n_sys])

    def _is_broken(self, fleet: Packed) -> bool:
        return self.invariants.broken(fleet) is not None

    def _has_failed(self) -> bool:
        return bool(self.machine.discards)

    def _forget_failures(self) -> None:
        self.machine.discards.clear()

    def _event_name(self, unit: int, event: int) -> str:
        return self.machine.program.events[event].name

    def _deadlocked(self, fleet: Packed) -> FoundViolation:
        if self.forgetting:
            raise _Restart
        return FoundViolation(DEADLOCK, 0, self.run_to(fleet), None, "no event is ever enabled again")

    def run_to(self, fleet: Packed) -> tuple[RunState, ...]:
        """Return a run to a state at the end of a round, with states of the executable semantics."""
        return self._shown(self._run_to(fleet))

    def _shown(self, run: Sequence[PackedRunState]) -> tuple[RunState, ...]:
        """Return a run with states of the executable semantics."""
        return tuple([
            RunState(self.machine.state(fleet, number + (event == ENVIRONMENT)), event, pid, number)
            for fleet, event, pid, number in run
        ])  # fmt: skip

    def _broken(self, run: list[PackedRunState]) -> FoundViolation:
        """Return the violation of the first invariant that is false in the last state of a run.

        The executable semantics decides which conjunct is false."""
        run_states = self._shown(run)
        for property_ in self.invariants.properties:
            if failed := failing_conjunct(property_, self.machine.program, run_states[-1].state):
                return FoundViolation(property_.name, property_.span.line, run_states, failed, "")
        raise InternalError("a compiled invariant is false, but all invariants are true by the executable semantics")

    def _failed_init(self, before: Packed) -> FoundViolation:
        return self._discarded(self.machine.discards[0], [PackedRunState(before, "", None, 0)], 0)

    def _failed_in(self, fleet: Packed) -> FoundViolation:
        """Return the violation that an event without a result causes in the round from the state `fleet`.

        `fleet` can be a representative, so the round is explored again from the real state of a run."""
        run, at = self._run_and_end(fleet)
        number = run[-1].round + 1
        self.machine.discards.clear()
        found = self.exact.ends_with_predecessors(at)
        discard, n_sys = self.machine.discards[0], self.machine.n_sys
        # an atomic event reads the writes of other robots in this round
        if self.machine.program.events[discard.event].lock is not None:
            there = [n for n in found if n[1][discard.pid] == discard.own and n[1][n_sys:] == discard.seen]
            node = min(there, key=lambda node: node[0].bit_count())
            run += self._steps_taken(found, node, number)
        return self._discarded(discard, run, number)

    def _discarded(self, found: DiscardedEvent, run: list[PackedRunState], number: int) -> FoundViolation:
        """Return the violation that a discarded event, or an event with a false loop invariant, causes.

        `number`: the number of the round in which the event runs.
        `run`: a run to the state in which the event runs."""
        event = self.machine.program.events[found.event].name if found.event >= 0 else "init"
        if found.choice is not None:
            run_states = self._shown([*run, self._false_in(found, found.choice, event, run[-1].fleet, number)])
            reason = f"{found.reason} in {event} of robot {found.pid}"
            return FoundViolation(f"{LOOP}{found.line}", found.line, run_states, None, reason)
        reason = f"{event} of robot {found.pid} has no result: {found.reason}"
        run_states = self._shown(run)
        culprit = RunState(run_states[-1].state, event, found.pid, number)
        return FoundViolation(WELL_DEFINED, found.line, run_states, None, reason, culprit)

    def _false_in(
        self, found: DiscardedEvent, choice: RobotStep, event: str, at: Packed, number: int
    ) -> PackedRunState:
        """Return the state of the run after an event in which a loop invariant is false."""
        machine = self.machine
        if found.event < 0:  # look for the state after all robots have run `init`
            after_init = next(fleet for fleet in machine.after_init(at) if fleet[found.pid] == choice.own)
            return PackedRunState(after_init, event, None, 0)
        return PackedRunState(machine.applied(at, found.pid, choice), event, found.pid, number)
