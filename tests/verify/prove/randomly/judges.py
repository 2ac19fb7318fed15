"""Judges of the prover: PROVED invariants are checked by exploration, random runs and the attack.

The exploration is `koordgen explore`'s, on the code that robots run, for 1, 2 and 3 robots. The random runs are made by
the executable semantics, in random orders. Both take sensor values from small pools, as far as the program's
assumptions allow them. The attack is that of `koordgen prove`. No judge says anything of states that it did not reach.
"""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import islice, product
from random import Random
from typing import Any, NamedTuple
from unittest.mock import patch

from koordgen.lang.ir import decl
from koordgen.lang.ir.types import BOOL, FLOAT, INT, POINT, Type
from koordgen.lang.node import replace
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.property import holds_assumption, holds_property
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.step import Step, applied, enabled, execute, has_priority, initial, run_init, sense
from koordgen.runtime.values.points import Point
from koordgen.verify.attack.attack import attack
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import (
    STRAIGHT,
    Environment,
    EnvironmentSteps,
    MissingEnvironment,
    SensorDomain,
    possible_answers,
)
from koordgen.verify.explore.machine import DiscardedEvent, Machine, PrivateState
from koordgen.verify.explore.search import Search
from koordgen.verify.prove.report import explain, reach
from koordgen.verify.prove.report.verdict import WELL_DEFINED, Question, prove
from koordgen.verify.prove.smt.solve import CrossCheck, Solver

FLEETS = (1, 2, 3)
LIMITS = ("would become", "would get", "not finished", " failed: ")  # of these `(well-defined)` says nothing
POOLS: dict[Type, tuple[Any, ...]] = {
    BOOL: (True, False),
    INT: (0, 1, 3),
    FLOAT: (0.0, 0.5, 2.5),
    POINT: (Point(0.0, 0.0, 0.0), Point(5.0, 2.0, 0.0), Point(-1.0, 0.0, 7.0)),
}
WAYS = ((), (Point(1.0, 0.0, 0.0),), (Point(5.0, 2.0, 0.0), Point(1.0, 0.0, 0.0)))
TURNS = 2000  # of loops, in one event of a random run: one that takes more is discarded
MOVES = {1: 6, 2: 3, 3: 2}  # of one robot's sensors in one step, by the number of robots


class Effort(NamedTuple):
    """How much is spent on one program: states and rounds of each exploration, its seconds; random runs of each number
    of robots, and their rounds. `explaining`: seconds for the run to what is not proved, on which every failed proof
    spends some. `attacking`: seconds of the attack, the solver's included. `proving`: seconds that a proof may compute,
    solvers aside, before it is given up."""

    states: int = 150
    rounds: int = 4
    seconds: float = 0.03
    runs: int = 3
    length: int = 5
    explaining: float = 0.02
    attacking: float = 0.03
    proving: float = 2.0


class Overtime(BaseException):
    """The prover has had its time. No handler of `Exception` holds it up."""


class Contradiction(NamedTuple):
    """An invariant that is PROVED and is false in a state that a run comes to. `judge`: "exploration", "run" or
    "attack"; the last one's runs may begin with any state in which all that is PROVED holds."""

    invariant: str
    judge: str
    robots: int
    story: str


class Judged(NamedTuple):
    """`verdicts` by the name of the invariant. `fault`: the traceback of an unexpected exception. `skipped`: why a
    judge could say nothing. `seconds` by what they were spent on."""

    verdicts: Mapping[str, str]
    contradictions: tuple[Contradiction, ...]
    fault: str
    skipped: tuple[str, ...]
    seconds: Mapping[str, float]


Judge = Callable[[decl.Program, frozenset[str], int, Effort], "Contradiction | None"]


