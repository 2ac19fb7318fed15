"""Attack on PROVED invariants within a time budget: chooses states, and reports the result.

States that are cheap to get, or likely to reveal a mistake, come first: initial states, `init`, and the first events of
each robot. Then three sources are used in turn, each for the same share of time:

- random walks from states after `init`;
- states from the solver's models, from which one round is run in every order;
- variations of known states, which differ in a few variables.

The same program and seed give the same sequence of states. The budget decides how many of them are used.
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

SECONDS = 0.05  # default budget of an attack, in seconds
FLEETS = (1, 2, 3, 4)  # fleet sizes that are attacked, if the number of robots is not given
STARTS = 2  # number of initial states of each fleet size that are attacked first
TRIES = 12  # attempts to draw one initial state
ROUNDS = 6  # length of one random walk, in rounds
ORDERS = 150  # largest number of steps that are run in one round from one state of a model
VARIED_ORDERS = 8  # largest number of steps that are run in one round from a variation of a known state
MODEL_RUNS = 60  # runs of an event that one state of a model should give before the solver is asked again
SKIPS = 0.15  # probability that a robot skips its event in a round of a random walk
STALE = 400  # number of units of work without a new state after which the attack ends
FIRST = 0.4  # share of the budget that is used before the solver is asked

Clock = Callable[[], float]


class AttackReport(NamedTuple):
    """Result of an attack.

    `states`: (step, invariant) -> number of states in which the invariant was judged after the step. A step is an
        event's name, "init" or "(environment)".
    `reasons`: (step, invariant) -> the reason why the number is 0."""

    states: Mapping[tuple[str, str], int]
    reasons: Mapping[tuple[str, str], str]
    contradiction: Contradiction | None
    seconds: float

    def of(self, step: str, invariant: str) -> tuple[int, str]:
        """Return the number of states with which an obligation was attacked, and the reason if it is 0."""
        count = self.states.get((step, invariant), 0)
        if count:
            return count, ""
        found = self.reasons.get((step, invariant)) or self.reasons.get((step, "")) or self.reasons.get(("", ""))
        return 0, found or "no state was found from which the step can be run"


class BudgetSpent(Exception):
    """Raised if the time budget is used up, or no new states are found."""


class ContradictionFound(Exception):
    """Raised if a step contradicts a verdict."""

    def __init__(self, contradiction: Contradiction) -> None:
        super().__init__(contradiction.breach.why)
        self.contradiction = contradiction


class RunPosition(NamedTuple):
    """Position within a run.

    `first`: the first state of the run.
    `start`: the state at the start of the present round.
    `now`: the present state.
    `turns`: the robots that already ran an event in this round.
    `acts`: all steps so far."""

    first: State
    start: State
    now: State
    turns: frozenset[int]
    acts: tuple[Act, ...]

    def then(self, act: Act, now: State) -> RunPosition:
        """Return the position after a step. A step of the environment, or `init`, ends the round."""
        acts = (*self.acts, act)
        if act.pid is None:
            return RunPosition(self.first, now, now, frozenset(), acts)
        return RunPosition(self.first, self.start, now, self.turns | {act.pid}, acts)


def beginning(state: State) -> RunPosition:
    """Return the position of a state before `init` or at a round's start."""
    return RunPosition(state, state, state, frozenset(), ())


