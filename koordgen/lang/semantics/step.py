"""Semantics of a program: init, one event of one robot, a round. Pure; tests compare agents with it.

Of the rounds that the language allows, `round_` is the one that agents execute. Each robot runs the first event in text
order whose guard holds, on the shared store as it was at the round's start. The commits of atomic events come first, at
most one for each lock, then the plain events by ascending pid: if several robots write an allwrite variable, the last
write counts. All writes of one event take effect together. relations.py has all other rounds.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.ports import clears, held
from koordgen.lang.semantics.eval import Discarded, View, evaluate, holds
from koordgen.lang.semantics.exec import Budget, Writes, constant, library, run
from koordgen.lang.semantics.state import NOTHING, Robot, State, Store, World, nobody
from koordgen.lang.semantics.values import RecordValue, Value, default


class Step(NamedTuple):
    """Step of one robot in a round.

    `event` is None for init and if no guard held. `outcome` is None if the robot skipped the round.
    """

    pid: int
    event: str | None
    outcome: Writes | Discarded | None


def initial(program: decl.Program, n_sys: int, sensors: Sequence[Mapping[str, Value]] = ()) -> State:
    """Return the state before init.

    All variables have their initial values. `sensors` has values by robot and "Module.port". An actuator without a
    command has the value of the sensor that it holds at, so a `target` is the robot's position, unless it is given.
    """
    constants = library(program, n_sys, {}, NOTHING, Budget(), no_port)
    params = {p.name: constant(p.default, constants, p.type) for p in program.params}
    constants = constants._replace(params=params)
    variables: list[decl.Local | decl.Shared] = [*program.locals, *program.shared]
    first = {v.name: constant(v.initial, constants, v.type) for v in variables}
    locals_ = {v.name: first[v.name] for v in program.locals}
    slots = {v.name: (first[v.name],) * n_sys for v in program.shared if v.kind == "allread"}
    cells = {v.name: first[v.name] for v in program.shared if v.kind == "allwrite"}
    blank = {
        r.type.name: RecordValue(r.type.name, tuple([evaluate(d, constants) for d in r.defaults]))
        for r in program.records
    }
    unset = {
        f"{m.name}.{p.name}": default(p.type, blank)
        for m in program.modules
        for p in m.ports
        if p.direction in ("sensor", "actuator")
    }
    given = [sensors[pid] if pid < len(sensors) else {} for pid in range(n_sys)]
    robots = tuple(Robot(locals_, {**unset, **_held(program, known), **known}, False) for known in given)
    return State(params, robots, Store(slots, cells), 0)


def _held(program: decl.Program, sensors: Mapping[str, Value]) -> dict[str, Value]:
    """Return the actuators of a robot without commands, with the values of the sensors that they hold at."""
    return {name: sensors[sensor] for name, sensor in held(program).items() if sensor in sensors}


def no_port(port: str, args: tuple[Value, ...]) -> Value:
    """Answer for callable ports outside of an event: raises LookupError."""
    return nobody(-1, port, args)


def run_init(program: decl.Program, state: State, world: World = NOTHING) -> tuple[State, list[Step]]:
    """Run the init of every robot, each on the store before init. The next round is 1.

    If one of them is discarded, no mission begins, and the returned state must not be used.
    """
    steps = [Step(pid, None, execute(program, program.init, state, pid, world)) for pid in range(len(state.robots))]
    return _all_applied(program, state, steps)._replace(round=1), steps


def round_(
    program: decl.Program, state: State, skipping: Collection[int] = (), grants: Mapping[int, int] | None = None,
    world: World = NOTHING,
) -> tuple[State, list[Step]]:  # fmt: skip
    """Run the program's step of one round.

    Returns the next state, and the steps in the order of their effects.

    Robots in `skipping` and stopped robots take no step. `grants` has the robot that holds each lock; by default the
    lowest pid that wants it. A robot whose first enabled event is atomic skips the round if it does not hold the lock.
    The environment's step (`sense`) comes after this step.
    """
    chosen = [
        (pid, select(program, state, pid, world))
        for pid, robot in enumerate(state.robots)
        if not robot.stopped and pid not in skipping
    ]
    wanted = [(pid, e.lock) for pid, e in chosen if isinstance(e, decl.Event) and e.lock is not None]
    holder = {lock: pid for pid, lock in reversed(wanted)} if grants is None else grants
    commits, plain = [], []
    for pid, event in chosen:
        if event is None or isinstance(event, Step):
            plain.append(event or Step(pid, None, None))
        elif event.lock is None:
            plain.append(Step(pid, event.name, execute(program, event.effect, state, pid, world)))
        elif holder.get(event.lock) == pid:
            commits.append(Step(pid, event.name, execute(program, event.effect, state, pid, world)))
        else:
            plain.append(Step(pid, None, None))
    steps = commits + plain
    return _all_applied(program, state, steps)._replace(round=state.round + 1), steps


def select(program: decl.Program, state: State, pid: int, world: World = NOTHING) -> decl.Event | Step | None:
    """Return the first event in text order whose guard holds; None if there is none.

    A guard without a value gives a discarded Step of its event, and later events are not considered.
    """
    for event in program.events:
        try:
            if enabled(program, event, state, pid, world):
                return event
        except Discarded as discarded:
            return Step(pid, event.name, discarded)
    return None


def enabled(program: decl.Program, event: decl.Event, state: State, pid: int, world: World = NOTHING) -> bool:
    """Return whether an event's guard holds for a robot. Raises Discarded."""
    return holds(event.guard, _view(program, state, pid, world, Budget(world.turns)))


