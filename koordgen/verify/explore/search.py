"""Breadth-first search of the state space, round by round.

So the first violation that is found has the fewest rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl
from koordgen.lang.semantics.deadline import OutOfTime
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.step import initial
from koordgen.verify.explore.environment import EnvironmentSteps
from koordgen.verify.explore.invariants import Invariants
from koordgen.verify.explore.machine import DiscardedEvent, Machine, Packed, RobotStep
from koordgen.verify.explore.reduction import StateReduction, VariableRead
from koordgen.verify.explore.rounds import Node, Predecessor, RoundExplorer, steps_to
from koordgen.verify.explore.symmetry import asymmetry, sorted_robots
from koordgen.verify.prove.report.model import Conjunct, failing_conjunct
from koordgen.verify.prove.report.reach import RunState

WELL_DEFINED, DEADLOCK = "(well-defined)", "(deadlock)"
LOOP = "line "  # prefix of the name of a loop invariant, followed by its line
SHOWN = 0.25  # seconds between two reports of the progress


class ExplorationBounds(NamedTuple):
    """Limits of an exploration; None: no limit."""

    rounds: int | None = None
    states: int | None = None
    seconds: float | None = None


class ExplorationProgress(NamedTuple):
    """Progress of an exploration.

    `depth`: number of rounds up to which all states are explored.
    `states`: number of different states at the ends of rounds.
    `waiting`: number of these states whose next round is not explored yet.
    `steps`: number of program steps taken.
    `seconds`: time spent."""

    depth: int
    states: int
    waiting: int
    steps: int
    seconds: float


class FoundViolation(NamedTuple):
    """Violation with the run that leads to it.

    `name`: the violated property: an invariant, LOOP with a line, WELL_DEFINED or DEADLOCK.
    `failed`: the conjunct of an invariant that is false in the last state; None for other violations.
    `reason`: explains the violation if `failed` is None.
    `culprit`: the event (or `init`) that would come next but has no result, if this is the violation.
    `of_agents`: whether agents can execute each round (`is_order_of_agents`).
    `shortest`: number of rounds of the shortest run in the language, if agents need more rounds."""

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
    `unchecked`: invariants that cannot be evaluated.
    `apart`: the reason why symmetry is not used; empty if it is used.
    `forgotten`: local variables that are removed from states because no event reads them."""

    violation: FoundViolation | None
    progress: ExplorationProgress
    stopped: str
    unseen: tuple[decl.Event, ...]
    unchecked: tuple[str, ...]
    apart: str
    forgotten: tuple[str, ...]


class _Restart(Exception):
    """Raised to restart the search with fewer reductions."""


class _LimitReached(Exception):
    """Raised if a limit is reached; the message names the limit."""


