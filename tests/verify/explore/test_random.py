"""Random programs: the explorer reaches the states of the semantics, and those that agents see."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import count

import pytest

from koordgen.lang.ir import decl
from koordgen.lang.semantics.state import State
from tests.lang.semantics.programs import compiled
from tests.verify.explore.agents import QUIET, ROUGH, Agents, stored
from tests.verify.explore.random_programs import program as random_text
from tests.verify.explore.reference import LEVEL, explored, key, reached, unjudged

N_SYS, ROUNDS = 2, 3
SHARE = 50  # programs of one slow test
LIVELY = 3  # stores that a program must be able to come to


def lively(first: int, number: int) -> Iterator[tuple[int, decl.Program, list[State]]]:
    """So many programs, from a seed on, whose robots change what they share; and all states that they come to in the
    first rounds, by the explorer."""
    for seed in count(first):
        program = unjudged(compiled(random_text(seed)))
        made, result = explored(program, N_SYS, LEVEL, ROUNDS, symmetry=False, deadlock=False, forgetting=False)
        assert result.violation is None
        states = [made.machine.state(fleet) for fleet in made.known]
        if len({stored(state.store) for state in states}) >= LIVELY:
            yield seed, program, states
            number -= 1
        if not number:
            return


def agree(first: int, number: int) -> Counter[str]:
    """All states at the ends of the first rounds are those of the semantics. What agents see at the beginnings of as
    many and one more is among them, and where nothing is lost what the semantics predicts."""
    seen: Counter[str] = Counter()
    for seed, program, states in lively(first, number):
        assert {key(state) for state in states} == reached(program, N_SYS, ROUNDS), seed
        stores = {stored(state.store) for state in states}
        networks = enumerate((QUIET, ROUGH, ROUGH))
        quiet, *rough = (Agents(program, N_SYS, 3 * seed + k, ROUNDS + 1, network) for k, network in networks)
        for expected, found in quiet.predicted(ROUNDS + 1):
            assert found == expected, seed
            seen["stores predicted"] += 1
        there = set().union(*[agents.stores(ROUNDS + 1) for agents in (quiet, *rough)])
        assert there <= stores, (seed, there - stores)
        seen += Counter({
            "programs": 1, "states": len(states), "stores": len(stores), "stores that agents saw": len(there),
            "rounds skipped": sum(r.frame is None for agents in rough for records in agents.records for r in records),
        })  # fmt: skip
    return seen


@pytest.mark.parametrize("first", (50_000, 60_000))
def test_random_programs_agree(first: int) -> None:
    seen = agree(first, 10)
    assert seen["stores"] > seen["stores that agents saw"] > 10 and seen["stores predicted"] > 10


def test_a_store_that_was_not_explored_is_seen() -> None:
    program = unjudged(compiled(random_text(5002)))
    made, _ = explored(program, N_SYS, LEVEL, 0, symmetry=False, deadlock=False)
    stores = {stored(made.machine.state(fleet).store) for fleet in made.known}
    assert not Agents(program, N_SYS, 5002, ROUNDS, QUIET).stores(ROUNDS) <= stores


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1000 // SHARE))
def test_a_thousand_random_programs_agree(part: int) -> None:
    seen = agree(part * 1000, SHARE)
    print(dict(seen))
    assert seen["programs"] == SHARE and seen["rounds skipped"] > SHARE
    assert seen["stores"] > seen["stores that agents saw"] > 2 * SHARE
