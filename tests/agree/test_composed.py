"""Agents of several applications compute what the executable semantics says, in every round."""

from __future__ import annotations

import pytest

from koordgen.runtime.program.runner import FAULT, LOST_CONTENTION, NO_EVENT, STOPPED
from tests.agree.composed import ComposedAgents
from tests.lang.semantics.compositions import random_system

ROUNDS = 20


@pytest.mark.parametrize("seed", range(6))
def test_agents_of_a_composition_follow_the_semantics(seed: int) -> None:
    seen = ComposedAgents(random_system(seed), ROUNDS, seed).follow(ROUNDS)
    assert set(seen) <= {"event", NO_EVENT, FAULT, STOPPED, LOST_CONTENTION}, "in a quiet network no round is skipped"
