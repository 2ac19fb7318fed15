"""Attack on PROVED invariants within a time budget: chooses states, runs steps from them, and reports the result.

The attack begins with initial states, `init` and the first events of each robot. They are cheap to get and likely to
reveal a mistake. Then the attack uses three sources of states, each for an equal share of time:

- random walks, which begin in states after `init`;
- states from the solver's models; one round is run from each state in every order of events;
- variations of known states, with a few variables changed.

A program and a seed determine the sequence of states. The budget limits how many states are used.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import nullcontext
from itertools import cycle
from random import Random
from typing import TYPE_CHECKING, Any, NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics.deadline import Deadline, OutOfTime, ends
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact, exact
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial
from koordgen.lang.semantics.values import Value
from koordgen.verify.attack.judge import (
    COMMANDS,
    ENVIRONMENT,
    INIT,
    Act,
    Contradiction,
    Trial,
    TrialJudge,
    TrialNotCovered,
    UnusableStep,
    VerdictBreach,
    key_of,
)
from koordgen.verify.attack.models import Models
from koordgen.verify.attack.states import States

if TYPE_CHECKING:
    from koordgen.verify.prove.smt.solve import CrossCheck, Solver

SECONDS = 0.05  # default time budget of an attack, in seconds
FLEETS = (1, 2, 3, 4)  # fleet sizes to attack, if the user gives no number of robots
STARTS = 2  # number of initial states of each fleet size with which the attack begins
TRIES = 12  # largest number of attempts to draw one initial state
ROUNDS = 6  # length of one random walk, in rounds
ORDERS = 150  # largest number of events that are run from one state of the solver
VARIED_ORDERS = 8  # largest number of events that are run from one variation of a known state
MODEL_RUNS = 60  # estimate: the number of event runs that one state from the solver makes possible
SKIPS = 0.15  # probability that a robot runs no event in a round of a random walk
COMMANDED = 0.3  # probability that commands are written before a robot's event in a random walk
STALE = 400  # the attack ends after STALE attempts, to find a state or to run a step, without a new state
FIRST = 0.4  # largest share of the time budget for initial states and first events

Clock = Callable[[], float]


class AttackReport(NamedTuple):
    """Result of an attack on PROVED invariants.

    `states`: (step, invariant) -> number of states in which the invariant was evaluated after the step. A step is an
        event's name, "init" or "(environment)".
    `reasons`: (step, invariant) -> the reason why the invariant was evaluated in no state. An empty name stands for
        all steps or all invariants.
    `contradiction`: None if no PROVED invariant was contradicted.
    `seconds`: time used, on the clock of the attack."""

    states: Mapping[tuple[str, str], int]
    reasons: Mapping[tuple[str, str], str]
    contradiction: Contradiction | None
    seconds: float

    def of(self, step: str, invariant: str) -> tuple[int, str]:
        """Return the number of states in which an invariant was evaluated after a step, and a reason.

        If the number is 0, the reason says why; otherwise it is ""."""
        count = self.states.get((step, invariant), 0)
        if count:
            return count, ""
        found = self.reasons.get((step, invariant)) or self.reasons.get((step, "")) or self.reasons.get(("", ""))
        return 0, found or "no state was found from which the step can be run"


class BudgetSpent(Exception):
    """Raised to end an attack, if the time budget is used up or no new states are found."""


class ContradictionFound(Exception):
    """Raised if the state after a step contradicts the verdict PROVED of an invariant."""

    def __init__(self, contradiction: Contradiction) -> None:
        super().__init__(contradiction.breach.why)
        self.contradiction = contradiction


class RunPoint(NamedTuple):
    """Position of the attack within a run of the program.

    `first`: first state of the run.
    `start`: state at the start of the present round.
    `now`: present state.
    `turns`: pids of the robots that have run an event in the present round.
    `acts`: all steps from `first` to `now`."""

    first: State
    start: State
    now: State
    turns: frozenset[int]
    acts: tuple[Act, ...]

    def then(self, act: Act, now: State) -> RunPoint:
        """Return the point of the run after the step `act`, which leads to the state `now`.

        A step of the environment, or `init`, ends the present round. Commands do not."""
        acts = (*self.acts, act)
        if act.event == COMMANDS:
            return RunPoint(self.first, self.start, now, self.turns, acts)
        if act.pid is None:
            return RunPoint(self.first, now, now, frozenset(), acts)
        return RunPoint(self.first, self.start, now, self.turns | {act.pid}, acts)


def beginning(state: State) -> RunPoint:
    """Return the first point of a run. `state`: a state before `init`, or at the start of a round."""
    return RunPoint(state, state, state, frozenset(), ())


def attack(
    program: decl.Program, proved: Collection[str], robots: int | None = None,
    params: Mapping[str, ir.Expr] | None = None, solver: Solver | CrossCheck | None = None, seconds: float = SECONDS,
    clock: Clock = time.process_time, seed: int = 0,
) -> AttackReport:  # fmt: skip
    """Search for a state that contradicts a PROVED invariant or "(well-defined)".

    `proved`: names of the PROVED invariants.
    `robots`: number of robots in the fleet; None to attack fleets of 1 to 4 robots.
    `params`: values of params that are fixed; all other params may have any value.
    `solver`: SMT solver that provides states; None to attack without a solver.
    `seconds`: time budget on `clock`.
    `clock`: by default CPU time, to which the time spent waiting for the solver is added. Another clock is used as it
        is.
    `seed`: seed of all random choices."""
    began = clock()
    if robots is not None and robots > FLEETS[-1]:
        return _none(f"only fleets of at most {FLEETS[-1]} robots are attacked")
    if not proved:
        return _none("nothing is PROVED")
    search = _AttackSearch(program, proved, robots, dict(params or {}), solver, began + seconds, clock, seed)
    found = search.run()
    reasons = {("", ""): f"the budget of {1000 * seconds:g} ms was used up before"} if search.spent else {}
    reasons.update(search.judge.reasons)
    return AttackReport(dict(search.judge.counts), reasons, found, search.clock() - began)


def _none(why: str) -> AttackReport:
    return AttackReport({}, {("", ""): why}, None, 0.0)


def runnable(program: decl.Program) -> tuple[decl.Program, bool]:
    """Return the program with exact numbers, and whether an initial value of a variable contains a GridMap.

    A GridMap has no exact form. Initial values with a GridMap are computed with floats, as on robots, and with the
    values of params that the program has."""
    variables: list[decl.Local | decl.Shared] = [*program.locals, *program.shared]
    rounded = {v.name for v in variables if any(_is_map(n) for n in walk(v.initial))}
    made = exact(program)
    if not rounded:
        return made, False
    first = initial(program, 1)
    values = {**first.robots[0].locals, **first.store.cells, **{n: v[0] for n, v in first.store.slots.items()}}

    def known(variable: decl.Local | decl.Shared) -> ir.Expr:
        # The semantics does not check the type of a constant, so `Const` can hold any value.
        value: Any = values[variable.name]
        given = ir.Const(value, variable.type, variable.span)
        return given if variable.name in rounded else variable.initial

    locals_ = tuple([replace(v, initial=known(v)) for v in made.locals])
    shared = tuple([replace(v, initial=known(v)) for v in made.shared])
    return replace(made, locals=locals_, shared=shared), True


def _is_map(node: Node) -> bool:
    return isinstance(node, ir.Builtin) and node.name == "GridMap"


class _AttackSearch:
    def __init__(
        self, program: decl.Program, proved: Collection[str], robots: int | None, params: dict[str, ir.Expr],
        solver: Solver | CrossCheck | None, until: float, clock: Clock, seed: int,
    ) -> None:  # fmt: skip
        given = tuple([replace(p, default=params[p.name]) if p.name in params else p for p in program.params])
        kept = tuple([p for p in program.properties if p.kind != "invariant" or p.name in proved])
        self.program = replace(program, params=given, properties=kept)
        self.exact, rounded = runnable(self.program)
        self.random = Random(seed)
        free = [] if rounded else [p.name for p in program.params if p.name not in params]
        self.states = States(self.exact, free, self.random)
        types = {v.name: v.type for v in self.exact.shared}
        self.commands = {name: types[name] for name in sorted(decl.commanded(self.exact))}
        self.proved = proved
        self.judge = TrialJudge(self.exact, proved, self.states.answers)
        self.fleets = FLEETS if robots is None else (robots,)
        self.params, self.solver, self.until = params, solver, until
        self.computing, self.timed = clock, clock is time.process_time
        self.waited = 0.0  # seconds spent waiting for the solver
        self.ready: list[RunPoint] = []  # points of runs directly after `init`
        self.known: list[State] = []  # states at the start of a round, from which variations are made
        self.seen: set[tuple[object, ...]] = set()
        self.launched: dict[int, int] = {}
        self.runs: dict[str, int] = {}  # event name -> number of runs of the event
        self.tried: dict[str, int] = {}  # step -> estimated number of its runs from states that the solver found
        self.spent = False
        self.units = 0
        # (number of judged states, number of units of work) when the attack last found a new state
        self.last_found = 0, 0

    def clock(self) -> float:
        return self.computing() + self.waited

    def run(self) -> Contradiction | None:
        began = self.clock()
        try:
            with ends(Deadline(self.clock, self.until)) if self.timed else nullcontext():
                for _ in self.first():
                    if self.clock() > began + FIRST * (self.until - began):
                        break
                self.alternate()
        except BudgetSpent:
            pass
        except OutOfTime:
            self.spent = True
        except ContradictionFound as found:
            return self.confirmed(found.contradiction)
        return None

    def confirmed(self, found: Contradiction) -> Contradiction:
        """Run the trial of a contradiction a second time, from its first state, with a new judge.

        Return the contradiction of the second run. Raises InternalError if the second run shows no contradiction."""
        why = "the second run shows no contradiction"
        try:
            again = TrialJudge(self.exact, self.proved, self.states.answers).replay(found.trial).contradiction
            if again is not None:
                return again
        except (TrialNotCovered, UnusableStep) as error:
            why = str(error)
        raise InternalError(f"the attack cannot repeat its contradiction of {found.breach.invariant}: {why}")

    def alternate(self) -> None:
        """Take states from all sources, each for an equal share of time, until the time budget is used up."""
        sources = [self.walks(), self.varied()] + ([self.modelled()] if self.solver is not None else [])
        used = [0.0] * len(sources)
        while sources:
            place = used.index(min(used))
            before = self.clock()
            try:
                next(sources[place])
            except StopIteration:
                del sources[place], used[place]
                continue
            used[place] += self.clock() - before
            self.unit()

    def unit(self) -> None:
        """Count one unit of work: an attempt to find a state or to run a step.

        Raises BudgetSpent if the time budget is used up, or if the last STALE units found no new state."""
        if len(self.judge.known) > self.last_found[0]:
            self.last_found = len(self.judge.known), self.units
        self.units += 1
        self.spent = self.clock() > self.until
        if self.spent or self.units - self.last_found[1] > STALE:
            raise BudgetSpent

    # Attack of initial states and first rounds

    def first(self) -> Iterator[None]:
        """Attack STARTS initial states of each fleet size.

        From each initial state, run `init`. Then run each possible event of a single robot, followed by a step of the
        environment, and one random walk."""
        for robots in self.fleets:
            for _ in range(STARTS):
                place = self.launch(robots)
                if place is not None:
                    yield from self.once(place)
                    yield from self.walk(place)

    def launch(self, robots: int) -> RunPoint | None:
        """Draw an initial state, run `init` of all robots, and return the point of the run after `init`.

        Returns None if no initial state is found in TRIES attempts."""
        why = "no state was found that satisfies `initially`"
        for _ in range(TRIES):
            self.unit()
            attempt = self.launched[robots] = self.launched.get(robots, -1) + 1
            try:
                state = self.states.launch(robots, attempt, self.judge.is_start)
                if state is None or not self.fresh(state):
                    continue
                after, act, breach = self.judge.init(state)
            except (UnusableStep, NotExact, Discarded) as error:
                why = str(error)
                continue
            place = self.check(beginning(state), act, after, breach)
            self.ready.append(place)
            self.known.append(place.now)
            return place
        self.judge.reasons.setdefault((INIT, ""), why)
        return None

    def once(self, place: RunPoint) -> Iterator[None]:
        """From a point of a run, run each possible event of one robot, each followed by a step of the environment."""
        self.settle(place)
        self.commanded(place)
        for step in self.steps(place):
            yield
            self.settle(step)

    # Attack by random walks

    def walks(self) -> Iterator[None]:
        """Attack the states of random walks. Each walk begins after `init`, in a known or a newly drawn state."""
        for robots in cycle(self.fleets):
            place = self.launch(robots) if self.random.random() < 0.5 or not self.ready else None
            yield
            if place is None and not self.ready:
                return
            yield from self.walk(self.random.choice(self.ready) if place is None else place)

    def walk(self, place: RunPoint) -> Iterator[None]:
        for _ in range(ROUNDS):
            robots = len(place.now.robots)
            for pid in self.random.sample(range(robots), robots):
                if self.commands and self.random.random() < COMMANDED:
                    place = self.commanded(place)
                if self.random.random() >= SKIPS:
                    place = self.turn(place, pid)
                    yield
            moved = self.settle(place)
            if moved is None:
                return
            place = moved
            self.known.append(place.now)

    def turn(self, place: RunPoint, pid: int) -> RunPoint:
        """Run one event of a robot: of the robot's possible events, the event with the fewest runs.

        Return the point of the run after the event, or the given point if no event can be run."""
        drawn = [(self.runs.get(event.name, 0), self.random.random(), event) for event in self.options(place, pid)]
        for _, _, event in sorted(drawn, key=lambda each: each[:2]):
            step = self.step(place, pid, event)
            if step is not None:
                return step
        return place

    # Attack of variations of known states

    def varied(self) -> Iterator[None]:
        """Attack variations of known states. From each variation that satisfies the PROVED invariants, run a round."""
        while self.known and self.states.variables:
            state = self.states.varied(self.random.choice(self.known))
            self.unit()
            yield
            yield from self.every_order(state, VARIED_ORDERS)

    # Attack of states from the solver's models

    def modelled(self) -> Iterator[None]:
        """Attack states from the solver's models. Each state is requested for the step with the fewest runs."""
        assert self.solver is not None
        models = Models(self.program, self.exact, self.params, self.solver, self.random)
        plain = {event.name: event for event in self.program.events}
        wanted = [*plain] + ([ENVIRONMENT] if self.states.sensors else [])
        sizes = cycle(self.fleets)
        idle = 0
        while wanted and idle < 2 * len(wanted) * len(self.fleets):
            name = min(wanted, key=lambda step: self.runs.get(step, 0) + self.tried.get(step, 0))
            self.tried[name] = self.tried.get(name, 0) + MODEL_RUNS
            most = self.until - self.clock() if self.timed else math.inf
            state = models.state(plain.get(name), next(sizes), most)
            self.waited = models.waited if self.timed else 0.0
            idle += 1
            yield
            if state is None:
                self.judge.reasons.setdefault((name, ""), models.why)
                continue
            for _ in self.every_order(state, ORDERS, name):
                idle = 0
                yield

    def every_order(self, state: State, most: int, wanted: str = "") -> Iterator[None]:
        """Run one round in every order of events from a state, if the state satisfies the PROVED invariants.

        After each event, a step of the environment is tried. The search ends after about `most` events.
        `wanted`: name of the step for which the solver found the state; "" for a state from another source."""
        try:
            if self.judge.violated_hypothesis(state) or not self.fresh(state):
                return
        except UnusableStep as error:
            if wanted:
                self.judge.reasons.setdefault((wanted, ""), str(error))
            return
        yield
        self.known.append(state)
        places, count = [beginning(state)], 0
        while places and count < most:
            place = places.pop(0)
            self.settle(place)
            self.commanded(place)
            for step in self.steps(place):
                count += 1
                yield
                places.append(step)

    # Execution of single steps

    def steps(self, place: RunPoint) -> Iterator[RunPoint]:
        """Run each possible event of each robot that has not run an event in the present round.

        All events are run from the given point of a run. Yields the point after each event."""
        for pid in range(len(place.now.robots)):
            if pid not in place.turns:
                for event in self.options(place, pid):
                    step = self.step(place, pid, event)
                    if step is not None:
                        yield step

    def options(self, place: RunPoint, pid: int) -> list[decl.Event]:
        """Return the events that robot `pid` may run at the given point of a run.

        The list is empty if a guard cannot be evaluated. Raises ContradictionFound if a guard must have a value, but
        has none."""
        try:
            ready = self.judge.ready(place.start, place.now, pid)
        except UnusableStep:
            return []
        if ready.fault is not None:
            act, breach = ready.fault
            self.check(place, act, place.now, breach)
        return ready.events

    def step(self, place: RunPoint, pid: int, event: decl.Event) -> RunPoint | None:
        """Run an event of robot `pid`, and return the point of the run after the event.

        Returns None if the event is discarded or cannot be used. Raises BudgetSpent, ContradictionFound."""
        self.unit()
        self.runs[event.name] = self.runs.get(event.name, 0) + 1
        try:
            found = self.judge.event(place.start, place.now, pid, event)
        except UnusableStep:
            return None
        if found is None:
            return None
        after, act, breach = found
        return self.check(place, act, after, breach)

    def commanded(self, place: RunPoint) -> RunPoint:
        """Write drawn commands of another fleet, if the program takes any. Return the point of the run afterwards."""
        if not self.commands:
            return place
        self.unit()
        commands = {name: self.states.value(type_, place.now) for name, type_ in self.commands.items()}
        after, act, breach = self.judge.commanded(place.now, commands)
        return self.check(place, act, after, breach)

    def settle(self, place: RunPoint) -> RunPoint | None:
        """Run a step of the environment, which draws new sensor values. Return the next round's start in the run.

        Returns None if the program's assumptions allow none of the drawn sensor values."""
        self.unit()
        if not self.states.sensors:
            sensors: tuple[Mapping[str, Value], ...] = tuple([{} for _ in place.now.robots])
            return place.then(Act(ENVIRONMENT, sensors=sensors), place.now._replace(round=place.now.round + 1))
        fleet = []
        try:
            for pid, robot in enumerate(place.now.robots):
                moves = self.states.moves(place.now, pid)
                allowed = (m for m in moves if self.judge.may_move(place.now, pid, {**robot.ports, **m}))
                move = next(allowed, None)
                if move is None:
                    self.judge.reasons.setdefault(
                        (ENVIRONMENT, ""), "the assumptions allow none of the sensor values that were drawn"
                    )
                    return None
                fleet.append(move)
            after, act, breach = self.judge.moved(place.now, tuple(fleet))
        except (UnusableStep, NotExact):
            return None
        return self.check(place, act, after, breach)

    def check(self, place: RunPoint, act: Act, after: State, breach: VerdictBreach | None) -> RunPoint:
        """Return the point of the run after the step `act`. Raises ContradictionFound if `breach` is not None."""
        step = place.then(act, after)
        if breach is not None:
            raise ContradictionFound(Contradiction(Trial(step.first, step.acts), breach, place.now, after))
        return step

    def fresh(self, state: State) -> bool:
        """Return whether a state is new to the attack, and record the state."""
        key = key_of(state)
        if key in self.seen:
            return False
        self.seen.add(key)
        return True
