"""Agreement of both meanings of provided sensors, in the semantics and as functions of the generated program."""

from __future__ import annotations

from collections import Counter
from random import Random
from typing import Any

import pytest

from koordgen.build.emit.names import Names
from koordgen.build.emit.program import program_text
from koordgen.lang.ir import decl as d
from koordgen.lang.ir import expr as e
from koordgen.lang.ir.types import INT
from koordgen.lang.ir.verify import verify
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics.eval import Discarded, evaluate
from koordgen.lang.semantics.exec import Budget, library
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import no_port
from koordgen.runtime.values.turns import begin
from tests.agree.both import Generated, Meant, key, untouched
from tests.agree.faults import Change, rewritten
from tests.agree.formulas import with_provided
from tests.agree.programs import N_SYS, random_state

NO_VALUE = "no value"


def meant(each: d.Provided, semantics: Meant, state: State) -> Any:
    view = library(semantics.ir, N_SYS, state.params, semantics.world, Budget(), no_port)
    try:
        found = evaluate(each.value, view._replace(slots=state.store.slots, cells=state.store.cells))
    except Discarded:
        return NO_VALUE
    return key(found, each.port.type)


def generated_value(function: Any, each: d.Provided, generated: Generated, state: State) -> Any:
    transaction = generated.program.begin(generated.frame(state, 0))
    begin()
    try:
        found = function(transaction)
    except Exception:
        return NO_VALUE
    assert not transaction.written_values(), "a sensor writes nothing"
    return key(found, each.port.type)


def differences(seed: int, seen: Counter[str], change: Change = untouched) -> int:
    """Return how often the two meanings of a random program's provided sensors differ. `change`: a seeded fault."""
    program = with_provided(seed)
    verify(program)
    ports = [replace(p, value=rewritten(p.value, change)) for p in program.provides[0].ports]
    spoilt = replace(program, provides=(replace(program.provides[0], ports=tuple(ports)),))
    generated, semantics = Generated(program, program_text(spoilt)), Meant(program)
    names, rng, found = Names(program), Random(seed), 0
    for state in [random_state(rng, program) for _ in range(3)]:
        for each in program.provides[0].ports:
            wanted = meant(each, semantics, state)
            seen["no value" if wanted == NO_VALUE else "value"] += 1
            function = generated.scope[names.provided["Outside", each.port.name]]
            found += generated_value(function, each, generated, state) != wanted
    return found


def test_provided_sensors_mean_the_same_as_generated_code() -> None:
    seen: Counter[str] = Counter()
    assert [seed for seed in range(8) if differences(seed, seen)] == []
    assert seen["value"] >= 120 and seen["no value"] >= 4, seen


def test_a_sensor_that_reads_another_slot_is_noticed() -> None:
    def another_slot(node: Node) -> Node:
        if not isinstance(node, e.SlotRead):
            return node
        zero = e.Const(0, INT, node.span)
        return replace(node, index=e.Const(1, INT, node.span) if node.index == zero else zero, proved=False)

    assert any(differences(seed, Counter(), another_slot) for seed in range(30))


@pytest.mark.slow
def test_provided_sensors_of_500_programs_mean_the_same_as_generated_code() -> None:
    seen: Counter[str] = Counter()
    assert [seed for seed in range(1000, 1500) if differences(seed, seen)] == []
    print(seen)