def has_priority(program: decl.Program, event: decl.Event, begun: State, pid: int, world: World = NOTHING) -> bool:
    """Return whether the guards of all earlier events in the `priority:` block have a value and are false.

    `begun` is the state that the robot sees at the round's start. An event outside of blocks always has priority.
    """
    try:
        return not any(enabled(program, earlier, begun, pid, world) for earlier in program.earlier(event))
    except Discarded:
        return False


def execute(
    program: decl.Program, block: stmt.Block, state: State, pid: int, world: World = NOTHING
) -> Writes | Discarded:
    """Run an effect, or init, of one robot on a state. Returns its writes, or why they are discarded."""
    budget = Budget(world.turns)
    return run(program, block, _view(program, state, pid, world, budget), budget)


def sense(state: State, sensors: Sequence[Mapping[str, Value]]) -> State:
    """Return the state after the environment's step, with new sensor values by robot and "Module.port".

    Sensors without a new value keep their value. Robots that skipped or stopped move, too.
    """
    robots = tuple(r._replace(ports={**r.ports, **new}) for r, new in zip(state.robots, sensors, strict=True))
    return state._replace(robots=robots)


def applied(program: decl.Program, state: State, step: Step) -> State:
    """Return the state after one step: its writes, and False for the sensors that its commands clear."""
    pid, outcome = step.pid, step.outcome
    if not isinstance(outcome, Writes):
        return state
    commanded = clears(program) if outcome.ports else {}
    cleared = {sensor: False for name in outcome.ports for sensor in commanded.get(name, ())}
    ports = {**state.robots[pid].ports, **cleared, **outcome.ports}
    robots = list(state.robots)
    robots[pid] = Robot(dict(outcome.locals), ports, outcome.stopped)
    slots = dict(state.store.slots)
    for name, value in outcome.slots.items():
        slots[name] = (*slots[name][:pid], value, *slots[name][pid + 1 :])
    return state._replace(robots=tuple(robots), store=Store(slots, {**state.store.cells, **outcome.cells}))


def _all_applied(program: decl.Program, state: State, steps: Sequence[Step]) -> State:
    for step in steps:
        state = applied(program, state, step)
    return state


def _view(program: decl.Program, state: State, pid: int, world: World, budget: Budget) -> View:
    robot, store, n_sys = state.robots[pid], state.store, len(state.robots)

    def ask(port: str, args: tuple[Value, ...]) -> Value:
        return world.answer(pid, port, args)

    functions = library(program, n_sys, state.params, world, budget, no_port)
    return functions._replace(
        pid=pid, locals=robot.locals, slots=store.slots, cells=store.cells, ports=robot.ports, ask=ask
    )