def judged(program: decl.Program, solver: Solver | CrossCheck, seed: int, effort: Effort) -> Judged:
    """Return the verdicts on a program, and the contradictions that the judges found."""
    verdicts: dict[str, str] = {}
    found: list[Contradiction] = []
    skipped: list[str] = []
    seconds: dict[str, float] = {}
    fault = ""
    try:
        with _timed(seconds, "prove"), _brief(effort), _within(effort.proving):
            verdicts = {v.invariant: v.verdict for v in prove(Question(program), solver)}
        proved = frozenset(name for name, verdict in verdicts.items() if verdict == "PROVED")
        judges: dict[str, Judge] = {"exploration": explored, "run": ran, "attack": partial(attacked, solver=solver)}
        for name, judge in judges.items() if proved else ():
            with _timed(seconds, name):
                try:
                    found += filter(None, [judge(program, proved, seed, effort)])
                except MissingEnvironment as error:
                    skipped.append(f"{name}: {error}")
    except Overtime:
        solver.__exit__()  # it may be in the midst of an answer
        skipped.append("prove: overtime")
    except Exception:
        fault = traceback.format_exc()
        solver.__exit__()
    return Judged(verdicts, tuple(found), fault, tuple(skipped), seconds)


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.monotonic()
    try:
        yield
    finally:
        seconds[name] = seconds.get(name, 0.0) + time.monotonic() - began


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """Raise Overtime in the block once this process has computed for so many seconds; solvers have limits of their own.

    Raises it again if the block goes on, because a destructor swallows it. Of the main thread only."""

    def over(*_: object) -> None:
        raise Overtime

    kept = signal.signal(signal.SIGVTALRM, over)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, kept)


@contextmanager
def _brief(effort: Effort) -> Iterator[None]:
    """Failed proofs are explained in less time than people would give them."""
    bounds = reach.SearchBounds(seconds=effort.explaining)
    with ExitStack() as stack:
        stack.enter_context(patch.object(explain, "SearchBounds", lambda: bounds))
        stack.enter_context(patch.object(explain, "STRENGTHENING_SECONDS", effort.explaining))
        stack.enter_context(patch.object(explain, "SEARCH_SECONDS", 10 * effort.explaining))
        stack.enter_context(patch.object(explain, "QUERY_SECONDS", 10 * effort.explaining))
        yield


# The environment


class Nearby(EnvironmentSteps):
    """A few moves of each robot's sensors, of those that the assumptions allow: also to where it was sent."""

    def __init__(self, machine: Machine, environment: Environment, seed: int) -> None:
        super().__init__(machine, environment)
        self.random = Random(seed)
        self.apart = "the moves that are tried are not the same for all"

    def starts(self) -> Iterator[tuple[dict[str, Any], ...]]:
        each = list(product(*[self._few(self._first(domains)) for domains in self.domains]))
        return iter(self._few(each, 4))

    def _first(self, domains: Mapping[str, SensorDomain]) -> list[dict[str, Any]]:
        """What one robot's sensors say when a mission begins. It stands anywhere, whether the program asks where or
        not, and an unset target is where it stands."""
        found = self._starts(domains)
        for name in unplaced(self.machine.program):
            found = [{**sensors, name: place} for sensors in found for place in POOLS[POINT]]
        return found

    def moves(self, pid: int, own: int) -> tuple[int, ...]:
        found = self._moves.get((pid, own))
        if found is None:
            robot = self.machine.owns.values[own]
            allowed = (new for new in self._options(pid, robot) if self._allowed(pid, robot, new))
            chosen = islice(allowed, MOVES[self.machine.n_sys])
            found = tuple([self.machine.own(robot._replace(sensors=new)) for new in chosen])
            self._moves[pid, own] = found
        return found

    def _options(self, pid: int, robot: PrivateState) -> list[dict[str, Any]]:
        pools = []
        for name in self.machine.sensors:
            sent = [
                v for v in robot.actuators.values() if isinstance(v, Point) and isinstance(robot.sensors[name], Point)
            ]
            values = dict.fromkeys([robot.sensors[name], *sent, *self.domains[pid][name].values])
            pools.append([True] if name in robot.unset else list(values))
        options = [dict(zip(self.machine.sensors, values, strict=True)) for values in product(*pools)]
        return self._few(options, 40)

    def _few(self, options: list[Any], most: int = 6) -> list[Any]:
        return self.random.sample(options, min(most, len(options)))


def surroundings(program: decl.Program) -> Environment:
    """A few values for each sensor, and answers of planners."""
    ports = [(f"{m.name}.{p.name}", p) for m in program.modules for p in m.ports]
    names = {name for name, _ in ports}
    domains = {name: SensorDomain(POOLS[p.type]) for name, p in ports if p.direction == "sensor"}
    answers = {
        name: (*WAYS, STRAIGHT) if f"{name.partition('.')[0]}.position" in names else WAYS
        for name, p in ports
        if p.direction == "callable"
    }
    return Environment(domains, answers)


def unplaced(program: decl.Program) -> list[str]:
    """The targets beside which no position is declared."""
    modules = [(m.name, {p.name for p in m.ports if p.direction != "callable"}) for m in program.modules]
    return [f"{name}.target" for name, ports in modules if "target" in ports and "position" not in ports]


# Exploration


