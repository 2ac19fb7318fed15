"""Counterexamples are runs of the semantics, and solvers agree. test_random.py checks that PROVED invariants hold."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.exact import exact
from koordgen.lang.semantics.relations import choices
from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.step import applied, initial, run_init
from koordgen.verify.prove.obligations.generate import obligation_groups, obligations
from koordgen.verify.prove.report.explain import invariant_of
from koordgen.verify.prove.report.model import exact_state, failing_conjunct, is_allowed
from koordgen.verify.prove.report.reach import CounterexampleRun
from koordgen.verify.prove.report.verdict import Question, prove
from koordgen.verify.prove.smt.solve import CrossCheck, Limits, Solver
from tests.programs import programs_alone
from tests.verify.explore.random_programs import program

EXAMPLES = programs_alone()


def checked(tmp_path: Path, text: str) -> Program:
    path = tmp_path / "app.koord"
    path.write_text(text)
    return check_file(str(path)).program


def made_again(app: Program, run: CounterexampleRun, name: str) -> None:
    """Each moment of a run follows from those before it by the semantics; the last one makes the invariant false."""
    app, run_states = exact(app), run.run_states
    first = run_states[0].state
    levels: list[dict[str, Any]] = [dict(robot.ports) for robot in first.robots]
    assert first == exact_state(initial(app, len(levels), levels))
    assert all(0 <= level["Dev.level"] <= 2 for level in levels), "what holds initially"
    assert run_states[1].state == run_init(app, first)[0]
    begun: State = run_states[1].state
    acted: set[int] = set()
    for before, after in pairwise(run_states[1:]):
        if after.event == "(environment)":
            moved = zip(before.state.robots, after.state.robots, strict=True)
            for pid, (old, new) in enumerate(moved):
                assert is_allowed(app, old.ports, new.ports, pid, before.state) and old.locals == new.locals
            assert before.state.store == after.state.store
            begun, acted = after.state, set()
            continue
        assert after.pid is not None and after.pid not in acted, "one event a round"
        pid = after.pid
        acted.add(pid)
        steps = [c for c in choices(app, before.state, pid, begun.store) if c.event == after.event]
        assert after.state in [applied(app, before.state, step) for step in steps]
    assert failing_conjunct(invariant_of(app, name), app, run_states[-1].state) is not None


def runs(tmp_path: Path, seeds: Iterable[int]) -> int:
    """How many invariants are FALSIFIED; each run is made again."""
    many = 0
    with Solver("z3", Limits(query=1.0, total=100_000.0)) as solver:
        for seed in seeds:
            app = checked(tmp_path, program(seed))
            for verdict in prove(Question(app), solver):
                assert (verdict.verdict == "FALSIFIED") == bool(verdict.explanation and verdict.explanation.run)
                if verdict.explanation and verdict.explanation.run:
                    made_again(app, verdict.explanation.run, verdict.invariant)
                    many += 1
    return many


def test_together_obligations_are_answered_as_each_alone_is(tmp_path: Path) -> None:
    """Shared facts change no answer: neither those of the same room nor what was asked before."""
    with Solver("z3", Limits(query=2.0, total=1000.0)) as solver:
        for seed in range(3):
            for robots in (None, 3):
                made = list(obligation_groups(checked(tmp_path, program(seed)), robots))
                found = solver.ask_all(made)
                assert [o for o, _ in found] == [o for room in made for o in room]
                assert all(solver.ask(o).result == answer.result for o, answer in found)


def test_a_falsified_invariant_comes_with_a_run_of_the_semantics(tmp_path: Path) -> None:
    assert runs(tmp_path, range(4)) > 0


@pytest.mark.slow
def test_falsified_invariants_of_a_hundred_programs_come_with_runs(tmp_path: Path) -> None:
    assert runs(tmp_path, range(100)) >= 10


@pytest.mark.slow
def test_solvers_agree_on_random_programs(tmp_path: Path) -> None:
    """`Both` raises where one says sat and another unsat."""
    with solvers() as both:
        decided = [
            both.ask(o).result != "unknown"
            for seed in range(40)
            for robots in (None, 3)
            for o in obligations(checked(tmp_path, program(seed)), robots)
        ]
    assert sum(decided) >= 0.99 * len(decided)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_solvers_agree_on_every_example(example: Path) -> None:
    program = check_file(str(example)).program
    with solvers() as both:
        verdicts = prove(Question(program), both)
    invariants = {p.name for p in program.properties if p.kind == "invariant"}
    assert invariants <= {v.invariant for v in verdicts}
    assert {v.verdict for v in verdicts} <= {"PROVED"}


def solvers() -> CrossCheck:
    return CrossCheck([Solver(name, Limits(query=10.0, total=100_000.0)) for name in ("z3", "cvc5")])
