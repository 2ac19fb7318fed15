"""Systems for tests of the explorer: brute force by the semantics, and random compositions with properties."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Mapping
from itertools import count, product
from random import Random
from typing import Any, NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.ports import clearable
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.property import holds_assumption, holds_property
from koordgen.lang.semantics.relations import instance_choices
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.system import (
    InstanceStep,
    SystemState,
    applied_to_system,
    initial_system,
    run_inits,
    view,
)
from koordgen.lang.semantics.values import Value
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import Environment, SensorDomain
from koordgen.verify.explore.system.environment import SystemEnvironmentSteps, answers
from koordgen.verify.explore.system.machine import SystemMachine
from koordgen.verify.explore.system.search import SystemResult, SystemSearch
from koordgen.verify.prove.report.model import failing_conjunct
from tests.lang.semantics.compositions import NAMES, compiled, text

NOTHING = Environment({}, {})
COMMANDED = "(commanded)"  # mark among a robot's ports: its cleared sensors no longer stay true


def search(system: System, around: Environment = NOTHING, rounds: int | None = None, **switches: Any) -> SystemSearch:
    """Return a search that has not begun. Each look at its clock takes a thousandth of a second."""
    machine, ticks = SystemMachine(system, answers(system, around)), count()
    bounds = switches.pop("bounds", ExplorationBounds(rounds=rounds))
    steps = SystemEnvironmentSteps(machine, around)
    return SystemSearch(machine, steps, bounds, lambda: next(ticks) / 1000, lambda _: None, **switches)


def explored(
    system: System, around: Environment = NOTHING, rounds: int | None = None, **switches: Any
) -> tuple[SystemSearch, SystemResult]:
    made = search(system, around, rounds, **switches)
    return made, made.run()


def key(system: System, state: SystemState) -> Hashable:
    """Return a key that is different for different states. It ignores the number of the round."""
    ports = [{name: value for name, value in ports.items() if name != COMMANDED} for ports in state.ports]
    return whole_key(state._replace(ports=tuple(ports)))


def whole_key(state: SystemState) -> Hashable:
    """Return a key that also distinguishes whether a robot has had a command."""
    stores = [(sorted(s.slots.items()), sorted(s.cells.items())) for s in state.stores]
    locals_ = [[sorted(own.items()) for own in of] for of in state.locals]
    return repr((locals_, state.stopped, stores, [sorted(ports.items()) for ports in state.ports]))


class Taken(NamedTuple):
    """Step of an instance in a round: the state before it, the instance, its event, and the state after it."""

    before: SystemState
    instance: int
    event: str
    after: SystemState


def steps(system: System, begun: SystemState) -> tuple[dict[Hashable, SystemState], list[Taken]]:
    """Return all states in a round from the state `begun`, and all steps: every order, choice and skip."""
    taken = list[Taken]()
    pending = {(frozenset[int](), whole_key(begun)): begun}
    queue = list(pending)
    for acted, name in queue:  # the loop body appends to `queue`
        state = pending[acted, name]
        for number in set(range(len(system.instances()))) - acted:
            for step in instance_choices(system, state, begun, number):
                if step.event is None:
                    continue
                after = applied_to_system(system, state, InstanceStep(number, step))
                if isinstance(step.outcome, Writes) and step.outcome.ports:
                    after = commanded(after, system.instances()[number].robot)
                taken.append(Taken(state, number, step.event, after))
                node = (acted | {number}, whole_key(after))
                if node not in pending:
                    pending[node] = after
                    queue.append(node)
    return {name: state for (_, name), state in pending.items()}, taken


def commanded(state: SystemState, robot: int) -> SystemState:
    """Return the state with the mark that the robot has had a command."""
    ports = [{**held, COMMANDED: True} if robot == place else held for place, held in enumerate(state.ports)]
    return state._replace(ports=tuple(ports))


def started(system: System, around: Environment = NOTHING) -> Iterator[SystemState]:
    """Yield all states after `init`."""
    for sensors in starts(system, around):
        state = initial_system(system, sensors)
        rules = [
            (rule, application.program, index)
            for index, application in enumerate(system.applications)
            for rule in application.program.properties
            if rule.kind == "initially"
        ]
        if all(holds_property(rule, program, view(system, state, index)) for rule, program, index in rules):
            yield run_inits(system, state)[0]


def starts(system: System, around: Environment) -> Iterator[tuple[Mapping[str, Value], ...]]:
    each = [
        [
            dict(zip(names, values, strict=True))
            for values in product(*[(True,) if n in unset(system, robot) else around.domains[n].values for n in names])
        ]
        for robot in range(system.robots)
        for names in [sensors(system, robot)]
    ]
    yield from product(*each)


def unset(system: System, robot: int) -> frozenset[str]:
    """Return the sensors that commands of a robot's applications clear."""
    programs = [application.program for application in system.applications if robot in application.members]
    return frozenset[str]().union(*map(clearable, programs))


