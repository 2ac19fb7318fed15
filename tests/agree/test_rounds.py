"""Agreement in whole rounds: agents on a network without loss do what the semantics of a round says.

This includes which of several robots loses the contention for a lock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pytest

from tests.agree.both import Difference
from tests.agree.programs import N_SYS
from tests.agree.rounds import ROUNDS, Winner, agree, small


def run(seeds: Iterable[int]) -> tuple[int, Counter[str]]:
    """Return the number of programs, and the counts of results of their robots' rounds."""
    seen: Counter[str] = Counter()
    programs = [(seed, program) for seed in seeds if (program := small(seed)) is not None]
    for seed, program in programs:
        agree(program, seed, seen)
    return len(programs), seen


def test_rounds_of_agents_are_rounds_of_the_semantics() -> None:
    programs, seen = run(range(25))
    assert programs >= 16
    assert seen["init failed"] <= programs / 5
    assert seen["ran"] + seen["skipped"] + seen["discarded"] <= programs * ROUNDS * N_SYS
    assert seen["ran"] > 200
    assert seen["committed"] > 20
    assert seen["skipped"] > 20


@pytest.mark.slow
def test_rounds_of_500_programs() -> None:
    programs, seen = run(range(1000, 1600))
    print(programs, seen)
    assert programs >= 400


def last(trying: list[int], lock: int, round_: int, n_sys: int) -> int:
    return max(trying, key=lambda pid: (pid - round_ - lock) % n_sys)


def nobody(trying: list[int], lock: int, round_: int, n_sys: int) -> int:
    return -1


@pytest.mark.parametrize("wins", [last, nobody])
def test_another_winner_is_seen(wins: Winner) -> None:
    with pytest.raises(Difference):
        for seed in range(60):
            program = small(seed)
            if program is not None:
                agree(program, seed, Counter(), wins)
