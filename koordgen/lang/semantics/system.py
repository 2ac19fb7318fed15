"""Semantics of several applications on one fleet (ADR 0055). All functions are pure.

The state of a system has the variables of all applications. A *view* is the state of one application in it, with the
names of its program; each instance runs on a view by the semantics of a single program (step.py), and its writes are
put back. A system with one application therefore has the meaning of its program.

`system_round` computes the result that agents compute. In a round each instance picks its event on the state at the
round's start and sees no other instance's writes of that round. Of the instances that want a lock, the one with the
least (instance - round - lock) mod instances commits; an instance whose event is discarded wants none. The writes of
commits take effect first, then those of the other events by instance; the last write of a variable remains.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple, TypeVar

from koordgen.lang.ir import decl
from koordgen.lang.semantics import step as single
from koordgen.lang.semantics.composition import Instance, System
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import NOTHING, Robot, State, Store, World
from koordgen.lang.semantics.step import Step
from koordgen.lang.semantics.values import Value

T = TypeVar("T")


class SystemState(NamedTuple):
    """State of a system at a round's start.

    Tuples by application: `params`, `locals` and `stopped` (each by pid), and `stores`, which contain the variables
    that the application itself declares.
    `ports`: the ports of each robot, "Module.port" -> value; the applications of a robot see the same ports.
    `round`: number of the round that begins; 0 before `init` has run.
    """

    params: tuple[Mapping[str, Value], ...]
    locals: tuple[tuple[Mapping[str, Value], ...], ...]
    stopped: tuple[tuple[bool, ...], ...]
    stores: tuple[Store, ...]
    ports: tuple[Mapping[str, Value], ...]
    round: int


class InstanceStep(NamedTuple):
    """Step of one instance in a round; see Step."""

    instance: int
    step: Step


def initial_system(system: System, sensors: Sequence[Mapping[str, Value]] = ()) -> SystemState:
    """Return the state before any `init` has run. `sensors`: first values of each robot's sensors, by place."""
    states = []
    for application in system.applications:
        given = [sensors[robot] if robot < len(sensors) else {} for robot in application.members]
        states.append(single.initial(application.program, len(application.members), given))
    ports: list[Mapping[str, Value]] = [dict(sensors[r]) if r < len(sensors) else {} for r in range(system.robots)]
    for application, state in zip(system.applications, states, strict=True):
        for pid, robot in enumerate(application.members):
            ports[robot] = {**state.robots[pid].ports, **ports[robot]}
    return SystemState(
        tuple([state.params for state in states]),
        tuple([_own_locals(a.program, state.robots) for a, state in zip(system.applications, states, strict=True)]),
        tuple([(False,) * len(application.members) for application in system.applications]),
        tuple([_own(system, index, state.store) for index, state in enumerate(states)]),
        tuple(ports),
        0,
    )


def _own_locals(program: decl.Program, robots: Sequence[Robot]) -> tuple[Mapping[str, Value], ...]:
    """Return the local variables of robots without those that imports add."""
    added = {imported.pid for imported in program.imports}
    return tuple([{name: value for name, value in robot.locals.items() if name not in added} for robot in robots])


def _own(system: System, application: int, store: Store) -> Store:
    """Return a store without imported variables."""
    names = {variable.name for variable in system.own(application)}
    return Store(
        {name: value for name, value in store.slots.items() if name in names},
        {name: value for name, value in store.cells.items() if name in names},
    )


def view(system: System, state: SystemState, application: int) -> State:
    """Return the state of one application, as its program sees it."""
    program, members = system.applications[application].program, system.applications[application].members
    params, own = dict(state.params[application]), state.stores[application]
    cells, pids = dict(own.cells), list[dict[str, Value]]({} for _ in members)
    for imported in program.imports:
        exporter = system.exporter(application, imported)
        others, store = system.applications[exporter].members, state.stores[exporter]
        params[imported.size] = len(others)
        for names, robot in zip(pids, members, strict=True):
            names[imported.pid] = others.index(robot) if robot in others else -1
        for name in imported.variables:
            cells[name] = store.slots[name] if name in imported.slots else store.cells[name]
    used = {f"{module.name}.{port.name}" for module in program.modules for port in module.ports}
    robots = tuple(
        Robot(
            {**state.locals[application][pid], **pids[pid]},
            {name: value for name, value in state.ports[robot].items() if name in used},
            state.stopped[application][pid],
        )
        for pid, robot in enumerate(members)
    )
    return State(params, robots, Store(own.slots, cells), state.round)


def run_inits(
    system: System, state: SystemState, worlds: Mapping[int, World] | None = None
) -> tuple[SystemState, list[InstanceStep]]:
    """Run `init` for every instance, each on the initial values. The next round is 1."""
    steps = []
    for number, instance in enumerate(system.instances()):
        program, seen = system.applications[instance.application].program, view(system, state, instance.application)
        done = single.execute(program, program.init, seen, instance.pid, _world(worlds, instance))
        steps.append(InstanceStep(number, Step(instance.pid, None, done)))
    return _all_applied(system, state, steps)._replace(round=1), steps