class _Told(list[DiscardedEvent]):
    """The events without a result of which `(well-defined)` speaks, and false loop invariants, by their line; both only
    where they are PROVED."""

    def __init__(self, proved: frozenset[str]) -> None:
        super().__init__()
        self.proved = proved

    def append(self, found: DiscardedEvent) -> None:
        name = f"line {found.line}" if found.reason.startswith("the loop invariant") else WELL_DEFINED
        if name in self.proved and not _limit(found.reason):
            super().append(found)


def _limit(reason: str) -> bool:
    return any(word in reason for word in LIMITS)


def explored(program: decl.Program, proved: frozenset[str], seed: int, effort: Effort) -> Contradiction | None:
    """The first violation of what is PROVED, of 1, 2 or 3 robots. Raises MissingEnvironment."""
    claimed = replace(
        program, properties=tuple([p for p in program.properties if p.kind == "initially" or p.name in proved])
    )
    around = surroundings(program)
    for n_sys in FLEETS:
        machine = Machine(claimed, n_sys, possible_answers(around, claimed, n_sys))
        machine.discards = _Told(proved)
        bounds = ExplorationBounds(effort.rounds, effort.states, effort.seconds)
        search = Search(
            machine, Nearby(machine, around, seed), bounds, time.process_time, lambda _: None,
            deadlock=False, forgetting=False,
        )  # fmt: skip
        violation = search.run().violation
        if violation is not None:
            run_states = [
                f"round {m.round} {m.event or 'the beginning'} {m.pid}: {m.state}" for m in violation.run_states
            ]
            told = violation.reason or f"false: {violation.failed}"
            return Contradiction(violation.name, "exploration", n_sys, "\n".join([told, *run_states]))
    return None


# Random runs


class _Broken(Exception):
    """An invariant is false, or an event has no result, of which it was PROVED that it cannot be."""


