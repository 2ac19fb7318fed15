"""Every step that the language allows: any enabled event of any robot, or none, in any order. Agents take one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import permutations

from koordgen.ir import decl
from koordgen.semantics.eval import Discarded
from koordgen.semantics.exec import Writes
from koordgen.semantics.state import NOTHING, State, Store, World
from koordgen.semantics.step import Step, applied, enabled, execute

Environment = Callable[[State], Iterable[State]]


def choices(
    program: decl.Program, state: State, pid: int, begun: Store | None = None, world: World = NOTHING
) -> list[Step]:
    """What one robot may do within a round: skip, or run any event whose guard holds and that is not discarded.
    `begun` is the store at the round's start (the state's own unless given), on which plain events run; atomic ones run
    on the state's."""
    found = [Step(pid, None, None)]
    if state.robots[pid].stopped:
        return found
    copy = state if begun is None else state._replace(store=begun)
    for event in program.events:
        seen = copy if event.lock is None else state
        try:
            ready = enabled(program, event, seen, pid, world)
        except Discarded:
            continue
        outcome = execute(program, event.effect, seen, pid, world) if ready else None
        if isinstance(outcome, Writes):
            found.append(Step(pid, event.name, outcome))
    return found


def post(program: decl.Program, state: State, order: Sequence[int], world: World = NOTHING) -> list[State]:
    """Every state after the robots of `order` took one step each, in that order: the state itself where it is empty."""
    states = [state]
    for pid in order:
        states = _distinct(applied(s, c) for s in states for c in choices(program, s, pid, state.store, world))
    return states


def rounds(program: decl.Program, state: State, world: World = NOTHING) -> list[State]:
    """Every state at the end of a round's program step: all orders of all robots."""
    orders = permutations(range(len(state.robots)))
    found = _distinct(after for order in orders for after in post(program, state, order, world))
    return [after._replace(round=state.round + 1) for after in found]


def end(states: Iterable[State], environment: Environment) -> list[State]:
    """Every state after the environment's step: delta has passed, all robots have moved, all copies are fresh."""
    return _distinct(moved for state in states for moved in environment(state))


def reach(
    program: decl.Program, states: Sequence[State], environment: Environment, count: int, world: World = NOTHING
) -> list[State]:
    """Every state at the end of `count` rounds; the states themselves for 0."""
    for _ in range(count):
        states = end([after for state in states for after in rounds(program, state, world)], environment)
    return list(states)


def _distinct(states: Iterable[State]) -> list[State]:
    found: list[State] = []
    for state in states:
        if state not in found:
            found.append(state)
    return found
