"""Exploration compared with the executable semantics, state by state, and reductions with the plain search."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.verify.explore.search import Search
from koordgen.verify.explore.symmetry import asymmetry, sorted_robots
from koordgen.verify.prove.report.model import is_true
from tests.lang.semantics.priorities import in_one_block, ranked
from tests.lang.semantics.programs import compiled
from tests.verify.explore.random_programs import program as random_text
from tests.verify.explore.reference import (
    LEVEL,
    NOTHING,
    after_explored,
    after_round,
    explored,
    key,
    reached,
    search,
    unjudged,
)

EXAMPLES = Path(__file__).parents[3] / "examples"
FINITE = ("election/election", "atomicsum/atomicsum", "atomicsum/mutex")
SYMMETRIC = (2, 36, 85, 123, 133, 144, 160, 161)  # of the random programs, those that treat all robots alike

PLAIN = {"symmetry": False, "independence": False, "forgetting": False}

ALIKE = """
allread: bool ready[N_SYS]
  int n[N_SYS]
allwrite: int total
  int last
local: bool told

Ready:
  pre: not ready[pid]
  eff: ready[pid] = True
Add:
  pre: ready[pid] and n[pid] < 2
  eff: atomic:
    n[pid] = n[pid] + 1
    total += n[pid]
Tell:
  pre: not False in ready and not told
  eff:
    told = True
    last = sum(n)
Stop:
  pre: told and n.count(2) == N_SYS
  eff: stop