def sensors(system: System, robot: int) -> list[str]:
    """Return the sensors that the applications of a robot read."""
    ports = [
        f"{module.name}.{port.name}"
        for application in system.applications
        if robot in application.members
        for module in application.program.modules
        for port in module.ports
        if port.direction == "sensor"
    ]
    return list(dict.fromkeys(ports))


def moved(system: System, state: SystemState, around: Environment) -> Iterator[SystemState]:
    """Yield all states after the environment's step. All sensors may change as the assumptions allow."""
    each = []
    for robot, held in enumerate(state.ports):
        names, still = sensors(system, robot), frozenset[str]() if COMMANDED in held else unset(system, robot)
        pools = [(True,) if name in still else around.domains[name].values for name in names]
        news = [{**held, **dict(zip(names, values, strict=True))} for values in product(*pools)]
        each.append([new for new in news if allowed(system, robot, held, new)])
    for ports in product(*each):
        yield state._replace(ports=tuple(ports))


def allowed(system: System, robot: int, before: Mapping[str, Value], after: Mapping[str, Value]) -> bool:
    return all(
        holds_assumption(rule, application.program, before, after, application.members.index(robot), n_sys, {})
        for application in system.applications
        if robot in application.members
        for n_sys in [len(application.members)]
        for module in application.program.modules
        for rule in module.assumptions
    )


class BruteForce(NamedTuple):
    """All that can happen in some rounds, by the executable semantics.

    `states`: the states at the ends of rounds. `broken`: the properties that are false, as (application, name), with
    the number of rounds after which each is false for the first time."""

    states: set[Hashable]
    broken: dict[tuple[int, str], int]


def brute_force(system: System, rounds: int, around: Environment = NOTHING, most: int = 10**9) -> BruteForce | None:
    """Explore by the semantics. Return None if there are more than `most` states."""
    layer = {whole_key(state): state for state in started(system, around)}
    found, broken = dict(layer), dict[tuple[int, str], int]()
    judge(system, layer.values(), 0, broken)
    for number in range(1, rounds + 1):
        following = dict[Hashable, SystemState]()
        for state in layer.values():
            ends, taken = steps(system, state)
            judge(system, ends.values(), number, broken)
            for each in taken:
                judge_step(system, each, number, broken)
            for end in ends.values():
                following |= {whole_key(m): m for m in moved(system, end, around)}
            if len(following) + len(found) > most:
                return None
        judge(system, following.values(), number, broken)
        layer = {name: state for name, state in following.items() if name not in found}
        found |= layer
    return BruteForce({key(system, state) for state in found.values()}, broken)


def judge(system: System, states: Any, number: int, broken: dict[tuple[int, str], int]) -> None:
    """Add to `broken` the invariants and state guarantees that are false in one of the states."""
    for state in states:
        for index, application in enumerate(system.applications):
            seen, program = view(system, state, index), application.program
            for name, failed in false_in(program, seen):
                if failed:
                    broken.setdefault((index, name), number)


def false_in(program: decl.Program, seen: State) -> Iterator[tuple[str, bool]]:
    for property_ in program.properties:
        if property_.kind == "invariant":
            yield property_.name, failing_conjunct(property_, program, seen) is not None
    for export in program.exports:
        for guarantee in export.guarantees:
            if not decl.is_step(guarantee):
                values = {guarantee.before: value(seen, export.variable)}
                yield guarantee.name, failing_conjunct(guarantee, program, seen, values) is not None


def judge_step(system: System, taken: Taken, number: int, broken: dict[tuple[int, str], int]) -> None:
    """Note the step guarantees that are false between the states before and after a step that changes the variable."""
    for index, application in enumerate(system.applications):
        for export in application.program.exports:
            for guarantee in filter(decl.is_step, export.guarantees):
                before, after = (view(system, state, index) for state in (taken.before, taken.after))
                old, new = value(before, export.variable), value(after, export.variable)
                values = {guarantee.before: old, guarantee.after: new}
                if old != new and failing_conjunct(guarantee, application.program, after, values):
                    broken.setdefault((index, guarantee.name), number)


def value(state: State, variable: str) -> Value:
    return state.store.slots[variable] if variable in state.store.slots else state.store.cells[variable]


