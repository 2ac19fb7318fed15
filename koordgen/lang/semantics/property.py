"""Semantics of properties, about the state of the whole fleet, and of port assumptions, about one robot's ports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from koordgen.lang.ir import decl
from koordgen.lang.ir.expr import PortCall, TempRead
from koordgen.lang.semantics.eval import holds
from koordgen.lang.semantics.exec import Budget, library
from koordgen.lang.semantics.state import NOTHING, State, World
from koordgen.lang.semantics.step import no_port
from koordgen.lang.semantics.values import Value, conforms, same


class Asked(NamedTuple):
    """Record of one call of a callable port ("Module.port"): its arguments and the answer."""

    port: str
    args: tuple[Value, ...]
    answer: Value


def holds_property(property_: decl.Property, program: decl.Program, state: State, world: World = NOTHING) -> bool:
    """Return whether a property holds in a state between two rounds.

    Raises Discarded if the formula has no value (for example, an index that names no robot), and NoMeaning if the
    formula calls a `spec fun` that `world` does not define.
    """
    view = library(program, len(state.robots), state.params, world, Budget(world.turns), no_port)
    view = view._replace(slots=state.store.slots, cells=state.store.cells, robots=state.robots)
    return holds(property_.formula, view)


def holds_assumption(
    assumption: decl.Assumption, program: decl.Program, before: Mapping[str, Value], after: Mapping[str, Value],
    pid: int, n_sys: int, params: Mapping[str, Value], world: World = NOTHING, asked: Sequence[Asked] = (),
) -> bool:  # fmt: skip
    """Return whether a module's assumption holds for one robot.

    `before` maps "Module.port" to the port's value right after the program's step. `after` maps it to the value at some
    time during the period `delta` that follows. `asked` lists the robot's calls of callable ports in that step. A
    formula may pass an unbound name (a goal) to a callable port; the formula is then checked for the goals of these
    calls, and holds if there were none. Raises Discarded if the formula has no value.
    """
    answers = {(call.port, call.args): call.answer for call in asked}

    def ask(port: str, args: tuple[Value, ...]) -> Value:
        return answers[port, args] if (port, args) in answers else world.answer(pid, port, args)

    view = library(program, n_sys, params, world, Budget(world.turns), ask)._replace(pid=pid, ports=before, after=after)
    patterns = list(decl.handed(assumption.formula))
    return all(holds(assumption.formula, view._replace(temps=temps)) for temps in _goals(patterns, asked, {}))


def _goals(
    patterns: list[tuple[PortCall, dict[int, TempRead]]], asked: Sequence[Asked], known: dict[str, Value]
) -> Iterator[dict[str, Value]]:
    """Yield each assignment of an assumption's goals for which the robot made all calls in the formula.

    A goal is an unbound name that the formula passes to a callable port. `patterns` lists the calls with goals. Without
    patterns, yields `known`: the values that are already chosen.
    """
    if not patterns:
        yield known
        return
    (call, goals), *rest = patterns
    for made in asked:
        if made.port == f"{call.module}.{call.port}" and len(made.args) == len(call.args):
            given = {goal.name: made.args[place] for place, goal in goals.items()}
            typed = all(conforms(given[goal.name], goal.type) for goal in goals.values())
            if typed and all(name not in known or same(known[name], value) for name, value in given.items()):
                yield from _goals(rest, asked, {**known, **given})
