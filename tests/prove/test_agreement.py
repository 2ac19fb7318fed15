"""What is proved is never violated: random programs, explored exhaustively for 2 and 3 robots by the semantics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from koordgen.ir.decl import Program
from koordgen.node import replace
from koordgen.pipeline import check_file
from koordgen.prove.generate import obligations
from koordgen.prove.solve import Limits, Solver
from tests.prove.random_programs import program, violated

INVARIANTS = 3  # a program


def checked(tmp_path: Path, text: str) -> Program:
    path = tmp_path / "app.koord"
    path.write_text(text)
    return check_file(str(path)).program


def proved(program: Program, solver: Solver, robots: int | None = None) -> frozenset[str]:
    """The invariants that are proved together, failing ones dropped until none fails."""
    while True:
        asked = [(o, solver.ask(o).result) for o in obligations(program, robots, exact=True)]
        failing = {o.invariant for o, result in asked if o.kind != "consistency" and result != o.expected}
        kept = [p for p in program.properties if p.name not in failing]
        if len(kept) == len(program.properties):
            return frozenset(p.name for p in kept if p.kind == "invariant")
        program = replace(program, properties=tuple(kept))


def agree(tmp_path: Path, seeds: Iterable[int]) -> tuple[int, int]:
    """How many invariants are proved, and how many are not; none that is proved is violated."""
    many = yes = 0
    with Solver("z3", Limits(query=1.0, total=100_000.0)) as solver:
        for seed in seeds:
            app = checked(tmp_path, program(seed))
            names = proved(app, solver)
            many, yes = many + INVARIANTS, yes + len(names)
            for n_sys, rounds in ((2, 2), (3, 1)):
                assert not violated(app, names, n_sys, rounds), f"seed {seed}"
    return yes, many - yes


def test_what_is_proved_holds_of_every_state_that_is_reached(tmp_path: Path) -> None:
    yes, no = agree(tmp_path, range(1000, 1020))
    assert yes >= 10 and no >= 10


@pytest.mark.slow
def test_what_is_proved_holds_of_five_hundred_programs(tmp_path: Path) -> None:
    yes, no = agree(tmp_path, range(500))
    assert 4 * min(yes, no) >= yes + no, "a quarter each, or this shows little"