def guarded_system(seed: int, robots: int = 2, small: int = 3) -> System:
    """Return a random composition whose applications have invariants and guarantees, some of which are false.

    Numbers stay below `small`, so that there are few states. No event can be discarded."""
    rng = Random(seed)
    names, applications = NAMES[: rng.randrange(2, 4)], []
    for index, name in enumerate(names):
        exporters = [other for other in names[:index] if rng.random() < 0.8]
        members = sorted(rng.sample(range(robots), rng.randrange(1, robots + 1)))
        given = re.sub(r"= \w+_x\[(k|seen)\]", "= 1", text(rng, name, exporters).replace("% 7", f"% {small}"))
        program = compiled(name, guarded(rng, name, given, exporters))
        bindings = tuple([(exporter.title(), exporter) for exporter in exporters])
        applications.append(Application(name, program, tuple(members), bindings))
    return System(tuple(applications), robots)


def guarded(rng: Random, name: str, given: str, exporters: list[str]) -> str:
    """Return a program with random guarantees of its exports, and random invariants."""
    a, b, x = f"{name}_a", f"{name}_b", f"{name}_x"
    low, lower = rng.randrange(1, 4), rng.randrange(1, 3)
    guarantees = {
        f"  write int {a}": [f"{a} <= {low}", f"{a}' <= {a} + {lower}", f"{a} <= {a}'"],
        f"  int {b}": [f"{b} < {low}", f"{b}' <= {b} + {lower}"],
        f"  int {x}[N_SYS]": [f"forall i in ID: {x}[i] <= {low}", f"sum({x}') <= sum({x}) + {lower}"],
    }
    for number, (line, options) in enumerate(guarantees.items()):
        if rng.random() < 0.6:
            kept = f"{line}\n    guarantee {name.title()}{number}: {rng.choice(options)}\n"
            given = given.replace(f"{line}\n", kept, 1)
    terms = [a, b, f"sum({x})", *[f"{e}_a" for e in exporters], *[f"sum({e}_x)" for e in exporters]]
    terms += [f"{e.title()}.N_SYS" for e in exporters]
    for number in range(2):
        bound = f"{rng.choice(terms)} + {rng.randrange(1, 4)}"
        options = [f"{rng.choice(terms)} <= {bound}", f"forall i in ID: k[i] <= {bound}"]
        options.append(f"forall i, j in ID: i == j or {x}[i] + seen[j] <= {bound}")
        if exporters:
            options.append(f"forall i in ID: {exporters[0].title()}.pid[i] < 1 or {rng.choice(terms)} < 2")
        given += f"invariant Inv{number}: {rng.choice(options)}\n"
    return given


def random_body_system(seed: int) -> tuple[System, Environment]:
    """Return a composition on two robots whose applications share a body, with the values of its sensors.

    The first application commands and the others read. They have an assumption each."""
    rng = Random(seed)
    assumed = ("level' <= level + 1", "level' >= level", "not reached' or level' > 0", "level' != 1 or level == 1")
    applications = []
    for index, name in enumerate(NAMES[: rng.randrange(2, 4)]):
        ports = "  sensors:\n    int level\n    bool reached\n"
        if not index:
            ports += "  actuators: int goal at level clears reached\n"
        lines = f"using Dev:\n{ports}  assume {rng.choice(assumed)}\nlocal: int k\nallwrite: int {name}_a\n"
        values = ["k", "Dev.level", f"{name}_a", "pid", "1"]
        targets = ["k", f"{name}_a", *([] if index else ["Dev.goal", "Dev.goal"])]
        for number in range(2):
            guard = rng.choice(("Dev.reached", "not Dev.reached", f"k <= {rng.choice(values)}"))
            effects = [f"{rng.choice(targets)} = ({rng.choice(values)} + {rng.choice(values)}) % 2" for _ in range(2)]
            head = "  eff:\n    atomic:\n      " if rng.random() < 0.5 else "  eff:\n    "
            indent = head.rpartition("\n")[2]
            lines += f"E{number}:\n  pre: {guard}\n{head}" + f"\n{indent}".join(effects) + "\n"
        lines += f"invariant Inv: forall i in ID: Dev.reached[i] or k[i] <= {rng.choice(('Dev.level[i]', '1'))}\n"
        lines += "initially: forall i in ID: Dev.level[i] <= 1\n"
        members = sorted(rng.sample(range(2), rng.randrange(1, 3)))
        applications.append(Application(name, compiled(name, lines), tuple(members)))
    domains = {"Dev.level": SensorDomain((0, 1)), "Dev.reached": SensorDomain((False, True))}
    return System(tuple(applications), 2), Environment(domains, {})
