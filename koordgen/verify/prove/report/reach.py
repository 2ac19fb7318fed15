"""Bounded search for a run from an initial state to a state in which an invariant is false.

The semantics executes each run, so every run that the search finds is possible. If the search finds no run, nothing is
proved. To make the environment finite, each sensor takes only values that the program and the counterexample to
induction mention and that the assumptions allow.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from fractions import Fraction
from itertools import islice, product
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir import expr as ir
from koordgen.lang.ir.ports import clearable
from koordgen.lang.ir.tree import Part, walk
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, Type
from koordgen.lang.semantics.deadline import Deadline, OutOfTime, ends
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact, made_exact
from koordgen.lang.semantics.exec import NoMeaning
from koordgen.lang.semantics.relations import choice, is_order_of_agents
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.step import Step, applied, initial, round_, run_init, select, sense
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.points import Point
from koordgen.verify.prove.report.model import Conjunct, exact_state, failing_conjunct, is_allowed, is_true
from koordgen.verify.prove.report.model_reader import Unshowable

ENVIRONMENT = "(environment)"


class SearchBounds(NamedTuple):
    """Limits of the search for a run.

    `robots`: number of robots of the largest fleet.
    `rounds`: length of the longest run, in rounds.
    `states`: largest number of runs that are extended in one round.
    `values`: largest number of values of one sensor.
    `moves`: largest number of joint moves of the whole fleet by the environment.
    `seconds`: CPU seconds of the search. A busy computer then finds the same runs."""

    robots: int = 3
    rounds: int = 6
    states: int = 1500
    values: int = 6
    moves: int = 12
    seconds: float = 0.25


class RunState(NamedTuple):
    """State of a run, with the step that led to the state.

    `event`: the step: "" for the first state, "init", an event's name, or "(environment)".
    `pid`: the robot that ran the event; None for other steps."""

    state: State
    event: str
    pid: int | None
    round: int


class CounterexampleRun(NamedTuple):
    """Run from an initial state to a state in which an invariant is false.

    `failed`: the conjunct of the invariant that is false in the last state.
    `of_agents`: whether robots' agents, which run events in a fixed order, can execute the run."""

    run_states: tuple[RunState, ...]
    failed: Conjunct
    of_agents: bool


def run_to(
    program: decl.Program,
    invariant: decl.Property,
    hints: Iterable[Value],
    bounds: SearchBounds,
    robots: int | None = None,
) -> CounterexampleRun | None:
    """Return a run to a state in which the invariant is false; None if the search finds none.

    The search starts with one robot and adds robots up to `bounds.robots`, or uses exactly `robots` robots. It returns
    a run with the fewest rounds, in the first fleet size that has a run. If agents cannot execute this run, a second
    search with the same time limit looks for a run that agents can execute. The second run has at most as many rounds
    as the first.

    `program`: the program with exact numbers.
    `hints`: additional values that sensors may take."""
    fleets = [robots] if robots is not None else list(range(1, bounds.robots + 1))
    known = tuple(hints)
    found = _searched(program, invariant, known, bounds, fleets, as_agents=False)
    if found is None or found.of_agents:
        return found
    bounds = bounds._replace(rounds=found.run_states[-1].round)
    return _searched(program, invariant, known, bounds, fleets, as_agents=True) or found


def _searched(
    program: decl.Program, invariant: decl.Property, hints: tuple[Value, ...], bounds: SearchBounds,
    fleets: Iterable[int], as_agents: bool,
) -> CounterexampleRun | None:  # fmt: skip
    until = time.process_time() + bounds.seconds
    try:
        with ends(Deadline(time.process_time, until)):
            for n_sys in fleets:
                found = _RunSearch(program, invariant, hints, bounds, until, as_agents).of(n_sys)
                if found is not None:
                    return found
    except (NotExact, NoMeaning, OutOfTime):
        return None  # a run that takes too long, or whose numbers cannot be exact, proves nothing
    return None