def system_round(
    system: System, state: SystemState, skipping: Collection[int] = (), worlds: Mapping[int, World] | None = None
) -> tuple[SystemState, list[InstanceStep]]:
    """Run the step of one round. Return the next state, and the steps in the order of their effects.

    Instances in `skipping`, by their numbers, and stopped instances take no step. `worlds`: the world of each
    application, by its index.
    """
    instances, locks = system.instances(), system.locks()
    views = [view(system, state, index) for index in range(len(system.applications))]
    taken: list[tuple[InstanceStep, int | None]] = []  # each instance's step, and the lock that it wants
    for number, instance in enumerate(instances):
        step, lock = Step(instance.pid, None, None), None
        if not state.stopped[instance.application][instance.pid] and number not in skipping:
            program, world = system.applications[instance.application].program, _world(worlds, instance)
            step, wanted = _step(program, views[instance.application], instance.pid, world)
            lock = None if wanted is None else locks[instance.application, wanted]
        taken.append((InstanceStep(number, step), lock))
    holders = _holders(taken, len(instances), state.round)
    commits, plain = list[InstanceStep](), list[InstanceStep]()
    for done, lock in taken:
        if lock is None:
            plain.append(done)
        elif holders[lock] == done.instance:
            commits.append(done)
        else:
            plain.append(InstanceStep(done.instance, Step(done.step.pid, None, None)))
    steps = commits + plain
    return _all_applied(system, state, steps)._replace(round=state.round + 1), steps


def _step(program: decl.Program, seen: State, pid: int, world: World) -> tuple[Step, int | None]:
    """Return the step of one instance, and the program's lock that it needs; None if it needs none."""
    event = single.select(program, seen, pid, world)
    if event is None or isinstance(event, Step):
        return event or Step(pid, None, None), None
    done = single.execute(program, event.effect, seen, pid, world)
    return Step(pid, event.name, done), event.lock if isinstance(done, Writes) else None


def _holders(taken: Sequence[tuple[InstanceStep, int | None]], instances: int, round_: int) -> dict[int, int]:
    """Return the instance that commits on each lock: priority rotates with the round, so no instance starves."""
    wanted: dict[int, list[int]] = {}
    for done, lock in taken:
        if lock is not None:
            wanted.setdefault(lock, []).append(done.instance)
    return {
        lock: min(((number - round_ - lock) % instances, number) for number in numbers)[1]
        for lock, numbers in wanted.items()
    }


def _world(worlds: Mapping[int, World] | None, instance: Instance) -> World:
    return NOTHING if worlds is None else worlds.get(instance.application, NOTHING)


def applied_to_system(system: System, state: SystemState, done: InstanceStep) -> SystemState:
    """Return the state after one instance's step: puts its writes into the variables of their owners."""
    outcome = done.step.outcome
    if not isinstance(outcome, Writes):
        return state
    instance = system.instances()[done.instance]
    application, pid = instance.application, instance.pid
    program = system.applications[application].program
    after = single.applied(program, view(system, state, application), done.step)
    (own,) = _own_locals(program, after.robots[pid : pid + 1])
    stores = list(state.stores)
    for name in outcome.slots:
        store = stores[application]
        stores[application] = Store({**store.slots, name: after.store.slots[name]}, store.cells)
    for name in outcome.cells:
        owner = system.owner(application, name)
        stores[owner] = Store(stores[owner].slots, {**stores[owner].cells, name: after.store.cells[name]})
    ports = list(state.ports)
    ports[instance.robot] = {**ports[instance.robot], **after.robots[pid].ports}
    return state._replace(
        locals=_with(state.locals, application, pid, own),
        stopped=_with(state.stopped, application, pid, after.robots[pid].stopped),
        stores=tuple(stores),
        ports=tuple(ports),
    )


def _with(values: tuple[tuple[T, ...], ...], application: int, pid: int, value: T) -> tuple[tuple[T, ...], ...]:
    of = values[application]
    return (*values[:application], (*of[:pid], value, *of[pid + 1 :]), *values[application + 1 :])


def _all_applied(system: System, state: SystemState, steps: Sequence[InstanceStep]) -> SystemState:
    for done in steps:
        state = applied_to_system(system, state, done)
    return state


def joined(system: System, views: Sequence[State]) -> SystemState:
    """Return the state of a system whose applications have these views: the inverse of `view`."""
    ports: list[Mapping[str, Value]] = [{} for _ in range(system.robots)]
    for application, seen in zip(system.applications, views, strict=True):
        for robot, held in zip(application.members, seen.robots, strict=True):
            ports[robot] = {**ports[robot], **held.ports}
    return SystemState(
        tuple([seen.params for seen in views]),
        tuple([_own_locals(a.program, seen.robots) for a, seen in zip(system.applications, views, strict=True)]),
        tuple([tuple([robot.stopped for robot in seen.robots]) for seen in views]),
        tuple([_own(system, index, seen.store) for index, seen in enumerate(views)]),
        tuple(ports),
        views[0].round,
    )
