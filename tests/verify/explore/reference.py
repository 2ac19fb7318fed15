"""Reference explorer by the executable semantics, and searches with it."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from itertools import count, product
from typing import Any

from koordgen.lang.ir import decl
from koordgen.lang.node import replace
from koordgen.lang.semantics.property import holds_assumption, holds_property
from koordgen.lang.semantics.relations import rounds
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial, run_init, sense
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import Environment, EnvironmentSteps, SensorDomain, possible_answers
from koordgen.verify.explore.machine import Machine, Packed
from koordgen.verify.explore.search import ExplorationResult, Search
from tests.verify.explore.random_programs import LEVELS

LEVEL = Environment({"Dev.level": SensorDomain(LEVELS)}, {})
NOTHING = Environment({}, {})


def search(
    program: decl.Program, n_sys: int, around: Environment = NOTHING, rounds: int | None = None, **switches: Any
) -> Search:
    """A search that has not begun, on a clock that no machine disturbs: each look is a thousandth of a second."""
    machine = Machine(program, n_sys, possible_answers(around, program, n_sys))
    ticks = count()
    bounds = switches.pop("bounds", ExplorationBounds(rounds=rounds))
    return Search(
        machine, EnvironmentSteps(machine, around), bounds, lambda: next(ticks) / 1000, lambda _: None, **switches
    )


def explored(
    program: decl.Program, n_sys: int, around: Environment = NOTHING, rounds: int | None = None, **switches: Any
) -> tuple[Search, ExplorationResult]:
    made = search(program, n_sys, around, rounds, **switches)
    return made, made.run()


def unjudged(program: decl.Program) -> decl.Program:
    """The program without invariants, so that nothing ends a search early."""
    return replace(program, properties=tuple([p for p in program.properties if p.kind == "initially"]))


def key(state: State) -> Hashable:
    """What tells states apart; the number of the round does not."""
    robots = [(sorted(r.locals.items()), sorted(r.ports.items()), r.stopped) for r in state.robots]
    return repr((robots, sorted(state.store.slots.items()), sorted(state.store.cells.items())))


def after_round(program: decl.Program, state: State) -> set[Hashable]:
    """All ends of the program's step, by the semantics."""
    return {key(end) for end in rounds(program, state)}


def after_explored(made: Search, fleet: Packed) -> set[Hashable]:
    return {key(made.machine.state(end)) for _, end in made.rounds.ends(fleet)}


def reached(program: decl.Program, n_sys: int, number: int) -> set[Hashable]:
    """All states at the ends of up to `number` rounds, by the semantics: every order, choice and skip."""
    layer = {key(s): s for s in _begun(program, n_sys)}
    found = dict(layer)
    for _ in range(number):
        ends = {key(e): e for state in layer.values() for e in rounds(program, state)}
        moved = {key(m): m for end in ends.values() for m in _moved(program, end)}
        layer = {name: state for name, state in moved.items() if name not in found}
        found |= layer
    return set(found)


def _begun(program: decl.Program, n_sys: int) -> Iterator[State]:
    sensing = bool(program.modules) and program.modules[0].name == "Dev"
    for levels in product(LEVELS, repeat=n_sys) if sensing else [()]:
        state = initial(program, n_sys, [{"Dev.level": level} for level in levels])
        if all(holds_property(p, program, state) for p in program.properties if p.kind == "initially"):
            yield run_init(program, state)[0]


def _moved(program: decl.Program, state: State) -> Iterator[State]:
    if not program.modules or program.modules[0].name != "Dev":
        yield state
        return
    assumption, n_sys = program.modules[0].assumptions[0], len(state.robots)
    each = []
    for pid, robot in enumerate(state.robots):
        news = [{**robot.ports, "Dev.level": level} for level in LEVELS]
        allowed = [n for n in news if holds_assumption(assumption, program, robot.ports, n, pid, n_sys, state.params)]
        each.append([{"Dev.level": n["Dev.level"]} for n in allowed])
    for fleet in product(*each):
        yield sense(state, fleet)
