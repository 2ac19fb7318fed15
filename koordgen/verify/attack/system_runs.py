"""Attack on the PROVED verdicts of a composition: random runs of several applications on one fleet.

Each run has a random fleet: the proofs hold for every number of robots. In half of the rounds the instances act as
agents do (`system_round`), in the others in a random order, each with a random event that the language allows. After
every step, each PROVED invariant is evaluated on the view of its application, and each PROVED guarantee on the
variables that were written. Numbers are exact, as in the prover.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from koordgen.lang.diagnostics import InternalError
from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import PortCall
from koordgen.lang.ir.tree import walk
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exact import NotExact, exact, made_exact
from koordgen.lang.semantics.exec import NoMeaning, Writes
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.relations import choices
from koordgen.lang.semantics.state import State, Store
from koordgen.lang.semantics.system import (
    InstanceStep,
    SystemState,
    applied_to_system,
    initial_system,
    run_inits,
    system_round,
    view,
)
from koordgen.lang.semantics.values import Value
from koordgen.verify.attack.states import States
from koordgen.verify.prove.encode.loop import written
from koordgen.verify.prove.obligations.guarantees import FIRST_VALUES, REFLEXIVE, TRANSITIVE
from koordgen.verify.prove.obligations.interface import OTHERS, GuaranteeInScope, in_scope
from koordgen.verify.prove.report.model import exact_all, guarantee_failure, is_allowed
from koordgen.verify.prove.report.model_reader import Unshowable
from koordgen.verify.prove.smt.obligation import Obligation

SECONDS = 0.1  # default time budget in seconds
ROBOTS = 3  # largest fleet of a run
ROUNDS = 8  # length of a run, in rounds
TRIES = 12  # attempts to draw the first state of a run
SKIPS = 0.15  # probability that an instance takes no step in a round
INIT, ENVIRONMENT = "init", "(environment)"


class SystemContradiction(NamedTuple):
    """Step of a run after which a PROVED property is false.

    `application`, `name`: the application and its invariant, or the guarantee as "guarantee mapping.Kept".
    `steps`: the run, one text for each step; the last step is the one that contradicts.
    `robots`: the number of robots in the fleet of the run."""

    application: str
    name: str
    steps: tuple[str, ...]
    robots: int


class SystemAttack(NamedTuple):
    """Result of an attack on a composition.

    `judged`: (application, step) -> number of states in which its PROVED properties were evaluated after the step. A
        step is an event's name, "init", "(first values)" or "(other applications)".
    `unjudged`: (application, property) -> the reason why the property has no value in runs.
    `reason`: the reason why there are no runs; "" if there are."""

    judged: Mapping[tuple[int, str], int]
    unjudged: Mapping[tuple[int, str], str]
    reason: str
    contradiction: SystemContradiction | None

    def of(self, application: int, step: str, name: str) -> tuple[int, str]:
        """Return the number of states in which a property was evaluated after a step, and the reason if it is 0."""
        if (application, name) in self.unjudged:
            return 0, self.unjudged[application, name]
        count = self.judged.get((application, step), 0)
        return (count, "") if count else (0, self.reason or "no run made this step")

    def of_obligation(self, application: int, obligation: Obligation) -> tuple[int, str]:
        """Return the number of states in which an obligation was attacked, and the reason if it is 0."""
        if obligation.kind in ("loop", "well-defined"):
            return 0, "runs of several applications judge states, not operations and loops"
        if obligation.event in (REFLEXIVE, TRANSITIVE):
            return 0, "runs judge each write of a variable, not pairs of its values"
        step = {"base": INIT, "interference": OTHERS}.get(obligation.kind, obligation.event)
        return self.of(application, step, obligation.invariant)


class _Contradicted(Exception):
    def __init__(self, application: int, name: str) -> None:
        super().__init__(name)
        self.application, self.name = application, name


def attack_system(
    system: System, proved: Sequence[Collection[str]], seconds: float = SECONDS,
    clock: Callable[[], float] = time.process_time, seed: int = 0,
) -> SystemAttack:  # fmt: skip
    """Search for a run that contradicts a PROVED invariant or guarantee.

    `proved`: the names of the PROVED properties of each application. `seconds`: the budget on `clock`."""
    attack = _Runs(system, proved, Random(seed))
    attack.reason = _unfit(system)
    until = clock() + seconds
    contradiction = None
    while not attack.reason and clock() < until:
        attack.steps = []
        try:
            for _ in attack.run():
                if clock() > until:
                    break
        except _Contradicted as found:
            name = system.applications[found.application].name
            contradiction = SystemContradiction(name, found.name, tuple(attack.steps), attack.system.robots)
            break
        except (NotExact, Unshowable, InternalError):
            continue  # a number without an exact value, or a formula that cannot be evaluated: the run ends
    if not attack.reason and not attack.judged:
        attack.reason = "no run was found whose first state satisfies `initially`"
    return SystemAttack(attack.judged, attack.unjudged, attack.reason, contradiction)


def _unfit(system: System) -> str:
    """Return why the applications cannot be run here; "" if they can."""
    for application in system.applications:
        program = application.program
        if program.externs or any(isinstance(node, PortCall) for node in walk(program)):
            return f"{application.name} calls extern functions or planners, which runs of several applications lack"
    return ""


class _Runs:
    def __init__(self, system: System, proved: Sequence[Collection[str]], random: Random) -> None:
        self.random, self.proved = random, [frozenset(names) for names in proved]
        applications = [replace(a, program=exact(a.program)) for a in system.applications]
        self.whole = replace(system, applications=tuple(applications))
        self.system = self.whole
        self.states = [States(a.program, (), random) for a in applications]
        self.guarantees = [self._own_guarantees(index) for index in range(len(applications))]
        self.judged: Counter[tuple[int, str]] = Counter()
        self.unjudged: dict[tuple[int, str], str] = {}
        self.steps: list[str] = []
        self.reason = ""

    def _own_guarantees(self, index: int) -> list[GuaranteeInScope]:
        own = [g for g in in_scope(self.whole, index).interface.guarantees if g.is_own]
        return [g for g in own if all(g.label in self.proved[other] for other in self._scope(index, g.key[1]))]

    def _scope(self, owner: int, variable: str) -> Iterator[int]:
        """Yield the applications that write a variable, and so have a verdict about its guarantees; the owner first."""
        yield owner
        for index, application in enumerate(self.whole.applications):
            program = application.program
            blocks = [program.init, *[event.effect for event in program.events]]
            writes = any(("cell", variable) in written(block) for block in blocks)
            if writes and index != owner and self.whole.owner(index, variable) == owner:
                yield index

    def run(self) -> Iterator[None]:
        """Run a random fleet from its first state. Raises _Contradicted."""
        robots = self.random.randint(1, ROBOTS)
        members = [self.random.sample(range(robots), self.random.randint(1, robots)) for _ in self.whole.applications]
        parts = zip(self.whole.applications, members, strict=True)
        self.system = System(tuple([replace(a, members=tuple(sorted(m))) for a, m in parts]), robots)
        state = self.first()
        if state is None:
            return
        for index in range(len(self.system.applications)):
            for guarantee in self.guarantees[index]:
                if not guarantee.is_step:
                    self.check_guarantee(index, guarantee, view(self.system, state, index), None)
            self.judged[index, FIRST_VALUES] += 1
        after, steps = run_inits(self.system, state)
        if any(isinstance(done.step.outcome, Discarded) for done in steps):
            return
        self.steps.append("init")
        self.check(after, dict.fromkeys(range(len(self.system.applications)), INIT))
        for index in range(len(self.system.applications)):
            for guarantee in self.guarantees[index]:
                if not guarantee.is_step:
                    self.check_guarantee(index, guarantee, view(self.system, after, index), None)
        state = after
        for _ in range(ROUNDS):
            for at in self.round(state):
                state = at
                yield
            moved = self.moved(state)
            if moved is None:
                return
            state = moved._replace(round=moved.round + 1)

    def first(self) -> SystemState | None:
        """Draw a state before `init` in which all `initially` hold; None if none is found."""
        for attempt in range(TRIES):
            ports: list[dict[str, Value]] = [{} for _ in range(self.system.robots)]
            order = sorted(range(len(self.states)), key=lambda i: bool(self.states[i].held or self.states[i].cleared))
            for index in order:  # the owner of a body last: it knows which sensors are true before a command
                members = self.system.applications[index].members
                launched = self.states[index].launch(len(members), attempt, lambda _: True)
                assert launched is not None
                for robot, place in zip(launched.robots, members, strict=True):
                    ports[place] |= robot.ports
            state = exact_system(initial_system(self.system, ports))
            if all(self.begins(index, view(self.system, state, index)) for index in range(len(self.states))):
                return state
        return None

    def begins(self, index: int, state: State) -> bool:
        program = self.system.applications[index].program
        try:
            return all(holds_property(p, program, state) for p in program.properties if p.kind == "initially")
        except (Discarded, NoMeaning):
            return False

    def round(self, state: SystemState) -> Iterator[SystemState]:
        """Run one round, and yield the state after each step."""
        numbers = list(range(len(self.system.instances())))
        if self.random.random() < 0.5:
            skipping = [number for number in numbers if self.random.random() < SKIPS]
            _, steps = system_round(self.system, state, skipping)
            for done in steps:
                state = self.step(state, done)
                yield state
            return
        begun = state
        for number in self.random.sample(numbers, len(numbers)):
            instance = self.system.instances()[number]
            program = self.system.applications[instance.application].program
            now = view(self.system, state, instance.application)
            store = view(self.system, begun, instance.application).store
            found = choices(program, now, instance.pid, store)
            step = self.random.choice(found[1:] if len(found) > 1 and self.random.random() > SKIPS else found)
            state = self.step(state, InstanceStep(number, step))
            yield state

    def step(self, state: SystemState, done: InstanceStep) -> SystemState:
        """Apply one instance's step, and check every PROVED property after it."""
        outcome, event = done.step.outcome, done.step.event
        if not isinstance(outcome, Writes) or event is None:
            return state
        instance = self.system.instances()[done.instance]
        acting = instance.application
        after = applied_to_system(self.system, state, done)
        name = self.system.applications[acting].name
        self.steps.append(f"{event} of {name} on robot {instance.robot} in round {state.round}")
        others = dict.fromkeys(range(len(self.system.applications)), OTHERS)
        self.check(after, {**others, acting: event})
        for variable in (*outcome.cells, *outcome.slots):
            owner = self.system.owner(acting, variable)
            before, later = view(self.system, state, owner), view(self.system, after, owner)
            for guarantee in self.guarantees[owner]:
                if guarantee.key[1] == variable:
                    self.check_guarantee(owner, guarantee, before if guarantee.is_step else later, later)
        return after

    def check(self, state: SystemState, steps: Mapping[int, str]) -> None:
        """Evaluate the PROVED invariants. `steps`: what the step is to each application."""
        for index, application in enumerate(self.system.applications):
            seen = view(self.system, state, index)
            self.judged[index, steps[index]] += 1
            judged = [
                p for p in application.program.properties if p.kind == "invariant" and p.name in self.proved[index]
            ]
            for property_ in judged:
                if (index, property_.name) not in self.unjudged and not self.holds(index, property_, seen):
                    raise _Contradicted(index, property_.name)

    def holds(self, index: int, property_: decl.Property, state: State) -> bool:
        try:
            return holds_property(property_, self.system.applications[index].program, state)
        except Discarded:
            return False
        except NoMeaning as error:
            self.unjudged[index, property_.name] = str(error)
            return True

    def check_guarantee(self, owner: int, guarantee: GuaranteeInScope, before: State, after: State | None) -> None:
        if (owner, guarantee.label) in self.unjudged:
            return
        try:
            failed = guarantee_failure(guarantee, self.system.applications[owner].program, before, after or before)
        except NoMeaning as error:
            self.unjudged |= {(index, guarantee.label): str(error) for index in range(len(self.states))}
            return
        if failed is not None:
            raise _Contradicted(owner, guarantee.label)

    def moved(self, state: SystemState) -> SystemState | None:
        """Return the state after a step of the environment; None if no drawn sensor values are allowed."""
        views = [view(self.system, state, index) for index in range(len(self.states))]
        ports = list(state.ports)
        for place in range(self.system.robots):
            running = [
                (i, a.members.index(place)) for i, a in enumerate(self.system.applications) if place in a.members
            ]
            proposals = [self.states[index].moves(views[index], pid) for index, pid in running]
            for drawn in zip(*proposals, strict=False):
                new: dict[str, Any] = dict(state.ports[place])
                for values in drawn:
                    new |= values
                if all(self.allowed(index, pid, views[index], new) for index, pid in running):
                    ports[place] = new
                    break
            else:
                if running and not all(self.allowed(i, pid, views[i], state.ports[place]) for i, pid in running):
                    return None
        moved = state._replace(ports=tuple(ports))
        if moved.ports != state.ports:
            self.steps.append(ENVIRONMENT)
            self.check(moved, dict.fromkeys(range(len(self.states)), ENVIRONMENT))
        return moved

    def allowed(self, index: int, pid: int, state: State, new: Mapping[str, Value]) -> bool:
        old = state.robots[pid].ports
        return is_allowed(self.system.applications[index].program, old, {n: new[n] for n in old}, pid, state)


def exact_system(state: SystemState) -> SystemState:
    """Return a state in which all numbers are fractions."""
    stores = state.stores
    return SystemState(
        tuple(map(exact_all, state.params)),
        tuple([tuple(map(exact_all, robots)) for robots in state.locals]),
        state.stopped,
        tuple([Store({n: tuple(map(made_exact, v)) for n, v in s.slots.items()}, exact_all(s.cells)) for s in stores]),
        tuple(map(exact_all, state.ports)),
        state.round,
    )  # fmt: skip
