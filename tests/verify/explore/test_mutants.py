"""Mistakes in examples are found, by a run with the fewest possible rounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from koordgen.build.pipeline import check_file, read_source
from koordgen.lang.analyze.params import with_params
from koordgen.lang.ir.decl import Program
from koordgen.verify.explore.breadth_first import ExplorationBounds
from koordgen.verify.explore.environment import Environment, EnvironmentSteps, possible_answers
from koordgen.verify.explore.environment_file import environment
from koordgen.verify.explore.machine import Machine
from koordgen.verify.explore.search import ExplorationResult, Search
from tests.programs import programs_alone
from tests.verify.explore.mutants import EXAMPLES, MUTANTS, Mutant

N_SYS = 3


def surrounded(path: Path, env: str, name: str, n_sys: int = N_SYS) -> tuple[Program, Environment]:
    """A program with the environment of an example, and the params that it asks for."""
    program, file = check_file(str(path)).program, EXAMPLES / name
    source = read_source(str(file.with_name(f"{env}.yaml"))) if file.with_name(f"{env}.yaml").is_file() else None
    around = environment(program, n_sys, source, lambda *mistake: pytest.fail(str(mistake)))
    assert around is not None
    return with_params(program, around.params), around


def searched(
    program: Program, around: Environment, functions: Path, rounds: int | None, n_sys: int = N_SYS, **switches: Any
) -> ExplorationResult:
    machine = Machine(program, n_sys, possible_answers(around, program, n_sys), functions)
    surroundings = EnvironmentSteps(machine, around)
    return Search(machine, surroundings, ExplorationBounds(rounds), lambda: 0.0, lambda _: None, **switches).run()


def edited(mutant: Mutant) -> str:
    text = (EXAMPLES / f"{mutant.program}.koord").read_text()
    assert text.count(mutant.old) == 1, "the example has changed: the mutant is none any more"
    return text.replace(mutant.old, mutant.new) + mutant.also


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutant_is_caught_by_a_shortest_run(mutant: Mutant, tmp_path: Path) -> None:
    path = tmp_path / Path(mutant.program).with_suffix(".koord").name
    path.write_text(edited(mutant))
    program, around = surrounded(path, mutant.env, mutant.program)
    functions = EXAMPLES / f"{mutant.program}_functions.py"
    found = searched(program, around, functions, None).violation
    assert found is not None and found.name in mutant.caught.split(", ")
    assert found.run_states[-1].round == mutant.rounds
    if mutant.rounds:
        plain = searched(program, around, functions, mutant.rounds - 1, symmetry=False, independence=False)
        assert plain.violation is None and plain.progress.depth == mutant.rounds - 1


def test_there_are_enough_of_each_kind() -> None:
    examples = {path.parent.name for path in programs_alone()}
    assert len(MUTANTS) >= 20 and {Path(m.program).parts[0] for m in MUTANTS} == examples
    assert len({m.name for m in MUTANTS}) == len(MUTANTS)
