"""One meaning: random programs run in the executable semantics and as generated Python on the runtime must agree."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from koordgen.emit.program import program_text
from koordgen.ir import decl as d
from koordgen.ir.verify import verify
from koordgen.runtime import program as rt
from koordgen.runtime.values import Point
from koordgen.semantics import step
from koordgen.semantics.eval import Discarded, Value, Vector
from tests.agree.programs import N_SYS, VALUES, VARIABLES, programs

Outcome = dict[str, Any] | str


def _load(program: d.Program) -> rt.Program:
    scope: dict[str, Any] = {"__name__": "generated", "__file__": "random.py"}
    exec(compile(program_text(program), "random.py", "exec"), scope)
    loaded: rt.Program = scope["PROGRAM"]
    return loaded


@st.composite
def states(draw: st.DrawFn, program: d.Program) -> step.State:
    """A state at a round's start with random values everywhere."""
    start = step.initial(program, N_SYS)

    def of(prefix: str) -> dict[str, Value]:
        return {f"{prefix}_{n}": _vector(draw(VALUES[t])) for n, t in VARIABLES.items()}

    ports = {"Motion.position": VALUES[VARIABLES["p"]], "Motion.target": VALUES[VARIABLES["p"]]}
    robots = tuple(
        step.Robot(
            of("local"),
            {**{n: _vector(draw(s)) for n, s in ports.items()}, "Motion.reached": draw(st.booleans())},
            False,
        )
        for _ in range(N_SYS)
    )
    slots = [of("each") for _ in range(N_SYS)]
    store = step.Store({n: tuple(s[n] for s in slots) for n in slots[0]}, of("all"))
    return start._replace(robots=robots, store=store, round=1)


def _vector(value: Any) -> Value:
    return Vector(*value) if isinstance(value, tuple) else value


def _python(value: Value) -> Any:
    return Point(*value) if isinstance(value, Vector) else value


def _key(value: Any) -> Any:
    """What tells values apart: type, and floats by all their bits (NaN equals itself, 0.0 is not -0.0)."""
    if isinstance(value, Point):
        return ("Point", *(repr(float(c)) for c in (value.x, value.y, value.z)))
    if isinstance(value, Vector):
        return ("Point", *(repr(float(c)) for c in value))
    return (type(value).__name__, repr(value))


def by_semantics(program: d.Program, state: step.State, pid: int) -> tuple[str | None, Outcome]:
    """The event that the semantics chooses, and what it wrote, or "discarded"."""
    for event in program.events:
        try:
            if not step.enabled(event, state, pid):
                continue
        except Discarded:
            return None, "discarded"
        done = step.run(event.effect, state, pid)
        if isinstance(done, Discarded):
            return event.name, "discarded"
        return event.name, {
            "locals": {n: _key(v) for n, v in done.locals.items()},
            "shared": {n: _key(v) for n, v in {**done.slots, **done.cells}.items()},
            "actuators": {n: _key(v) for n, v in done.ports.items()},
            "stopped": done.stopped,
        }
    return None, "none"


def by_generated_code(program: rt.Program, state: step.State, pid: int) -> tuple[str | None, Outcome]:
    """The same from the generated Python, run as an agent runs it."""
    robot = state.robots[pid]
    ports = {n: _python(v) for n, v in robot.ports.items()}
    shared: dict[str, Any] = {n: tuple(map(_python, v)) for n, v in state.store.slots.items()}
    shared.update({n: _python(v) for n, v in state.store.cells.items()})
    frame = rt.Frame(pid, N_SYS, {n: _python(v) for n, v in robot.locals.items()}, shared, ports, ports)
    chosen = rt.choose(program, frame)
    if chosen is None or isinstance(chosen, rt.Fault):
        return None, "none" if chosen is None else "discarded"
    done = rt.run(program, chosen.effect, frame)
    if isinstance(done, rt.Fault):
        return chosen.name, "discarded"
    return chosen.name, {
        "locals": {n: _key(v) for n, v in done.locals.items()},
        "shared": {n: _key(v) for n, v in done.shared.items()},
        "actuators": {n: _key(v) for n, v in done.actuators.items()},
        "stopped": done.stopped,
    }


def agree(data: st.DataObject, seen: Counter[str]) -> None:
    """Draw a program and a few states of it; both meanings must be the same on every robot."""
    program = data.draw(programs())
    verify(program)
    generated = _load(program)
    for _ in range(2):
        state = data.draw(states(program))
        for pid in range(N_SYS):
            expected = by_semantics(program, state, pid)
            assert by_generated_code(generated, state, pid) == expected, program_text(program)
            seen["none" if expected[0] is None else "discarded" if expected[1] == "discarded" else "ran"] += 1


def _run(examples: int, first: int = 20261121) -> Counter[str]:
    seen: Counter[str] = Counter()

    @seed(first)
    @settings(
        max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )  # fmt: skip
    @given(st.data())
    def every(data: st.DataObject) -> None:
        agree(data, seen)

    every()
    return seen


def test_semantics_and_generated_code_agree() -> None:
    seen = _run(250)
    total = seen.total()
    assert total >= 600
    assert seen["ran"] >= total / 4, "most of what is compared must do something"
    assert seen["discarded"] >= total / 50


@pytest.mark.slow
def test_semantics_and_generated_code_agree_on_2000_programs() -> None:
    seen = _run(2000)
    print(dict(seen))
    assert seen["ran"] >= seen.total() / 4


RARE = pytest.mark.slow  # what stands in few programs takes many to be met
FAULTS = [
    (" - ", " + "),
    (".own = ", ".x = "),
    pytest.param("//", "/", marks=RARE),
    pytest.param(" and ", " or ", marks=RARE),
]


@pytest.mark.parametrize(("right", "wrong"), FAULTS)
def test_a_seeded_fault_in_generated_code_is_found(right: str, wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    original = program_text

    def faulty(program: d.Program) -> str:
        head, mark, events = original(program).partition("def guard_")
        return head + mark + events.replace(right, wrong)

    monkeypatch.setitem(globals(), "program_text", faulty)
    with pytest.raises(AssertionError):
        for start in range(12):  # it stops where the fault is found
            _run(500, start)
