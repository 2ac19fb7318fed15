"""Agreement of both meanings of properties, in the semantics and as `properties.py`, with or without a value."""

from __future__ import annotations

import sys
from collections import Counter
from random import Random
from types import ModuleType
from typing import Any

import pytest

from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.lang.ir import decl as d
from koordgen.lang.ir.verify import verify
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import declared
from koordgen.lang.semantics.property import Asked, holds_assumption, holds_property
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import initial
from koordgen.runtime.program.property import Known, Outcome, Properties, judged
from koordgen.runtime.values.points import Point
from tests.agree.both import Generated, Meant, answer
from tests.agree.formulas import with_formulas
from tests.agree.programs import N_SYS, random_state


def properties(program: d.Program, generated: Generated) -> Properties:
    """Return the generated module, loaded with the generated program."""
    sys.modules["program"] = sys.modules["generated"]
    module = sys.modules["properties"] = ModuleType("properties")
    text = properties_text(program)
    exec(compile(text, "properties.py", "exec"), vars(module))
    found: Properties = module.PROPERTIES
    return found


def meant(ask: Any) -> Outcome:
    try:
        return "held" if ask() else "violated"
    except Discarded:
        return "no value"


def values(program: d.Program, generated: Generated, state: State) -> dict[str, Any]:
    """Return a state in the form that evaluations use."""
    types = declared(program)
    found: dict[str, Any] = {}
    for group in ("locals", "ports"):
        for name in getattr(state.robots[0], group):
            found[name] = [generated.python(getattr(robot, group)[name], types[name]) for robot in state.robots]
    for name, held in state.store.slots.items():
        found[name] = [generated.python(value, types[name]) for value in held]
    return found | {name: generated.python(value, types[name]) for name, value in state.store.cells.items()}


def agree(seed: int, seen: Counter[str]) -> None:
    program = with_formulas(seed)
    verify(program)
    generated, semantics = Generated(program, program_text(program)), Meant(program)
    emitted = properties(program, generated)
    assert len(emitted.properties) == len(program.properties) and not emitted.unchecked
    rng = Random(seed)
    for _ in range(3):
        state = random_state(rng, program)
        known = emitted.fleet(N_SYS, None)
        known.put(values(program, generated, state))
        for mine, its in zip(emitted.properties, program.properties, strict=True):
            wanted = meant(lambda its=its, state=state: holds_property(its, program, state, semantics.world))
            assert judged(mine.holds, known)[0] == wanted, f"with_formulas({seed}): {mine.name}"
            seen[wanted] += 1
        _assumptions(program, generated, semantics, emitted, state, random_state(rng, program), rng, seen)


def _assumptions(
    program: d.Program, generated: Generated, semantics: Meant, emitted: Properties, state: State, later: State,
    rng: Random, seen: Counter[str],
) -> None:  # fmt: skip
    types = declared(program)
    goals = [(Point(float(rng.randrange(2)), 0.0, 0.0),) for _ in range(rng.randrange(3))]
    for pid in range(N_SYS):
        calls = []
        for args in goals:
            try:
                calls.append(("Motion.planner", args, answer(pid, "Motion.planner", args)))
            except RuntimeError:
                continue
        before, after = state.robots[pid].ports, later.robots[pid].ports
        step = emitted.step(N_SYS, None)
        step.put({name: generated.python(value, types[name]) for name, value in before.items()})
        step.put({f"{name}'": generated.python(value, types[name]) for name, value in after.items()})
        step.pid, step.asked = pid, tuple(calls)
        step.answer = lambda port, args, pid=pid: answer(pid, port, args)  # type: ignore[method-assign, misc]
        asked = [Asked(*call) for call in calls]
        for mine, its in zip(emitted.assumptions, program.modules[0].assumptions, strict=True):
            wanted = meant(
                lambda its=its, before=before, after=after, pid=pid, asked=asked: holds_assumption(
                    its, program, before, after, pid, N_SYS, initial(program, N_SYS).params, semantics.world, asked
                )
            )
            assert judged(mine.holds_of_calls, step)[0] == wanted
            seen[f"assumption {wanted}"] += 1


def test_properties_mean_the_same_as_generated_code() -> None:
    seen: Counter[str] = Counter()
    for seed in range(50):
        agree(seed, seen)
    for outcome in ("held", "violated", "no value"):
        assert seen[outcome] >= 20 and seen[f"assumption {outcome}"] >= 8, seen


@pytest.mark.slow
def test_properties_of_2000_programs_mean_the_same_as_generated_code() -> None:
    seen: Counter[str] = Counter()
    for seed in range(1000, 3000):
        agree(seed, seen)
    print(seen)


def test_known_values_are_put_by_name() -> None:
    known = Known(2)
    known.of_each("x")
    known.put({"x": [1, 2], "nobody reads": 3})
    assert known.each["x"][1] == 2 and "nobody reads" not in known.one
