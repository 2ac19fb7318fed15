"""Agreement in the line that a discarded event's fault names: the line of the statement that failed.

Both differ in two cases. A contract without a value is a fault of the call on robots, but of the contract in the
semantics. A statement of several lines is named by its first line on robots.
"""

from __future__ import annotations

from collections.abc import Iterable
from random import Random
from typing import Any

import pytest

from koordgen.build.emit.program import program_text
from koordgen.lang.ir import decl as d
from koordgen.lang.ir import stmt as s
from koordgen.lang.ir.tree import child_fields
from koordgen.lang.node import Node, replace
from koordgen.lang.semantics import step
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.state import State
from koordgen.lang.source import Span
from koordgen.runtime.program import program as rt
from tests.agree.both import Generated, Meant
from tests.agree.kinds import AT
from tests.agree.programs import N_SYS, random_program, random_state


class Numbering:
    """Gives each statement, guard and declaration of an IR its own line; expressions have that of their statement."""

    def __init__(self) -> None:
        self.lines = 0

    def numbered(self, node: Any, at: Span = AT) -> Any:
        if isinstance(node, tuple):
            return tuple([self.numbered(part, at) for part in node])
        if not isinstance(node, Node):
            return node
        if isinstance(node, (*s.Stmt.__args__, d.Event, d.Function, d.ExternFunction)):
            at = self.line()
        fields = child_fields(type(node))
        parts = {f: self.numbered(getattr(node, f), self.line() if f == "guard" else at) for f in fields}
        return replace(node, **parts, **({"span": at} if "span" in type(node).__match_args__ else {}))  # type: ignore[attr-defined]

    def line(self) -> Span:
        self.lines += 1
        return Span(self.lines, 1, self.lines, 2)


def told(generated: Generated, state: State, pid: int) -> int | None:
    """Return the line of the fault on a robot; None without a fault."""
    transaction = generated.program.begin(generated.frame(state, pid))
    chosen = rt.choose(generated.program, transaction)
    if isinstance(chosen, rt.Event):
        done = rt.run(generated.program, chosen.effect, transaction, chosen.line)
        return done.line if isinstance(done, rt.Fault) else None
    return None if chosen is None else chosen.line


def meant(semantics: Meant, state: State, pid: int) -> int | None:
    chosen = step.select(semantics.ir, state, pid, semantics.world)
    if isinstance(chosen, d.Event):
        done = step.execute(semantics.ir, chosen.effect, state, pid, semantics.world)
    else:
        done = chosen.outcome if chosen is not None else None  # type: ignore[assignment]
    return done.span.line if isinstance(done, Discarded) else None


def compare(seeds: Iterable[int]) -> tuple[int, int]:
    """Return the number of discarded events, and of those with a contract without a value."""
    faults = contracts = 0
    for seed in seeds:
        program = random_program(seed)
        parts = Numbering().numbered((program.functions, program.externs, program.init, program.events))
        functions, externs, init, events = parts
        program = replace(program, functions=functions, externs=externs, init=init, events=events)
        generated, semantics = Generated(program, program_text(program)), Meant(program)
        rng = Random(-seed - 1)
        for _ in range(2):
            state = random_state(rng, program)
            for pid in range(N_SYS):
                line, expected = told(generated, state, pid), meant(semantics, state, pid)
                assert (line is None) == (expected is None)
                faults += line is not None
                if line != expected:
                    assert expected in [f.span.line for f in program.externs], (seed, line, expected)
                    contracts += 1
    return faults, contracts


def test_both_meanings_name_the_same_line() -> None:
    faults, contracts = compare(range(60))
    assert faults > 50
    assert contracts == 0


@pytest.mark.slow
def test_both_meanings_name_the_same_line_in_1000_programs() -> None:
    faults, contracts = compare(range(1000))
    print(faults, contracts)
    assert faults > 1000
    assert contracts < faults / 50