class _Runs:
    """Runs of the executable semantics."""

    def __init__(self, program: decl.Program, proved: frozenset[str], n_sys: int, random: Random) -> None:
        self.program, self.proved, self.n_sys, self.random = program, proved, n_sys, random
        self.claimed = [p for p in program.properties if p.kind == "invariant" and p.name in proved]
        self.around = surroundings(program)
        self.answer = possible_answers(self.around, program, n_sys)
        self.run_states: list[str] = []

    def run(self, length: int) -> None:
        """Run `length` rounds, or fewer if the environment cannot go on. Raises _Broken, MissingEnvironment."""
        self.run_states = []
        state = self.begun()
        if state is None:
            return
        self.look(state, "the beginning")
        state, steps = run_init(self.program, state, self.world(state))
        for step in steps:
            self.result(step.outcome, step.pid, "init")
            self.kept(step.outcome)
        if any(isinstance(step.outcome, Discarded) for step in steps):
            return  # a mission whose `init` has no result does not begin
        self.judge(state, "init")
        for _ in range(length):
            state = self.round(state)
            moved = self.moved(state)
            if moved is None:
                return
            state = moved
            self.judge(state, "the environment")

    def round(self, state: State) -> State:
        begun = state
        for pid in self.random.sample(range(self.n_sys), self.n_sys):
            if state.robots[pid].stopped or self.random.random() < 0.15:
                continue
            for event in self.random.sample(self.program.events, len(self.program.events)):
                step = self.step(event, begun, state, pid)
                if step is not None:
                    state = applied(self.program, state, step)
                    self.judge(state, f"{event.name} of {pid}")
                    break
        return state

    def step(self, event: decl.Event, begun: State, state: State, pid: int) -> Step | None:
        """The event of a robot, in a round that began with `begun`, as `choice` of the semantics has it; None where
        the robot may not run it. An event without a result is judged, which `choice` leaves out."""
        copy = state._replace(store=begun.store)
        seen = copy if event.lock is None else state
        world = self.world(state)
        if not has_priority(self.program, event, copy, pid, world):
            return None
        try:
            if not enabled(self.program, event, seen, pid, world):
                return None
        except Discarded as fault:
            self.result(fault, pid, event.name)
            return None
        outcome = execute(self.program, event.effect, seen, pid, world)
        self.result(outcome, pid, event.name)
        self.kept(outcome)
        return Step(pid, event.name, outcome)

    def judge(self, state: State, moment: str) -> None:
        self.look(state, moment)
        for property_ in self.claimed:
            try:
                held = holds_property(property_, self.program, state)
            except Discarded:
                held = False
            if not held:
                raise _Broken(property_.name)

    def result(self, outcome: object, pid: int, event: str) -> None:
        if isinstance(outcome, Discarded) and WELL_DEFINED in self.proved and not _limit(outcome.reason):
            self.run_states.append(f"{event} of {pid} has no result: {outcome}")
            raise _Broken(WELL_DEFINED)

    def kept(self, outcome: object) -> None:
        """Every loop invariant that is PROVED held at its loop's head."""
        for span in outcome.violated if isinstance(outcome, Writes) else ():
            if f"line {span.line}" in self.proved:
                raise _Broken(f"line {span.line}")

    def look(self, state: State, moment: str) -> None:
        self.run_states.append(f"{moment}: {state}")

    def world(self, state: State) -> World:
        """One event's answers: equal questions get equal ones."""
        given: dict[str, Any] = {}

        def answer(pid: int, port: str, args: tuple[Any, ...]) -> Any:
            key = repr((pid, port, args))
            if key not in given:
                given[key] = self.random.choice(self.answer(pid, state.robots[pid].ports, port, args))
            return given[key]

        return World({}, answer, turns=TURNS)

    def begun(self) -> State | None:
        """A state of the beginning; None where none of some comes up to `initially`."""
        rules = [p for p in self.program.properties if p.kind == "initially"]
        actuators = {f"{m.name}.{p.name}" for m in self.program.modules for p in m.ports if p.direction == "actuator"}
        unset = {f"{name.partition('.')[0]}.reached" for name in actuators if name.endswith((".target", ".path"))}
        for _ in range(12):
            sensors = [
                {
                    name: True if name in unset else self.random.choice(d.values)
                    for name, d in self.around.domains.items()
                }
                for _ in range(self.n_sys)
            ]
            for name in unplaced(self.program):
                for sensed in sensors:
                    sensed[name] = self.random.choice(POOLS[POINT])
            state = initial(self.program, self.n_sys, sensors)
            try:
                if all(holds_property(rule, self.program, state) for rule in rules):
                    self.unset = [set(unset) & set(self.around.domains) for _ in range(self.n_sys)]
                    return state
            except Discarded:
                continue
        return None

    def moved(self, state: State) -> State | None:
        """The environment's step; None where some robot's sensors have nowhere to go."""
        new = [self.sensed(state, pid) for pid in range(self.n_sys)]
        return None if None in new else sense(state, [n for n in new if n is not None])._replace(round=1)

    def sensed(self, state: State, pid: int) -> dict[str, Any] | None:
        ports = state.robots[pid].ports
        held = {name for name in self.unset[pid] if ports[name]}
        self.unset[pid] = held
        sent = [v for name, v in ports.items() if isinstance(v, Point) and name not in self.around.domains]
        for _ in range(12):
            new = {
                name: True
                if name in held
                else self.random.choice([ports[name], *sent, *d.values] if isinstance(ports[name], Point) else d.values)
                for name, d in self.around.domains.items()
            }
            if self.allowed(state, pid, {**ports, **new}):
                return new
        return {} if self.allowed(state, pid, ports) else None

    def allowed(self, state: State, pid: int, after: Mapping[str, Any]) -> bool:
        before = state.robots[pid].ports
        return all(
            holds_assumption(rule, self.program, before, after, pid, self.n_sys, state.params)
            for module in self.program.modules
            for rule in module.assumptions
        )


def ran(program: decl.Program, proved: frozenset[str], seed: int, effort: Effort) -> Contradiction | None:
    """The first violation of what is PROVED in some random runs. Raises MissingEnvironment."""
    random = Random(seed)
    for n_sys in FLEETS:
        runs = _Runs(program, proved, n_sys, random)
        for _ in range(effort.runs):
            try:
                runs.run(effort.length)
            except _Broken as broken:
                return Contradiction(str(broken), "run", n_sys, "\n".join(runs.run_states))
    return None


# The attack


def attacked(
    program: decl.Program, proved: frozenset[str], seed: int, effort: Effort, solver: Solver | CrossCheck | None = None
) -> Contradiction | None:
    """The contradiction that the attack of `koordgen prove` finds, with states from a solver where there is one."""
    found = attack(program, proved, solver=solver, seconds=effort.attacking, seed=seed).contradiction
    if found is None:
        return None
    acts = [f"{act.event} of {act.pid}" if act.pid is not None else act.event for act in found.trial.acts]
    story = [f"{found.breach.why}, after {', '.join(acts)}", *map(str, (found.trial.state, found.before, found.after))]
    return Contradiction(found.breach.invariant, "attack", len(found.before.robots), "\n".join(story))
