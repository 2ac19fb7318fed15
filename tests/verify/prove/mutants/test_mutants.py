"""A prover with one wrong line is detected: each rule of the verification conditions has mutants.

A quarter of the mutants is caught each day, all others under `-m slow`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from datetime import date
from pathlib import Path

import pytest

from koordgen.verify.prove.smt.solve import Solver
from tests.verify.prove.mutants.catalogue import MUTANTS
from tests.verify.prove.mutants.mutants import LIMITS, caught, fixed, planted

DOCS = Path(__file__).parents[4] / "docs"
UNRULED = "values"  # how values become terms: docs/explanation/prover.md
SHARES = 4
TODAY = date.today().toordinal() % SHARES
FEW = list(MUTANTS)[TODAY::SHARES]
RULES = re.findall(r"^\| ([VT]\d+) ", (DOCS / "reference/semantics.md").read_text(), re.MULTILINE)


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", LIMITS) as running:
        yield running


def check(name: str, solver: Solver) -> None:
    mutant = MUTANTS[name]
    assert fixed(mutant, solver, (mutant.program,)) is None, f"{mutant.program} is judged wrong without any mutant"
    assert caught(mutant, solver) is not None, name


@pytest.mark.parametrize("name", FEW)
def test_a_wrong_prover_is_caught(name: str, solver: Solver) -> None:
    check(name, solver)


@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_changes_one_line_of_the_prover(name: str) -> None:
    with planted(MUTANTS[name]):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MUTANTS if name not in FEW])
def test_every_wrong_prover_is_caught(name: str, solver: Solver) -> None:
    check(name, solver)


def test_every_rule_has_an_unsound_mutant() -> None:
    unsound = Counter(mutant.rule for mutant in MUTANTS.values() if mutant.unsound)
    assert len(RULES) == 27
    assert {rule for rule in RULES if not unsound[rule]} == {"V5"}  # no run contradicts a program that has none
    assert {mutant.rule for mutant in MUTANTS.values()} == {*RULES, UNRULED}


def test_the_documentation_counts_the_mutants_of_each_rule() -> None:
    rows = re.findall(
        r"^\| ([VT]\d+|values) \|[^|]*\| (\d+) \| (\d+) \|", (DOCS / "explanation/prover.md").read_text(), re.MULTILINE
    )
    counts = Counter((mutant.rule, mutant.unsound) for mutant in MUTANTS.values())
    assert rows == [(rule, str(counts[rule, True]), str(counts[rule, False])) for rule in (*RULES, UNRULED)]


def test_a_mutant_whose_line_is_gone_cannot_be_planted() -> None:
    mutant = next(iter(MUTANTS.values()))
    for line in ("no such line", "stage"):
        with pytest.raises(ValueError, match="times in base"), planted(mutant._replace(line=line)):
            pass


def test_a_mutant_is_gone_once_it_was_planted(solver: Solver) -> None:
    mutant = MUTANTS["what init writes is not looked at"]
    for _ in range(2):
        assert fixed(mutant, solver, (mutant.program,)) is None
        with planted(mutant):
            assert fixed(mutant, solver, (mutant.program,)) is not None