class _RunSearch:
    """Breadth-first search of runs.

    With `as_agents`, each robot runs only the event that its agent would choose."""

    def __init__(
        self, program: decl.Program, invariant: decl.Property, hints: tuple[Value, ...], bounds: SearchBounds,
        until: float, as_agents: bool,
    ) -> None:  # fmt: skip
        self.program = program
        self.invariant = invariant
        self.bounds = bounds
        self.until = until
        self.world = World({}, no_path)
        self.sensors = [
            (f"{m.name}.{p.name}", p.type) for m in program.modules for p in m.ports if p.direction == "sensor"
        ]
        self.pools = Pools(hints, literals(program.properties), bounds.values)
        self.as_agents = as_agents

    def of(self, n_sys: int) -> CounterexampleRun | None:
        layer: list[tuple[RunState, ...]] = []
        for start in self.starts(n_sys):
            ready, steps = run_init(self.program, start, self.world)
            # If an `init` is discarded, no mission begins.
            if not any(isinstance(step.outcome, Discarded) for step in steps):
                layer.append((RunState(start, "", None, 0), RunState(ready, "init", None, 0)))
        found = self.broken(layer)
        seen: list[State] = []
        while layer and found is None and layer[0][-1].round < self.bounds.rounds:
            reached = list(islice(self.rounds(layer, seen), self.bounds.states))
            found = self.broken(reached)
            # A new round begins only after a step of the environment.
            layer = [run for run in reached if run[-1].event == ENVIRONMENT]
        return found

    def broken(self, layer: list[tuple[RunState, ...]]) -> CounterexampleRun | None:
        for run in layer:
            failed = failing_conjunct(self.invariant, self.program, run[-1].state)
            if failed is not None:
                return CounterexampleRun(run, failed, self.of_agents(run))
        return None

    def of_agents(self, run: tuple[RunState, ...]) -> bool:
        """Return whether agents can execute a run; False if a guard cannot be evaluated exactly."""
        try:
            return is_order_of_agents(self.program, run, self.world)
        except (NotExact, NoMeaning):
            return False

    def starts(self, n_sys: int) -> Iterator[State]:
        """Yield at most `bounds.moves` initial states.

        The states combine values of the pools for the robots' sensors."""
        first = exact_state(initial(self.program, n_sys))
        rules = [p for p in self.program.properties if p.kind == "initially"]
        cleared = clearable(self.program)
        pools = [
            [(name, v) for v in ([True] if name in cleared else self.pools.pool(type_, first))]
            for name, type_ in self.sensors
        ]
        single = [dict(choice) for choice in islice(product(*pools), self.bounds.moves)]
        fleets = islice(product(single, repeat=n_sys), self.bounds.states)
        count = 0
        for fleet in fleets:
            state = exact_state(initial(self.program, n_sys, fleet))
            if count < self.bounds.moves and all(is_true(rule, self.program, state) for rule in rules):
                count += 1
                yield state

    def rounds(self, layer: list[tuple[RunState, ...]], seen: list[State]) -> Iterator[tuple[RunState, ...]]:
        """Extend every run by one round: first events, then a step of the environment.

        In each round, either one robot runs an event, or all robots' agents run their events."""
        for run in layer:
            state = run[-1].state
            for stepped in (run, *self.stepped(run, state)):
                if time.process_time() > self.until or len(seen) > self.bounds.states:
                    return
                if stepped is not run:
                    # The program's step is complete, so the invariant can be checked before the environment's step.
                    yield stepped
                for moved in self.moved(stepped[-1].state):
                    fresh = moved._replace(round=0)
                    if fresh not in seen:
                        seen.append(fresh)
                        yield (*stepped, RunState(moved, ENVIRONMENT, None, run[-1].round + 1))

    def stepped(self, run: tuple[RunState, ...], state: State) -> Iterator[tuple[RunState, ...]]:
        number = run[-1].round + 1
        for pid in range(len(state.robots)):
            for step in self.events(state, pid):
                yield (*run, RunState(applied(self.program, state, step), str(step.event), pid, number))
        if len(state.robots) > 1:
            steps: list[Step] = []
            with suppress(NotExact, NoMeaning):
                steps = round_(self.program, state, world=self.world)[1]
            run_states = list(run)
            for step in steps:
                if step.event is not None and not isinstance(step.outcome, Discarded):
                    run_states.append(
                        RunState(applied(self.program, run_states[-1].state, step), step.event, step.pid, number)
                    )
            if len(run_states) > len(run):
                yield tuple(run_states)

    def events(self, state: State, pid: int) -> Iterator[Step]:
        """Yield the possible steps of one robot. Events that cannot be run exactly are skipped."""
        if state.robots[pid].stopped:
            return
        for event in self.candidate_events(state, pid):
            with suppress(NotExact, NoMeaning):
                step = choice(self.program, event, state, pid, None, self.world)
                if step is not None:
                    yield step

    def candidate_events(self, state: State, pid: int) -> tuple[decl.Event, ...]:
        if not self.as_agents:
            return self.program.events
        with suppress(NotExact, NoMeaning):
            chosen = select(self.program, state, pid, self.world)
            return (chosen,) if isinstance(chosen, decl.Event) else ()
        return ()

    def moved(self, state: State) -> Iterator[State]:
        """Yield the states after a step of the environment, with sensor values that the assumptions allow."""
        each = []
        for pid, robot in enumerate(state.robots):
            pools = [self.pools.nearby(name, type_, robot.ports, state) for name, type_ in self.sensors]
            found = []
            for moves in islice(product(*pools), 4 * self.bounds.moves):
                new = {**robot.ports, **dict(moves)}
                try:
                    if is_allowed(self.program, robot.ports, new, pid, state):
                        found.append(dict(moves))
                except Unshowable:
                    continue
            each.append(found[: self.bounds.values])
        for fleet in islice(product(*each), self.bounds.moves):
            yield sense(state, fleet)