class Search:
    """One exploration.

    `clock`: returns the time in seconds.
    `show`: receives the progress from time to time.
    `as_agents`: explore only rounds that agents can execute. The order of pids then makes a difference, and the guard
        of every event can prevent later ones, so neither symmetry nor the reduction of private states is used. `run`
        raises MissingEnvironment."""

    def __init__(
        self, machine: Machine, around: EnvironmentSteps, bounds: ExplorationBounds, clock: Callable[[], float],
        show: Callable[[ExplorationProgress], None], symmetry: bool = True, independence: bool = True,
        deadlock: bool = True, forgetting: bool = True, as_agents: bool = False,
    ) -> None:  # fmt: skip
        self.machine, self.around, self.bounds, self.clock, self.show = machine, around, bounds, clock, show
        self.invariants = Invariants(machine)
        alike = symmetry and not as_agents
        self.apart = (around.apart or asymmetry(machine.program)) if alike else "it is switched off"
        self.independence, self.deadlock, self.as_agents = independence, deadlock, as_agents
        self.forgetting = StateReduction(machine) if forgetting and not as_agents else None
        self._fresh()

    def _fresh(self) -> None:
        """Discard everything that was explored, before the search starts or restarts."""
        idle, representative = (self.forgetting.idle, self.forgetting.own) if self.forgetting else ((), None)
        self.rounds = RoundExplorer(
            self.machine, self.independence, idle, not self.apart, representative, self.as_agents
        )
        # explorer without reductions, used to construct the runs that are shown
        self.exact = RoundExplorer(self.machine, self.independence, idle, as_agents=self.as_agents)
        # state at the end of a round -> its predecessor at the end of the previous round
        self.known: dict[Packed, Packed | None] = {}
        # states after a round's events, before the environment's step, that were explored
        self.within: set[Packed] = set()
        self.begin: dict[Packed, Packed] = {}  # state after `init` -> the state before `init`
        # private states -> their representatives after the environment's step
        self._then: dict[Packed, tuple[int, ...]] = {}
        self.live: set[Packed] = set()  # states without an enabled event from which some event can become enabled later
        self.stuck = 0
        self.steps = self.depth = 0
        self.waiting = 0

    def run(self) -> ExplorationResult:
        """Explore until everything is explored, a violation is found, or a limit is reached."""
        self.started = self.shown = self.clock()
        violation, stopped = None, ""
        try:
            violation, stopped = self._settled()
        except _LimitReached as over:
            stopped = str(over)
        except OutOfTime:  # the time limit was reached within one event or one round
            stopped = self._bound_of_time()
        except KeyboardInterrupt:
            stopped = "interrupted"
        if not violation and not stopped and self.stuck:
            stopped = f"the assumptions leave sensors no value in {self.stuck} states"
        unseen = [e for i, e in enumerate(self.machine.program.events) if i not in self.machine.enabled]
        forgotten = self.forgetting.locals if self.forgetting else ()
        unchecked = self.invariants.unchecked
        return ExplorationResult(violation, self.progress(), stopped, tuple(unseen), unchecked, self.apart, forgotten)

    def _settled(self) -> tuple[FoundViolation | None, str]:
        """Repeat the search with fewer reductions until no reduction proves wrong."""
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

    def progress(self) -> ExplorationProgress:
        return ExplorationProgress(self.depth, len(self.known), self.waiting, self.steps, self.clock() - self.started)

    def _explored(self) -> tuple[FoundViolation | None, str]:
        layer: list[Packed] = []
        for before, after in self._starts():
            alike = self.alike(after)
            if self.machine.discards:
                run_states = [RunState(self.machine.state(before, 0), "", None, 0)]
                return self._discarded(self.machine.discards[0], run_states, before, 0), ""
            if alike not in self.begin:
                self.begin[alike], self.known[alike] = before, None
                layer.append(alike)
                if self.invariants.broken(after):
                    return self._broken(self._run_to(alike)), ""
            self._look()
        if not layer:
            return None, "no state satisfies `initially`"
        while layer:
            if self.depth == self.bounds.rounds:
                return None, f"the bound of {self.depth} round{'s' * (self.depth != 1)}"
            following: list[Packed] = []
            for number, fleet in enumerate(layer):
                self.waiting = len(layer) - number + len(following)
                self._look()
                if violation := self._round(fleet, following):
                    return violation, ""
            layer = following
            self.depth += 1
        self.waiting = 0
        return None, ""

    def _round(self, fleet: Packed, following: list[Packed]) -> FoundViolation | None:
        """Explore one round from one state, and append new states to `following`."""
        found = self.rounds.ends(fleet)
        self.steps += len(found) - 1
        if self.machine.discards:
            return self._discarded_in(fleet)
        if self.deadlock and len(found) == 1 and self._dead(fleet):
            if self.forgetting:
                raise _Restart
            return FoundViolation(DEADLOCK, 0, tuple(self._run_to(fleet)), None, "no event is ever enabled again")
        for _, fleet_then in found:
            end = self._sorted(fleet_then)
            if end in self.within:
                continue
            self.within.add(end)
            if self.machine.sensors and self.invariants.broken(end):
                return self._broken(self._within(fleet, end))
            moves = 0
            for moved in self._moved(end):
                moves += 1
                alike = self._sorted(moved)
                if alike not in self.known:
                    self.known[alike] = fleet
                    following.append(alike)
                    if self.invariants.broken(alike):
                        return self._broken(self._run_to(alike))
            self.stuck += not moves
            self._look()
        return None

    def alike(self, fleet: Packed) -> Packed:
        """Return the fleet that represents the given fleet under symmetry and reduction."""
        return self._sorted(self.forgetting.fleet(fleet) if self.forgetting else fleet)

    def _moved(self, end: Packed) -> Iterator[Packed]:
        """Return the representatives of the fleets after the environment's step."""
        if self.forgetting is None or not self.machine.sensors:
            return self.around.moved(end)
        n_sys, seen = self.machine.n_sys, end[self.machine.n_sys :]
        return (owns + seen for owns in product(*[self._stands_then(pid, end[pid], seen) for pid in range(n_sys)]))

    def _stands_then(self, pid: int, own: int, seen: Packed) -> tuple[int, ...]:
        key = (pid, own, seen[pid])
        found = self._then.get(key)
        if found is None:
            assert self.forgetting is not None
            then = [self.forgetting.own(pid, new, seen) for new in self.around.moves(pid, own)]
            found = self._then[key] = tuple(dict.fromkeys(then))
        return found

    def _sorted(self, fleet: Packed) -> Packed:
        return fleet if self.apart else sorted_robots(fleet)

    def _starts(self) -> Iterator[tuple[Packed, Packed]]:
        """Yield pairs of a fleet before `init` and one after it."""
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

    def _look(self) -> None:
        """Report the progress if a report is due. Raises _LimitReached."""
        now = self.clock()
        if now > self.shown + SHOWN:
            self.shown = now
            self.show(self.progress())
        if self.bounds.seconds is not None and now - self.started > self.bounds.seconds:
            raise _LimitReached(self._bound_of_time())
        if self.bounds.states is not None and len(self.known) > self.bounds.states:
            raise _LimitReached(f"the bound of {self.bounds.states} state{'s' * (self.bounds.states != 1)}")

    def _bound_of_time(self) -> str:
        return f"the bound of {self.bounds.seconds or 0:g} s"

    def _dead(self, fleet: Packed) -> bool:
        """Return whether the fleet is deadlocked.

        A fleet is deadlocked if some robot has not stopped, but no event will ever be enabled, whatever the environment
        does."""
        owns = self.machine.owns.values
        if all(owns[own].stopped for own in fleet[: self.machine.n_sys]):
            return False
        seen, pending = {fleet}, [fleet]
        for state in pending:  # the loop itself appends to this list
            if state in self.live or len(self.rounds.ends(state)) > 1 or self.machine.discards:
                # these events are discarded again, and reported, when the round of this state is explored
                self.machine.discards.clear()
                self.live.add(fleet)
                return False
            new = [m for m in map(self.alike, self.around.moved(state)) if m not in seen]
            seen.update(new)
            pending += dict.fromkeys(new)
        return True

    def _run_to(self, fleet: Packed) -> list[RunState]:
        """Return a run to a state at the end of a round. Its states are real fleets, not representatives."""
        return self._way_to(fleet)[0]

    def _way_to(self, fleet: Packed) -> tuple[list[RunState], Packed]:
        """Return a run to a state at the end of a round, and the fleet in which this run ends.

        Representatives are replaced by real fleets."""
        chain = [fleet]
        while (parent := self.known[chain[-1]]) is not None:
            chain.append(parent)
        before = self.begin[chain[-1]]
        at = next(after for after in self.machine.after_init(before) if self.alike(after) == chain[-1])
        run_states = [
            RunState(self.machine.state(before, 0), "", None, 0),
            RunState(self.machine.state(at), "init", None, 0),
        ]
        for number, target in enumerate(reversed(chain[:-1]), 1):
            at = self._step_to(run_states, at, target, number)
        return run_states, at

    def _step_to(self, run_states: list[RunState], at: Packed, target: Packed, number: int) -> Packed:
        """Append one round to a run, so that it leads to a fleet with the representative `target`.

        Return this fleet."""
        found = self.exact.ends_with_predecessors(at)
        for node in sorted(found, key=lambda node: node[0].bit_count()):
            for moved in self.around.moved(node[1]):
                if self.alike(moved) == target:
                    run_states += self._taken(found, node, number)
                    if self.machine.sensors:
                        run_states.append(
                            RunState(self.machine.state(moved, number + 1), "(environment)", None, number)
                        )
                    return moved
        raise InternalError("an explored state cannot be reached from its predecessor")

    def _within(self, fleet: Packed, end: Packed) -> list[RunState]:
        """Return a run that ends after the events of the round from `fleet`, in a fleet represented by `end`."""
        run_states, at = self._way_to(fleet)
        number = run_states[-1].round + 1
        found = self.exact.ends_with_predecessors(at)
        node = min((n for n in found if self.alike(n[1]) == end), key=lambda node: node[0].bit_count())
        return [*run_states, *self._taken(found, node, number)]

    def _taken(self, found: dict[Node, Predecessor | None], node: Node, number: int) -> Iterator[RunState]:
        for pid, event, fleet in steps_to(found, node):
            yield RunState(self.machine.state(fleet, number), self.machine.program.events[event].name, pid, number)

    def _false_in(self, found: DiscardedEvent, choice: RobotStep, event: str, at: Packed, number: int) -> RunState:
        """Return the state after an event in which a loop invariant is false."""
        machine = self.machine
        if found.event < 0:  # all other robots run `init` as well
            after_init = next(fleet for fleet in machine.after_init(at) if fleet[found.pid] == choice.own)
            return RunState(machine.state(after_init), event, None, 0)
        return RunState(machine.state(machine.applied(at, found.pid, choice), number), event, found.pid, number)

    def _broken(self, run_states: list[RunState]) -> FoundViolation:
        """Return the violation of the invariant that is false in the last state of a run.

        The executable semantics decides which conjunct is false."""
        program, state = self.machine.program, run_states[-1].state
        for property_ in self.invariants.properties:
            if failed := failing_conjunct(property_, program, state):
                return FoundViolation(property_.name, property_.span.line, tuple(run_states), failed, "")
        raise InternalError("an invariant is false as compiled, and true by the executable semantics")

    def _discarded_in(self, fleet: Packed) -> FoundViolation:
        """Return the violation for an event without a result, in a round from `fleet`.

        The round is explored again from a real fleet, not a representative."""
        run_states, at = self._way_to(fleet)
        number = run_states[-1].round + 1
        self.machine.discards.clear()
        found = self.exact.ends_with_predecessors(at)
        discard, n_sys, number = self.machine.discards[0], self.machine.n_sys, run_states[-1].round + 1
        # an atomic event reads what other robots wrote in this round
        if self.machine.program.events[discard.event].lock is not None:
            there = [n for n in found if n[1][discard.pid] == discard.own and n[1][n_sys:] == discard.seen]
            node = min(there, key=lambda node: node[0].bit_count())
            run_states += self._taken(found, node, number)
            at = node[1]
        return self._discarded(discard, run_states, at, number)

    def _discarded(self, found: DiscardedEvent, run_states: list[RunState], at: Packed, number: int) -> FoundViolation:
        """Return the violation for a discarded event, or one with a false loop invariant.

        `at`: the fleet in which the event runs.
        `number`: the round.
        `run_states`: the run to this round."""
        event = self.machine.program.events[found.event].name if found.event >= 0 else "init"
        if found.choice is not None:
            run_states.append(self._false_in(found, found.choice, event, at, number))
            reason = f"{found.reason} in {event} of robot {found.pid}"
            return FoundViolation(f"{LOOP}{found.line}", found.line, tuple(run_states), None, reason)
        reason = f"{event} of robot {found.pid} has no result: {found.reason}"
        culprit = RunState(run_states[-1].state, event, found.pid, number)
        return FoundViolation(WELL_DEFINED, found.line, tuple(run_states), None, reason, culprit)
