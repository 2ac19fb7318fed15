"""Programs for the tests of the meaning, from their text."""

from __future__ import annotations

from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.verify import verify
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import NOTHING, State, World
from koordgen.lang.semantics.step import Step, initial, round_, run_init
from koordgen.lang.semantics.values import Value
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse


def compiled(text: str) -> Program:
    """A program that is right."""
    source = Source("t.koord", text)
    tree, found = parse(source)
    assert not [d for d in found if d.severity == "error"], found
    program, found = check(tree, source)
    assert program is not None, found
    verify(program)
    return program


def event(effect: str, guard: str = "True") -> str:
    """An event E with this effect."""
    body = "\n".join(f"    {line}" for line in effect.split("\n"))
    return f"E:\n  pre: {guard}\n  eff:\n{body}\n"


def after(text: str, robots: int = 3, rounds: int = 1, world: World = NOTHING) -> tuple[State, list[Step]]:
    """The state after init and some rounds, with the last round's steps."""
    program = compiled(text)
    state, steps = run_init(program, initial(program, robots), world)
    for _ in range(rounds):
        state, steps = round_(program, state, world=world)
    return state, steps


def local(text: str, name: str, world: World = NOTHING) -> Value:
    """What the first event of a program for one robot leaves in one of its variables."""
    state, steps = after(text, 1, world=world)
    assert isinstance(steps[0].outcome, Writes), steps[0].outcome
    return state.robots[0].locals[name]
