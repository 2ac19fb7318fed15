"""Semantics of a program: `init`, one event of one robot, and a round. All functions are pure.

Tests compare the programs on robots (agents) with this code. The language allows several results of a round; `round_`
computes the result that agents compute. Each robot runs the first event in text order whose guard holds, on the shared
variables as they were at the round's start. The writes of atomic events take effect first, at most one event for each
lock, then those of the other events by ascending pid. If several robots write an allwrite variable, the last write
remains. All writes of one event take effect together. relations.py computes all results that the language allows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from koordgen.lang.ir import decl, stmt
from koordgen.lang.ir.ports import clears, held
from koordgen.lang.semantics.eval import Discarded, StateView, evaluate, holds
from koordgen.lang.semantics.exec import Budget, Writes, constant, library, run
from koordgen.lang.semantics.state import NOTHING, Robot, State, Store, World, nobody
from koordgen.lang.semantics.values import RecordValue, Value, default


class Step(NamedTuple):
    """Step of one robot in a round.

    `event` is None for `init`, and if the robot skipped the round. `outcome` is None if the robot skipped the round.
    """

    pid: int
    event: str | None
    outcome: Writes | Discarded | None


def initial(program: decl.Program, n_sys: int, sensors: Sequence[Mapping[str, Value]] = ()) -> State:
    """Return the state before `init` runs, in which all variables have their initial values.

    `sensors` has one mapping for each robot, from "Module.port" to a value. An actuator without a value
    in `sensors` has the value of the sensor that its `at` mark names: with `target at position`, the robot's position.
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
    """Return the values of a robot's actuators before the first command: the values of sensors named by `at` marks."""
    return {name: sensors[sensor] for name, sensor in held(program).items() if sensor in sensors}


def no_port(port: str, args: tuple[Value, ...]) -> Value:
    """Raise LookupError: the answer to a call of a callable port outside of an event."""
    return nobody(-1, port, args)


def run_init(program: decl.Program, state: State, world: World = NOTHING) -> tuple[State, list[Step]]:
    """Run `init` for every robot, each on the shared variables' initial values. The next round is 1.

    If the `init` of one robot is discarded, no mission begins, and the returned state must not be used.
    """
    steps = [Step(pid, None, execute(program, program.init, state, pid, world)) for pid in range(len(state.robots))]
    return _all_applied(program, state, steps)._replace(round=1), steps


def round_(
    program: decl.Program, state: State, skipping: Collection[int] = (), grants: Mapping[int, int] | None = None,
    world: World = NOTHING,
) -> tuple[State, list[Step]]:  # fmt: skip
    """Run the program's step of one round.

    Returns the next state, and the steps in the order of their effects.

    Robots in `skipping` and stopped robots take no step. `grants` maps each lock to the pid of the robot that holds it;
    by default, to the lowest pid of the robots that want it. A robot whose first enabled event is atomic skips the
    round if the robot does not hold the event's lock.
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

    If a guard has no value, returns a Step in which its event is discarded; later events are then not considered.
    """
    for event in program.events:
        try:
            if enabled(program, event, state, pid, world):
                return event
        except Discarded as discarded:
            return Step(pid, event.name, discarded)
    return None


def enabled(program: decl.Program, event: decl.Event, state: State, pid: int, world: World = NOTHING) -> bool:
    """Return whether an event's guard holds for a robot. Raises Discarded if the guard has no value."""
    return holds(event.guard, _view(program, state, pid, world, Budget(world.turns)))


def has_priority(program: decl.Program, event: decl.Event, begun: State, pid: int, world: World = NOTHING) -> bool:
    """Return whether an event may run: all guards of earlier events in its `priority:` block are false.

    The result is False if such a guard has no value. `begun` is the state that the robot sees at the round's start. An
    event outside of `priority:` blocks may always run.
    """
    try:
        return not any(enabled(program, earlier, begun, pid, world) for earlier in program.earlier(event))
    except Discarded:
        return False


def execute(
    program: decl.Program, block: stmt.Block, state: State, pid: int, world: World = NOTHING
) -> Writes | Discarded:
    """Run the effect of an event, or `init`, for one robot. Returns its writes, or Discarded with the reason."""
    budget = Budget(world.turns)
    return run(program, block, _view(program, state, pid, world, budget), budget)


def sense(state: State, sensors: Sequence[Mapping[str, Value]]) -> State:
    """Return the state after the environment's step, in which sensors get new values.

    `sensors` has one mapping for each robot, from "Module.port" to the new value. Other sensors keep their values.
    Robots that skipped the round or stopped may get new values, too, because they can still move.
    """
    robots = tuple(r._replace(ports={**r.ports, **new}) for r, new in zip(state.robots, sensors, strict=True))
    return state._replace(robots=robots)


def applied(program: decl.Program, state: State, step: Step) -> State:
    """Return the state after one robot's step: applies its writes.

    If the step writes an actuator with a `clears` mark, the sensors named by the mark become False.
    """
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


def _view(program: decl.Program, state: State, pid: int, world: World, budget: Budget) -> StateView:
    robot, store, n_sys = state.robots[pid], state.store, len(state.robots)

    def ask(port: str, args: tuple[Value, ...]) -> Value:
        return world.answer(pid, port, args)

    functions = library(program, n_sys, state.params, world, budget, no_port)
    return functions._replace(
        pid=pid, locals=robot.locals, slots=store.slots, cells=store.cells, ports=robot.ports, ask=ask
    )