invariant Sum: forall i, j in ID: i == j or n[i] + n[j] <= 4
invariant Last: last <= total
"""


@pytest.fixture(scope="module", params=FINITE)
def example(request: pytest.FixtureRequest) -> Program:
    return check_file(str(EXAMPLES / f"{request.param}.koord")).program


@pytest.mark.parametrize("n_sys", [1, 2, 3])
def test_examples_reach_what_the_semantics_reaches(example: Program, n_sys: int) -> None:
    made, result = explored(example, n_sys, forgetting=False)
    assert result.violation is None and not result.stopped
    assert {key(made.machine.state(fleet)) for fleet in made.known} == reached(example, n_sys, 6)


def test_examples_do_in_a_round_what_the_semantics_does(example: Program) -> None:
    for independence in (True, False):
        made, _ = explored(example, 3, independence=independence, forgetting=False)
        for fleet in islice(made.known, 0, None, 5):
            assert after_explored(made, fleet) == after_round(example, made.machine.state(fleet))


def compare_forgetting(program: Program, n_sys: int, number: int, plain: Search) -> None:
    """With what is forgotten the search comes to the states that stand for those of the plain one, no others."""
    made, _ = explored(program, n_sys, LEVEL, number, symmetry=False, deadlock=False)
    every = [made.machine.packed(plain.machine.state(fleet)) for fleet in plain.known]
    assert {made.alike(fleet) for fleet in every} == set(made.known)
    assert made.machine.enabled == plain.machine.enabled


def compare_random(seed: int, n_sys: int, number: int, states: int) -> None:
    compare_states(compiled(random_text(seed)), n_sys, number, states)


def compare_states(program: Program, n_sys: int, number: int, states: int) -> None:
    program = unjudged(program)
    made, _ = explored(program, n_sys, LEVEL, number, symmetry=False, deadlock=False, forgetting=False)
    plain, _ = explored(program, n_sys, LEVEL, number, deadlock=False, **PLAIN)
    compare_forgetting(program, n_sys, number, plain)
    fleets = list(made.known)
    assert {key(made.machine.state(f)) for f in fleets} == {key(plain.machine.state(f)) for f in plain.known}
    for fleet in fleets[:: max(1, len(fleets) // states)][:states]:
        assert after_explored(made, fleet) == after_round(program, made.machine.state(fleet))
    if n_sys < 3:
        assert {key(made.machine.state(f)) for f in fleets} == reached(program, n_sys, number)


@pytest.mark.parametrize("seed", range(30))
def test_random_programs_do_what_the_semantics_does(seed: int) -> None:
    compare_random(seed, 2, 2, 10)


@pytest.mark.parametrize("seed", range(12))
def test_compiled_invariants_say_what_the_semantics_says(seed: int) -> None:
    program = compiled(random_text(seed))
    made, _ = explored(unjudged(program), 2, LEVEL, 2, symmetry=False, deadlock=False, forgetting=False)
    judge, wanted = search(program, 2, LEVEL), [p for p in program.properties if p.kind == "invariant"]
    for fleet in made.known:
        state = made.machine.state(fleet)
        assert judge.invariants.broken(judge.machine.packed(state)) == next(
            (p for p in wanted if not is_true(p, program, state)), None
        )


def compare_verdicts(seed: int, n_sys: int, number: int) -> None:
    compare_searches(compiled(random_text(seed)), n_sys, number)


def compare_searches(program: Program, n_sys: int, number: int) -> None:
    found = [explored(program, n_sys, LEVEL, number, **switches)[1] for switches in ({}, PLAIN)]
    assert len({r.violation and r.violation.run_states[-1].round for r in found}) == 1
    reduced, plain = found
    if not reduced.violation:  # it may be through with fewer rounds
        assert plain.stopped or not reduced.stopped
        assert set(reduced.unseen) <= set(plain.unseen) and (plain.stopped or reduced.unseen == plain.unseen)


@pytest.mark.parametrize("seed", range(20))
def test_verdicts_are_those_of_the_plain_search(seed: int) -> None:
    compare_verdicts(seed, 2, 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_many_verdicts_are_those_of_the_plain_search(seed: int) -> None:
    compare_verdicts(seed, 2, 4)
    compare_verdicts(seed, 3, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_many_random_programs_do_what_the_semantics_does(seed: int) -> None:
    compare_random(seed, 2, 3, 10)
    compare_random(seed, 3, 1, 10)


def compare_alike(program: Program, n_sys: int, around: object, number: int | None) -> int:
    """With symmetry one state stands for all of its permutations, and the verdict is the same. Yields the states."""
    bare = unjudged(program)
    assert not asymmetry(program)
    alike, _ = explored(bare, n_sys, around, number, deadlock=False, forgetting=False)  # type: ignore[arg-type]
    plain, _ = explored(bare, n_sys, around, number, symmetry=False, deadlock=False, forgetting=False)  # type: ignore[arg-type]
    stand_for = {key(alike.machine.state(fleet)) for fleet in alike.known}
    every = {alike.machine.packed(plain.machine.state(fleet)) for fleet in plain.known}
    assert stand_for == {key(alike.machine.state(sorted_robots(fleet))) for fleet in every}
    results = [explored(program, n_sys, around, number, symmetry=s)[1] for s in (True, False)]  # type: ignore[arg-type]
    names = [r.violation and (r.violation.name, r.violation.run_states[-1].round) for r in results]
    assert names[0] == names[1]
    return len(plain.known) - len(alike.known)


@pytest.mark.parametrize("n_sys", [2, 3])
def test_robots_that_are_alike_are_not_told_apart(n_sys: int) -> None:
    assert compare_alike(compiled(ALIKE), n_sys, NOTHING, None) > 0


@pytest.mark.parametrize("seed", SYMMETRIC)
def test_random_programs_that_treat_all_alike(seed: int) -> None:
    compare_alike(compiled(random_text(seed)), 2, LEVEL, 2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SYMMETRIC)
def test_random_programs_of_three_that_treat_all_alike(seed: int) -> None:
    compare_alike(compiled(random_text(seed)), 3, LEVEL, 2)


@pytest.mark.parametrize("old, new", [
    ("n[pid] < 2", "n[0] < 2"),
    ("last = sum(n)", "last = pid"),
    ("n[pid] = n[pid] + 1", "n[pid] = n[pid] + 1 + pid"),
    ("    last = sum(n)", "    for i in ID:\n      last = i"),
    ("n[i] + n[j] <= 4", "i < j or n[i] <= 4"),
    ("n.count(2) == N_SYS", "n[N_SYS - 1] == 2"),
])  # fmt: skip
def test_whatever_tells_robots_apart_is_seen(old: str, new: str) -> None:
    assert not asymmetry(compiled(ALIKE))
    assert asymmetry(compiled(ALIKE.replace(old, new)))


@pytest.mark.parametrize("seed", range(24))
def test_random_priorities_do_what_the_semantics_does(seed: int) -> None:
    compare_states(compiled(ranked(seed)), 2, 2, 8)


@pytest.mark.parametrize("seed", range(12))
def test_with_priorities_verdicts_are_those_of_the_plain_search(seed: int) -> None:
    compare_searches(compiled(ranked(seed)), 2, 2)


def test_alike_robots_with_priorities_are_those_of_the_plain_search() -> None:
    ordered = compiled(in_one_block(ALIKE))
    assert compare_alike(ordered, 3, NOTHING, None) < compare_alike(compiled(ALIKE), 3, NOTHING, None)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(300))
def test_many_random_priorities_do_what_the_semantics_does(seed: int) -> None:
    compare_states(compiled(ranked(seed)), 2, 3, 10)
    compare_states(compiled(ranked(seed)), 3, 1, 10)
    compare_searches(compiled(ranked(seed)), 2, 4)
