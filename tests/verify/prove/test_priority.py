"""Proofs, counterexamples and runs of programs with `priority:` blocks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.node import replace
from koordgen.lang.semantics.exact import exact
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.report.explain import invariant_of
from koordgen.verify.prove.report.reach import SearchBounds, run_to
from koordgen.verify.prove.report.verdict import InvariantVerdict, Question, prove
from koordgen.verify.prove.smt.solve import Limits, Solver
from tests.lang.semantics.priorities import in_one_block, ranked
from tests.verify.prove.randomly.judges import Effort, explored
from tests.verify.prove.test_agreement import checked, made_again

# Without an order Go may run where the robot is hot.
HOT = """
local: int a
  bool hot
Stop:
  pre: hot
  eff: hot = False
Heat:
  pre: a == 3
  eff:
    hot = True
    a = 4
Go:
  pre: a < 9
  eff: a = 1 if hot else a + 1
invariant Q: forall i in ID: not hot[i] or a[i] == 4
"""
# First writes `turn`, which its own guard reads; so of two robots both may run Second only in a round that began so.
ATOMIC = """
allwrite: int sum
  int turn
First:
  pre: turn == 0
  eff: atomic:
    turn = 1
    sum += 0
Second:
  pre: True
  eff: atomic:
    sum += 1
    turn = 2
invariant Q: sum == 0 or turn > 0
invariant Never: turn == 1 or sum < 3
"""
NO_VALUE = """
local: List<int> xs
  int a
Wait:
  pre: xs[0] > 1
  eff: a = 0
Go:
  pre: True
  eff: a = 1
invariant Q: forall i in ID: a[i] == 0
invariant Empty: forall i in ID: len(xs[i]) == 0
"""
# In a round that begins with s == 1 one robot may run Reset, then another one Second.
RESET = """
allwrite: int s = 1
  bool bad
priority:
  First:
    pre: s == 0
    eff: s = 1
  Second:
    pre: True
    eff: atomic:
      if s == 0: bad = True
Reset:
  pre: s == 1
  eff: atomic:
    s = 0
invariant Good: not bad
invariant Either: s == 0 or s == 1
"""


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=2.0, total=1000.0)) as running:
        yield running


def verdicts(program: Program, solver: Solver) -> dict[str, InvariantVerdict]:
    return {verdict.invariant: verdict for verdict in prove(Question(program), solver)}


@pytest.mark.parametrize(("text", "name"), [(HOT, "Q"), (NO_VALUE, "Q")], ids=["hot", "no value"])
def test_what_rests_on_the_order_is_proved_with_it_and_falsified_without(
    text: str, name: str, tmp_path: Path, solver: Solver
) -> None:
    free = verdicts(checked(tmp_path, text), solver)[name]
    assert free.verdict == "FALSIFIED"
    assert free.explanation is not None and free.explanation.run is not None
    assert not free.explanation.run.of_agents
    assert verdicts(checked(tmp_path, in_one_block(text)), solver)[name].verdict == "PROVED"


def test_guards_of_a_transaction_s_block_are_read_at_the_round_s_start(tmp_path: Path, solver: Solver) -> None:
    """Second of one robot may follow First of another one, in a round that began with turn == 0."""
    program = checked(tmp_path, in_one_block(ATOMIC))
    found = verdicts(program, solver)
    assert found["Q"].verdict == "PROVED"
    assert found["Never"].verdict == "FALSIFIED"
    facts = [f.label for o in obligations(program) if o.event == "Second" for f in o.facts]
    assert "guard of First (earlier, by priority)" in facts


def test_a_transaction_may_see_an_earlier_guard_hold(tmp_path: Path, solver: Solver) -> None:
    found = verdicts(checked(tmp_path, RESET), solver)["Good"]
    assert found.verdict == "NOT INDUCTIVE" and found.explanation is not None
    shown = found.explanation.counterexample
    assert shown is not None and shown.event == "Second"
    assert (shown.begun.cells["s"], shown.before.store.cells["s"]) == (1, 0)


def test_a_step_that_breaks_the_order_is_not_shown(tmp_path: Path, solver: Solver) -> None:
    """The obligations of the program without its block have models that the program with it does not."""
    from koordgen.verify.prove.report.model import run_model
    from koordgen.verify.prove.report.model_reader import ModelReader, Unshowable

    free = checked(tmp_path, HOT)
    ordered = checked(tmp_path, in_one_block(HOT))
    obligation = next(o for o in obligations(free, 1, detail="most") if o.event == "Go" and o.kind == "event")
    reader = ModelReader(obligation)
    answer = solver.ask(obligation, reader.wanted())
    assert answer.result == "sat"
    reader.answered(answer.values)
    assert run_model(exact(free), obligation, reader, 1).event == "Go"
    with pytest.raises(Unshowable, match="an earlier event of the same priority block"):
        run_model(exact(ordered), obligation, reader, 1)


def test_runs_are_looked_for_within_the_block(tmp_path: Path) -> None:
    free, ordered = (exact(checked(tmp_path, text)) for text in (HOT, in_one_block(HOT)))
    bounds = SearchBounds(seconds=20.0)
    assert run_to(free, invariant_of(free, "Q"), (), bounds, 1) is not None
    assert run_to(ordered, invariant_of(ordered, "Q"), (), bounds, 1) is None


def test_of_runs_of_equally_many_rounds_one_that_agents_can_do_is_taken(tmp_path: Path) -> None:
    """Late comes first to 7, as agents do not; Third does so in as many rounds."""
    text = """
