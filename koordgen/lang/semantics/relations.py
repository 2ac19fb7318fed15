"""All steps that the language allows: each robot runs any enabled event or none, in any order of robots.

The programs on robots (agents) execute only one of these steps; see step.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import permutations

from koordgen.lang.ir import decl
from koordgen.lang.semantics.composition import System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import NOTHING, State, Store, World
from koordgen.lang.semantics.step import Step, applied, enabled, execute, has_priority, select
from koordgen.lang.semantics.system import SystemState, view

Environment = Callable[[State], Iterable[State]]
# A state, the event that led to the state, the pid of the event's robot (None: all robots), the number of the round.
Happened = tuple[State, str, int | None, int]


def choices(
    program: decl.Program, state: State, pid: int, begun: Store | None = None, world: World = NOTHING
) -> list[Step]:
    """Return all steps that the language allows one robot in a round: to skip the round, or to run one event.

    The event's guard must hold, no earlier event of its `priority:` block may be enabled, and the event must not be
    discarded. `begun` is the store (the shared variables) at the round's start, by default the store of `state`. Events
    that are not atomic run on `begun`, and guards of earlier events in a `priority:` block are evaluated on it. Atomic
    events run on the store of `state`.
    """
    found = [Step(pid, None, None)]
    if not state.robots[pid].stopped:
        steps = (choice(program, event, state, pid, begun, world) for event in program.events)
        found += [step for step in steps if step is not None]
    return found


def choice(
    program: decl.Program, event: decl.Event, state: State, pid: int, begun: Store | None = None,
    world: World = NOTHING,
) -> Step | None:  # fmt: skip
    """Return the step in which a robot that has not stopped runs this event.

    Returns None if the robot cannot run the event in this round. `begun` is the store at the round's start, as in
    `choices`.
    """
    copy = state if begun is None else state._replace(store=begun)
    seen = copy if event.lock is None else state
    try:
        ready = has_priority(program, event, copy, pid, world) and enabled(program, event, seen, pid, world)
    except Discarded:
        return None
    outcome = execute(program, event.effect, seen, pid, world) if ready else None
    return Step(pid, event.name, outcome) if isinstance(outcome, Writes) else None


def instance_choices(
    system: System, state: SystemState, begun: SystemState, number: int, world: World = NOTHING
) -> list[Step]:
    """Return all steps that the language allows an instance in a round: to skip the round, or to run one event.

    As `choices`, on the instance's view of the system: events that are not atomic run on the shared variables of
    `begun`, the state at the round's start, and atomic events on those of `state`. All events read the ports of their
    robot as in `begun`, whatever other applications of the robot have commanded in this round.
    """
    instance = system.instances()[number]
    program, start = system.applications[instance.application].program, view(system, begun, instance.application)
    now = view(system, state, instance.application)._replace(robots=start.robots)
    return choices(program, now, instance.pid, start.store, world)


def post(program: decl.Program, state: State, order: Sequence[int], world: World = NOTHING) -> list[State]:
    """Return all states that can result if the robots in `order` take one step each, in that order."""
    states = [state]
    for pid in order:
        states = _distinct(applied(program, s, c) for s in states for c in choices(program, s, pid, state.store, world))
    return states


def rounds(program: decl.Program, state: State, world: World = NOTHING) -> list[State]:
    """Return all states that can result from the program's step of one round, in any order of the robots."""
    orders = permutations(range(len(state.robots)))
    found = _distinct(after for order in orders for after in post(program, state, order, world))
    return [after._replace(round=state.round + 1) for after in found]


def is_order_of_agents(program: decl.Program, run: Sequence[Happened], world: World = NOTHING) -> bool:
    """Return whether agents, the programs on robots, can execute every round of a run.

    In a round of agents each robot skips, or runs the first event in text order whose guard holds at the round's start;
    if a guard has no value, the robot runs no event. Atomic events come first, at most one for each lock, then the
    other events by ascending pid. An event that is discarded may only be the last of a round.
    """
    before = run[0][0]
    rounds_of: dict[
        int, tuple[State, list[tuple[int, str]]]
    ] = {}  # number of a round -> state at the round's start, steps
    for after, event, pid, number in run:
        if pid is not None and event != "init":
            rounds_of.setdefault(number, (before, []))[1].append((pid, event))
        before = after
    return all(_is_round_of_agents(program, begun, steps, world) for begun, steps in rounds_of.values())


def _is_round_of_agents(program: decl.Program, begun: State, steps: Sequence[tuple[int, str]], world: World) -> bool:
    locks: list[int] = []  # locks of the atomic events earlier in the round
    plain: list[int] = []  # pids of the robots that ran an event that is not atomic
    for pid, name in steps:
        chosen = select(program, begun, pid, world)
        if isinstance(chosen, Step):  # a guard has no value, so the robot's event is discarded
            return chosen.event == name and (pid, name) == steps[-1]
        if chosen is None or chosen.name != name:
            return False
        if chosen.lock is None:
            plain.append(pid)
        elif plain:
            return False
        else:
            locks.append(chosen.lock)
    return plain == sorted(plain) and len(locks) == len(set(locks))


def end(states: Iterable[State], environment: Environment) -> list[State]:
    """Return all states after the environment's step, in which the time `delta` passes and robots move."""
    return _distinct(moved for state in states for moved in environment(state))


def reach(
    program: decl.Program, states: Sequence[State], environment: Environment, count: int, world: World = NOTHING
) -> list[State]:
    """Return all states that can be reached from `states` in `count` rounds."""
    for _ in range(count):
        states = end([after for state in states for after in rounds(program, state, world)], environment)
    return list(states)


def _distinct(states: Iterable[State]) -> list[State]:
    found: list[State] = []
    for state in states:
        if state not in found:
            found.append(state)
    return found
