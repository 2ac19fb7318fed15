"""What properties mean, over the shared store, every robot's locals and ports; and port assumptions, over one robot."""

from __future__ import annotations

from collections.abc import Mapping

from koordgen.ir import decl
from koordgen.semantics.eval import holds
from koordgen.semantics.exec import Budget, library
from koordgen.semantics.state import NOTHING, State, World
from koordgen.semantics.step import no_port
from koordgen.semantics.values import Value


def holds_property(property_: decl.Property, program: decl.Program, state: State, world: World = NOTHING) -> bool:
    """Whether a property holds at a round's boundary. Raises Discarded where its formula has no value (an index that
    names no robot), NoMeaning where it asks a `spec fun` of which `world` knows nothing."""
    view = library(program, len(state.robots), state.params, world, Budget(), no_port)
    view = view._replace(slots=state.store.slots, cells=state.store.cells, robots=state.robots)
    return holds(property_.formula, view)


def holds_assumption(
    assumption: decl.Assumption, program: decl.Program, before: Mapping[str, Value], after: Mapping[str, Value],
    pid: int, n_sys: int, params: Mapping[str, Value], world: World = NOTHING,
) -> bool:  # fmt: skip
    """Whether a module's assumption holds of one robot: `before` are its ports right after the program's step, `after`
    at a moment of the delta that follows, both by "Module.port". Raises Discarded where the formula has no value."""

    def ask(port: str, args: tuple[Value, ...]) -> Value:
        return world.answer(pid, port, args)

    view = library(program, n_sys, params, world, Budget(), ask)
    return holds(assumption.formula, view._replace(pid=pid, ports=before, after=after))