local: int a
First:
  pre: pid == 0 and a == 0
  eff: a = 3
Late:
  pre: a == 0
  eff: a = 7
invariant Q: forall i in ID: a[i] != 7
"""
    program = exact(checked(tmp_path, text))
    run = run_to(program, invariant_of(program, "Q"), (), SearchBounds(seconds=20.0))
    assert run is not None and run.of_agents
    assert [(m.event, m.pid) for m in run.run_states[2:]] == [("Late", 1)]
    alone = run_to(program, invariant_of(program, "Q"), (), SearchBounds(seconds=20.0), 1)
    assert alone is not None and not alone.of_agents


def proved(program: Program, solver: Solver) -> frozenset[str]:
    names = {v.invariant for v in prove(Question(program), solver) if v.verdict == "PROVED"}
    return frozenset(names & {p.name for p in program.properties})


def agree(tmp_path: Path, seeds: range) -> tuple[int, int, int]:
    """How many invariants are proved with a block, how many without it, how many are not; none that is proved is
    violated."""
    with_block = without = no = 0
    with Solver("z3", Limits(query=1.0, total=100_000.0)) as solver:
        for seed in seeds:
            app = checked(tmp_path, ranked(seed))
            names = proved(app, solver)
            free = replace(app, events=tuple(replace(event, priority=None) for event in app.events))
            with_block, without, no = with_block + len(names), without + len(proved(free, solver)), no + 3 - len(names)
            assert explored(app, names, seed, Effort(states=600, rounds=3, seconds=5.0)) is None, f"seed {seed}"
    return with_block, without, no


@pytest.mark.slow
def test_what_is_proved_with_priorities_holds_of_three_hundred_programs(tmp_path: Path) -> None:
    with_block, without, no = agree(tmp_path, range(300))
    assert with_block > without and no > with_block / 4


def test_falsified_invariants_come_with_runs_within_the_blocks(tmp_path: Path) -> None:
    many = 0
    with Solver("z3", Limits(query=1.0, total=100_000.0)) as solver:
        for seed in range(3):
            app = checked(tmp_path, ranked(seed))
            for verdict in prove(Question(app), solver):
                if verdict.explanation and verdict.explanation.run:
                    made_again(app, verdict.explanation.run, verdict.invariant)
                    many += 1
    assert many > 0


def test_the_examples_with_blocks_are_proved(solver: Solver) -> None:
    examples = Path(__file__).parents[3] / "examples"
    for name in ("hvac/hvac", "follow/follow"):
        program = check_file(str(examples / f"{name}.koord")).program
        assert any(event.priority is not None for event in program.events)
        assert {v.verdict for v in prove(Question(program), solver)} == {"PROVED"}