def attack(
    program: decl.Program, proved: Collection[str], robots: int | None = None,
    params: Mapping[str, ir.Expr] | None = None, solver: Solver | CrossCheck | None = None, seconds: float = SECONDS,
    clock: Clock = time.process_time, seed: int = 0,
) -> AttackReport:  # fmt: skip
    """Search for a state that contradicts a PROVED invariant or "(well-defined)".

    `proved`: the names of the PROVED invariants.
    `robots`: the number of robots; None for several fleet sizes.
    `params`: the values of fixed params; all other params may have any value.
    `solver`: provides states from models; None if no solver is used.
    `seconds`: the budget on `clock`.
    `clock`: CPU time by default, to which the time spent waiting for the solver is added. A clock that counts work does
        not count this waiting time."""
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
    """Return the program with exact numbers, and whether some initial values are GridMaps.

    A GridMap has no exact form. It is computed as robots compute it, with the program's values of params."""
    variables: list[decl.Local | decl.Shared] = [*program.locals, *program.shared]
    rounded = {v.name for v in variables if any(_is_map(n) for n in walk(v.initial))}
    made = exact(program)
    if not rounded:
        return made, False
    first = initial(program, 1)
    values = {**first.robots[0].locals, **first.store.cells, **{n: v[0] for n, v in first.store.slots.items()}}

    def known(variable: decl.Local | decl.Shared) -> ir.Expr:
        # the semantics does not check the type of a constant, so the constant may have any value
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
        self.proved = proved
        self.judge = TrialJudge(self.exact, proved, self.states.answers)
        self.fleets = FLEETS if robots is None else (robots,)
        self.params, self.solver, self.until = params, solver, until
        self.computing, self.timed = clock, clock is time.process_time
        self.waited = 0.0  # seconds spent waiting for the solver
        self.ready: list[RunPosition] = []  # positions after `init`
        self.known: list[State] = []  # states at the starts of rounds
        self.seen: set[tuple[object, ...]] = set()
        self.launched: dict[int, int] = {}
        self.runs: dict[str, int] = {}  # event -> number of its runs
        self.tried: dict[str, int] = {}  # step -> number of runs that states of models were expected to give
        self.spent = False
        self.units = 0
        # number of states judged when the last new one was found, and the unit of work in which it was found
        self.news = 0, 0

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
        """Run a contradiction again from its beginning, with a new judge.

        Raises InternalError if the contradiction does not occur again."""
        why = "the second run shows no contradiction"
        try:
            again = TrialJudge(self.exact, self.proved, self.states.answers).replay(found.trial).contradiction
            if again is not None:
                return again
        except (TrialNotCovered, UnusableStep) as error:
            why = str(error)
        raise InternalError(f"the attack on {found.breach.invariant} cannot repeat its contradiction: {why}")

    def alternate(self) -> None:
        """Use all sources for the same share of time each, until the budget is used up."""
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
        """Count one unit of work.

        Raises BudgetSpent if the budget is used up, or if the last STALE units found no new state."""
        if len(self.judge.known) > self.news[0]:
            self.news = len(self.judge.known), self.units
        self.units += 1
        self.spent = self.clock() > self.until
        if self.spent or self.units - self.news[1] > STALE:
            raise BudgetSpent

    # Initial states and first rounds

    def first(self) -> Iterator[None]:
        """Attack the first states of each fleet size.

        For each state: run `init`, then each possible event of one robot alone, and a step of the environment after
        each event. Then run a few rounds of a random walk."""
        for robots in self.fleets:
            for _ in range(STARTS):
                place = self.launch(robots)
                if place is not None:
                    yield from self.once(place)
                    yield from self.walk(place)

    def launch(self, robots: int) -> RunPosition | None:
        """Return a position after every robot has run `init`; None if no initial state is found."""
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

    def once(self, place: RunPosition) -> Iterator[None]:
        """Run every event that a single robot can run in a state, each followed by a step of the environment."""
        self.settle(place)
        for step in self.steps(place):
            yield
            self.settle(step)

    # Random walks

    def walks(self) -> Iterator[None]:
        """Attack the states of random walks, which begin in known or new states after `init`."""
        for robots in cycle(self.fleets):
            place = self.launch(robots) if self.random.random() < 0.5 or not self.ready else None
            yield
            if place is None and not self.ready:
                return
            yield from self.walk(self.random.choice(self.ready) if place is None else place)

    def walk(self, place: RunPosition) -> Iterator[None]:
        for _ in range(ROUNDS):
            robots = len(place.now.robots)
            for pid in self.random.sample(range(robots), robots):
                if self.random.random() >= SKIPS:
                    place = self.turn(place, pid)
                    yield
            moved = self.settle(place)
            if moved is None:
                return
            place = moved
            self.known.append(place.now)

    def turn(self, place: RunPosition, pid: int) -> RunPosition:
        """Run one event of a robot, preferring events that were run least often.

        Returns the position after the event, or the same position if the robot can run none."""
        drawn = [(self.runs.get(event.name, 0), self.random.random(), event) for event in self.options(place, pid)]
        for _, _, event in sorted(drawn, key=lambda each: each[:2]):
            step = self.step(place, pid, event)
            if step is not None:
                return step
        return place

    # Variations of known states

    def varied(self) -> Iterator[None]:
        """Attack variations of known states: run rounds from those that satisfy the PROVED invariants."""
        while self.known and self.states.variables:
            state = self.states.varied(self.random.choice(self.known))
            self.unit()
            yield
            yield from self.every_order(state, VARIED_ORDERS)

    # States from the solver's models

    def modelled(self) -> Iterator[None]:
        """Attack states of the solver's models: run rounds from them, for one event after another."""
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
        """Run one round in every order of events, from a state that satisfies the PROVED invariants.

        A step of the environment is run after each event. At most `most` events are run."""
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
            for step in self.steps(place):
                count += 1
                yield
                places.append(step)

    # Steps

    def steps(self, place: RunPosition) -> Iterator[RunPosition]:
        """Run every event of every robot that has not run an event in this round.

        Yields the position after each of them."""
        for pid in range(len(place.now.robots)):
            if pid not in place.turns:
                for event in self.options(place, pid):
                    step = self.step(place, pid, event)
                    if step is not None:
                        yield step

    def options(self, place: RunPosition, pid: int) -> list[decl.Event]:
        """Return the events that a robot may run at this position."""
        try:
            ready = self.judge.ready(place.start, place.now, pid)
        except UnusableStep:
            return []
        if ready.fault is not None:
            act, breach = ready.fault
            self.check(place, act, place.now, breach)
        return ready.events

    def step(self, place: RunPosition, pid: int, event: decl.Event) -> RunPosition | None:
        """Return the position after a robot's event; None if the event has no result.

        Raises BudgetSpent, ContradictionFound."""
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

    def settle(self, place: RunPosition) -> RunPosition | None:
        """Return the position after a step of the environment, which is the beginning of the next round.

        Returns None if the assumptions allow none of the drawn moves."""
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
                        (ENVIRONMENT, ""), "the assumptions allow none of the moves that were drawn"
                    )
                    return None
                fleet.append(move)
            after, act, breach = self.judge.moved(place.now, tuple(fleet))
        except (UnusableStep, NotExact):
            return None
        return self.check(place, act, after, breach)

    def check(self, place: RunPosition, act: Act, after: State, breach: VerdictBreach | None) -> RunPosition:
        """Return the position after a step. Raises ContradictionFound if the step contradicts a verdict."""
        step = place.then(act, after)
        if breach is not None:
            raise ContradictionFound(Contradiction(Trial(step.first, step.acts), breach, place.now, after))
        return step

    def fresh(self, state: State) -> bool:
        """Return whether a state has not been attacked before, and remember the state."""
        key = key_of(state)
        if key in self.seen:
            return False
        self.seen.add(key)
        return True
