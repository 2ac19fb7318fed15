"""What the checker has proved holds in random states of all right programs there are; InternalError rises where not."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest

from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl, expr
from koordgen.lang.ir.tree import walk
from koordgen.lang.ir.types import Sequence
from koordgen.lang.semantics import exec
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import NoMeaning, Writes
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.state import Robot, State, Store, World
from koordgen.lang.semantics.step import Step, enabled, execute, has_priority, initial, round_, run_init
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.agree.both import answer, key, outside
from tests.agree.kinds import random_value
from tests.lang.test_lang import CASES
from tests.programs import programs_alone

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "docs/reference/language.md", *sorted((ROOT / "koordgen/lang/explain").glob("*.md"))]


def texts() -> Iterator[tuple[str, str]]:
    for path in programs_alone():
        yield path.name, path.read_text(encoding="utf-8")
    for case in CASES:
        yield case.name, case.text
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for block in re.finditer(r"^```koord\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            yield f"{page.name}:{text[: block.start()].count(chr(10)) + 2}", block[1]


def right() -> Iterator[tuple[str, decl.Program]]:
    """The programs of which the checker finds no errors."""
    for name, text in texts():
        source = Source("t.koord", text)
        tree, unread = parse(source)
        if not unread:
            program, _ = check(tree, source)
            if program is not None:
                yield name, program


PROGRAMS = list(right())


def world(program: decl.Program) -> World:
    def function(extern: decl.ExternFunction) -> Callable[..., Value]:
        def called(*args: Value) -> Value:
            keys = tuple([key(arg, p.type) for arg, p in zip(args, extern.parameters, strict=True)])
            return outside(extern.name, keys, extern.result)

        return called

    return World({f.name: function(f) for f in program.externs}, answer)


def random_state(rng: Random, program: decl.Program, n_sys: int) -> State:
    """Any state of a fleet of any size, with any params."""
    start = initial(program, n_sys)
    params = {p.name: random_value(rng, p.type) for p in program.params} if rng.random() < 0.5 else start.params
    ports = [(f"{m.name}.{p.name}", p) for m in program.modules for p in m.ports]
    robots = tuple(
        Robot(
            {v.name: random_value(rng, v.type) for v in program.locals},
            {name: random_value(rng, p.type) for name, p in ports if p.direction in ("sensor", "actuator")},
            False,
        )
        for _ in range(n_sys)
    )
    slots = {
        v.name: tuple([random_value(rng, v.type) for _ in range(n_sys)]) for v in program.shared if v.kind == "allread"
    }
    cells = {v.name: random_value(rng, v.type) for v in program.shared if v.kind == "allwrite"}
    return with_members(rng, program, State(params, robots, Store(slots, cells), 1))


def with_members(rng: Random, program: decl.Program, state: State) -> State:
    """The state with members of each imported application: slots for all of them, and a pid of each robot."""
    types = {v.name: v.type for v in program.shared}
    for imported in program.imports:
        size = rng.randrange(1, 5)
        cells = dict(state.store.cells)
        for name in imported.slots:
            type_ = types[name]
            assert isinstance(type_, Sequence)
            cells[name] = tuple([random_value(rng, type_.element) for _ in range(size)])
        robots = [r._replace(locals={**r.locals, imported.pid: rng.randrange(-1, size)}) for r in state.robots]
        store = state.store._replace(cells=cells)
        state = state._replace(params={**state.params, imported.size: size}, robots=tuple(robots), store=store)
    return state


@pytest.fixture(autouse=True)
def short_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some of these programs are examples of loops without an end."""
    monkeypatch.setattr(exec, "MAX_TURNS", 300)


@pytest.mark.parametrize(("name", "program"), PROGRAMS, ids=[name for name, _ in PROGRAMS])
def test_no_state_defeats_what_was_proved(name: str, program: decl.Program) -> None:
    rng, outside_ = Random(name), world(program)
    for turn in range(12):
        n_sys = 1 + turn % 6
        state = random_state(rng, program, n_sys)
        for pid in range(n_sys):
            for event in program.events:
                try:
                    first = has_priority(program, event, state, pid, outside_)
                    if first and enabled(program, event, state, pid, outside_):
                        execute(program, event.effect, state, pid, outside_)
                except Discarded:
                    pass
        for property_ in program.properties:
            if property_.kind == "axiom":  # of all values of its free names: nothing that is executed
                continue
            with contextlib.suppress(Discarded, NoMeaning):
                holds_property(property_, program, state, outside_)


@pytest.mark.parametrize(("name", "program"), PROGRAMS, ids=[name for name, _ in PROGRAMS])
def test_a_mission_from_the_beginning(name: str, program: decl.Program) -> None:
    outside_ = world(program)
    for n_sys in (1, 2, 5):
        begun = with_members(Random(name), program, initial(program, n_sys))
        state, _ = run_init(program, begun, outside_)
        for _ in range(8):
            state, _ = round_(program, state, world=outside_)


def test_these_programs_do_something() -> None:
    proved, unproved, ran = 0, 0, 0
    for _, program in PROGRAMS:
        found = [n for n in walk((program.events, program.functions)) if isinstance(n, (expr.At, expr.SlotRead))]
        proved += len([n for n in found if n.proved])
        unproved += len([n for n in found if not n.proved])
        steps: list[Step] = []
        with contextlib.suppress(Discarded):
            steps = round_(program, random_state(Random(1), program, 3), world=world(program))[1]
        ran += any(isinstance(step.outcome, Writes) for step in steps)
    assert len(PROGRAMS) > 100 and proved > 50 and unproved > 5 and ran > len(PROGRAMS) / 3, (proved, unproved, ran)