class Pools:
    """Pools of values that the search tries for sensors.

    The pool of a type contains at most `count` of the values that the program and the hints mention."""

    def __init__(self, hints: Iterable[Value], mentioned: Iterable[Value], count: int) -> None:
        self.hints, self.mentioned = tuple(hints), tuple(mentioned)
        self.count = count

    def nearby(self, name: str, type_: Type, ports: Mapping[str, Value], state: State) -> list[tuple[str, Value]]:
        """Return the values to try for a sensor after a step, each with the sensor's name.

        The first values are those of the robot's other ports of the same type, such as commands. The sensor's old value
        and the type's pool follow."""
        commands = [v for other, v in ports.items() if other != name and _is(v, type_)]
        return [(name, v) for v in _distinct([*commands, ports[name], *self.pool(type_, state)])]

    def pool(self, type_: Type, state: State) -> list[Value]:
        """Return the pool of a type: values that the program and the hints mention."""
        if type_ == BOOL:
            return [True, False]
        known: list[Value] = [v for v in (*self.hints, *state.params.values(), *self.mentioned) if _is(v, type_)]
        if type_ == POINT:
            known += [_apart(i) for i in range(len(state.robots))]
        if type_ == FLOAT:
            known.append(Fraction(0))  # type: ignore[arg-type]
        if type_ == INT:
            known.append(0)
        return _distinct(known)[: self.count]


def _apart(i: int) -> Point:
    return Point(Fraction(i), Fraction(0), Fraction(0))  # type: ignore[arg-type]


def _is(value: Any, type_: Type) -> bool:
    kinds: dict[object, Any] = {POINT: Point, FLOAT: Fraction}
    if type_ == INT:
        return isinstance(value, int) and not isinstance(value, bool)
    return type_ in kinds and isinstance(value, kinds[type_])


def literals(part: Part) -> Iterator[Value]:
    """Yield the numbers that formulas or statements contain."""
    for node in walk(part):
        if isinstance(node, ir.Const) and not isinstance(node.value, (bool, str)):
            yield made_exact(node.value)


def _distinct(values: Iterable[Any]) -> list[Any]:
    found: list[Any] = []
    for value in values:
        if value not in found:
            found.append(value)
    return found


def no_path(pid: int, port: str, args: tuple[Value, ...]) -> Value:
    """Answer every call of a callable port with an empty path."""
    return ()
