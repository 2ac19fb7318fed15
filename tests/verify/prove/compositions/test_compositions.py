"""Proofs of compositions: known verdicts of each rule, runs of random compositions, and mutants of the prover."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date

import pytest

from koordgen.verify.prove.smt.solve import Solver
from tests.verify.prove.compositions.judging import contradiction, judged, proved
from tests.verify.prove.compositions.mutants import MUTANTS
from tests.verify.prove.compositions.randomly import random_composition
from tests.verify.prove.compositions.systems import KNOWN
from tests.verify.prove.mutants.mutants import LIMITS, planted

SHARES = 3
TODAY = date.today().toordinal() % SHARES


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", LIMITS) as running:
        yield running


@pytest.mark.parametrize("name", KNOWN)
def test_the_verdicts_of_a_composition_are_known(name: str, solver: Solver) -> None:
    known = KNOWN[name]
    system = known.system()
    found = judged(system, solver)
    assert proved(found) == set(filter(None, known.proved.split(", ")))
    assert contradiction(system, found) is None


def check_random(seed: int, solver: Solver) -> None:
    system = random_composition(seed)
    found = judged(system, solver)
    assert contradiction(system, found, 0.1, seed) is None


@pytest.mark.parametrize("seed", range(8))
def test_no_verdict_about_a_random_composition_is_contradicted(seed: int, solver: Solver) -> None:
    check_random(seed, solver)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8, 500))
def test_no_verdict_about_many_random_compositions_is_contradicted(seed: int, solver: Solver) -> None:
    check_random(seed, solver)


def test_random_compositions_have_verdicts_of_both_kinds(solver: Solver) -> None:
    systems = [random_composition(seed) for seed in range(4)]
    verdicts = [v for system in systems for part in judged(system, solver).applications for v in part.verdicts]
    for kind in (True, False):
        names = {v.verdict == "PROVED" for v in verdicts if v.invariant.startswith("guarantee ") is kind}
        assert names == {True, False}


def is_caught(name: str, solver: Solver) -> bool:
    mutant = MUTANTS[name]
    known = KNOWN[mutant.program]
    system = known.system()
    with planted(mutant):
        found = judged(system, solver)
        if mutant.unsound:
            return any(contradiction(system, found, 0.2, seed) is not None for seed in range(5))
        return proved(found) != set(filter(None, known.proved.split(", ")))


@pytest.mark.parametrize("name", list(MUTANTS)[TODAY::SHARES])
def test_a_wrong_proof_of_compositions_is_caught(name: str, solver: Solver) -> None:
    assert is_caught(name, solver)


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_every_wrong_proof_of_compositions_is_caught(name: str, solver: Solver) -> None:
    assert is_caught(name, solver)


def test_every_rule_has_mutants() -> None:
    assert {mutant.rule for mutant in MUTANTS.values()} == set("BEIPA")
    assert {mutant.rule for mutant in MUTANTS.values() if mutant.unsound} == set("BEIP")  # no run contradicts A
