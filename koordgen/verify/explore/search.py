"""Breadth-first search of all states that a fleet can reach, round by round.

Because of this order, the first violation that the search finds has the fewest rounds.
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
LOOP = "line "  # prefix in the name of a violated loop invariant; the number of its line follows
SHOWN = 0.25  # seconds between two progress reports


class ExplorationBounds(NamedTuple):
    """Limits of an exploration. None means that there is no limit."""

    rounds: int | None = None
    states: int | None = None
    seconds: float | None = None


class ExplorationProgress(NamedTuple):
    """Progress of an exploration.

    `depth`: number of rounds up to which all states are explored.
    `states`: number of different states at the ends of rounds.
    `waiting`: number of states in `states` whose next round is not explored yet.
    `steps`: number of program steps taken.
    `seconds`: seconds since the start of the exploration."""

    depth: int
    states: int
    waiting: int
    steps: int
    seconds: float


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


class _LimitReached(Exception):
    """Raised if the exploration reaches a limit. The message names the limit."""


class Search:
    """One exploration of a program.

    `clock`: function that returns the time in seconds.
    `show`: function that is called with the progress at intervals of more than SHOWN seconds.
    `as_agents`: explore only rounds that agents can execute. In these rounds, the order of pids matters, and the guard
        of an event can prevent all later events. So symmetry and the reduction of private states are off.

    `run` raises MissingEnvironment."""

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
        """Discard all explored states. The search then starts from the beginning."""
        idle, representative = (self.forgetting.idle, self.forgetting.own) if self.forgetting else ((), None)
        self.rounds = RoundExplorer(
            self.machine, self.independence, idle, not self.apart, representative, self.as_agents
        )
        # explorer without representatives of private states; it constructs the runs that are shown to users
        self.exact = RoundExplorer(self.machine, self.independence, idle, as_agents=self.as_agents)
        # state at the end of a round -> its predecessor at the end of the previous round
        self.known: dict[Packed, Packed | None] = {}
        # explored states within a round: after all events, before the environment's step
        self.within: set[Packed] = set()
        # State after `init` -> state before `init`.
        self.begin: dict[Packed, Packed] = {}
        # (pid, private state, own slots) -> representatives of the possible private states after the environment's step
        self._then: dict[Packed, tuple[int, ...]] = {}
        # states in which no event is enabled now, but some event can become enabled later
        self.live: set[Packed] = set()
        self.stuck = 0
        self.steps = self.depth = 0
        self.waiting = 0

    def run(self) -> ExplorationResult:
        """Explore until all states are explored, a violation is found, or a limit is reached."""
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
                return None, f"the limit of {self.depth} round{'s' * (self.depth != 1)}"
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
        """Explore one round from the state `fleet`, and append the newly found states to `following`."""
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
        """Return the representative of the state `fleet`, by symmetry and the reduction of private states."""
        return self._sorted(self.forgetting.fleet(fleet) if self.forgetting else fleet)

    def _moved(self, end: Packed) -> Iterator[Packed]:
        """Return the representatives of all states that are possible after the environment's step."""
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

    def _sorted(self, fleet: Packed) -> Packed:
        return fleet if self.apart else sorted_robots(fleet)

    def _starts(self) -> Iterator[tuple[Packed, Packed]]:
        """Yield pairs of start states: a state before `init`, and a state that is possible after `init`."""
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
        """Report the progress if a report is due, and raise _LimitReached if a limit is reached."""
        now = self.clock()
        if now > self.shown + SHOWN:
            self.shown = now
            self.show(self.progress())
        if self.bounds.seconds is not None and now - self.started > self.bounds.seconds:
            raise _LimitReached(self._bound_of_time())
        if self.bounds.states is not None and len(self.known) > self.bounds.states:
            raise _LimitReached(f"the limit of {self.bounds.states} state{'s' * (self.bounds.states != 1)}")

    def _bound_of_time(self) -> str:
        return f"the time limit of {self.bounds.seconds or 0:g} s"

    def _dead(self, fleet: Packed) -> bool:
        """Return whether the state `fleet` is a deadlock.

        In a deadlock, at least one robot has not stopped, but no event will ever be enabled, whatever the environment
        does."""
        owns = self.machine.owns.values
        if all(owns[own].stopped for own in fleet[: self.machine.n_sys]):
            return False
        seen, pending = {fleet}, [fleet]
        for state in pending:  # the loop body appends to `pending`
            if state in self.live or len(self.rounds.ends(state)) > 1 or self.machine.discards:
                # the search will discard these events again and report them, when it explores the round from `state`
                self.machine.discards.clear()
                self.live.add(fleet)
                return False
            new = [m for m in map(self.alike, self.around.moved(state)) if m not in seen]
            seen.update(new)
            pending += dict.fromkeys(new)
        return True

    def _run_to(self, fleet: Packed) -> list[RunState]:
        """Return a run to a state at the end of a round. The run consists of real states, not representatives."""
        return self._run_and_end(fleet)[0]

    def _run_and_end(self, fleet: Packed) -> tuple[list[RunState], Packed]:
        """Return a run to a state at the end of a round, and the real state in which the run ends.

        A real state is a state of the run, not the representative `fleet` that stands for it in the search."""
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
        """Append one round to a run, so that the run leads to a state with the representative `target`.

        Return the state to which the run then leads."""
        found = self.exact.ends_with_predecessors(at)
        for node in sorted(found, key=lambda node: node[0].bit_count()):
            for moved in self.around.moved(node[1]):
                if self.alike(moved) == target:
                    run_states += self._steps_taken(found, node, number)
                    if self.machine.sensors:
                        run_states.append(
                            RunState(self.machine.state(moved, number + 1), "(environment)", None, number)
                        )
                    return moved
        raise InternalError("an explored state cannot be reached from its predecessor")

    def _within(self, fleet: Packed, end: Packed) -> list[RunState]:
        """Return a run whose last round starts in `fleet` and stops before the environment's step.

        `end` represents the last state of the run."""
        run_states, at = self._run_and_end(fleet)
        number = run_states[-1].round + 1
        found = self.exact.ends_with_predecessors(at)
        node = min((n for n in found if self.alike(n[1]) == end), key=lambda node: node[0].bit_count())
        return [*run_states, *self._steps_taken(found, node, number)]

    def _steps_taken(self, found: dict[Node, Predecessor | None], node: Node, number: int) -> Iterator[RunState]:
        for pid, event, fleet in steps_to(found, node):
            yield RunState(self.machine.state(fleet, number), self.machine.program.events[event].name, pid, number)

    def _false_in(self, found: DiscardedEvent, choice: RobotStep, event: str, at: Packed, number: int) -> RunState:
        """Return the state of the run after an event in which a loop invariant is false."""
        machine = self.machine
        if found.event < 0:  # look for the state after all robots have run `init`
            after_init = next(fleet for fleet in machine.after_init(at) if fleet[found.pid] == choice.own)
            return RunState(machine.state(after_init), event, None, 0)
        return RunState(machine.state(machine.applied(at, found.pid, choice), number), event, found.pid, number)

    def _broken(self, run_states: list[RunState]) -> FoundViolation:
        """Return the violation of the first invariant that is false in the last state of a run.

        The executable semantics decides which conjunct is false."""
        program, state = self.machine.program, run_states[-1].state
        for property_ in self.invariants.properties:
            if failed := failing_conjunct(property_, program, state):
                return FoundViolation(property_.name, property_.span.line, tuple(run_states), failed, "")
        raise InternalError("a compiled invariant is false, but all invariants are true by the executable semantics")

    def _discarded_in(self, fleet: Packed) -> FoundViolation:
        """Return the violation that an event without a result causes in the round from the state `fleet`.

        `fleet` can be a representative, so the round is explored again from the real state of a run."""
        run_states, at = self._run_and_end(fleet)
        number = run_states[-1].round + 1
        self.machine.discards.clear()
        found = self.exact.ends_with_predecessors(at)
        discard, n_sys, number = self.machine.discards[0], self.machine.n_sys, run_states[-1].round + 1
        # an atomic event reads the writes of other robots in this round
        if self.machine.program.events[discard.event].lock is not None:
            there = [n for n in found if n[1][discard.pid] == discard.own and n[1][n_sys:] == discard.seen]
            node = min(there, key=lambda node: node[0].bit_count())
            run_states += self._steps_taken(found, node, number)
            at = node[1]
        return self._discarded(discard, run_states, at, number)

    def _discarded(self, found: DiscardedEvent, run_states: list[RunState], at: Packed, number: int) -> FoundViolation:
        """Return the violation that a discarded event, or an event with a false loop invariant, causes.

        `at`: the state in which the event runs.
        `number`: the number of the round in which the event runs.
        `run_states`: the run to the state `at`."""
        event = self.machine.program.events[found.event].name if found.event >= 0 else "init"
        if found.choice is not None:
            run_states.append(self._false_in(found, found.choice, event, at, number))
            reason = f"{found.reason} in {event} of robot {found.pid}"
            return FoundViolation(f"{LOOP}{found.line}", found.line, tuple(run_states), None, reason)
        reason = f"{event} of robot {found.pid} has no result: {found.reason}"
        culprit = RunState(run_states[-1].state, event, found.pid, number)
        return FoundViolation(WELL_DEFINED, found.line, tuple(run_states), None, reason, culprit)
