"""Agents of several applications compute what the executable semantics says, in every round."""

from __future__ import annotations

from random import Random

import pytest

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.runner import FAULT, LOST_CONTENTION, NO_EVENT, STOPPED
from tests.composed.agents import ComposedAgents, observing
from tests.lang.semantics.compositions import random_system

ROUNDS = 20
ROUGH = Conditions(loss=0.25, delay=0.001, jitter=0.03, duplication=0.1)
RAN = {"event", NO_EVENT, FAULT, STOPPED, LOST_CONTENTION}


def agrees(seed: int) -> None:
    seen = ComposedAgents(random_system(seed), seed).run(ROUNDS).follow(ROUNDS)
    assert set(seen) <= RAN, "in a quiet network no robot skips a round"


@pytest.mark.parametrize("seed", range(8))
def test_agents_of_a_composition_follow_the_semantics(seed: int) -> None:
    agrees(seed)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(8, 508, 20))
def test_agents_of_500_compositions_follow_the_semantics(first: int) -> None:
    for seed in range(first, first + 20):
        agrees(seed)


@pytest.mark.parametrize("seed", range(3))
def test_lost_datagrams_cost_rounds_and_never_change_the_meaning(seed: int) -> None:
    ComposedAgents(random_system(seed), seed, ROUGH).run(ROUNDS).follow(ROUNDS)


def killed(seed: int, rounds: int = 45) -> None:
    """An agent dies at some time and starts again at some time."""
    agents, rng = ComposedAgents(random_system(seed), seed), Random(seed)
    robot = rng.randrange(3)
    with observing(agents.applied):
        agents.fleet.run_rounds(rng.randrange(3, 8))
        agents.fleet.run(rng.random() * agents.fleet.delta)
        agents.kill(robot)
        agents.fleet.run(rng.choice([0.05, 0.5, 2.5]))
        agents.boot(robot)
    seen = agents.run(rounds).follow(rounds)
    assert seen["event"] + seen[STOPPED] + seen[NO_EVENT], "the fleet goes on"


@pytest.mark.parametrize("seed", range(4))
def test_an_agent_that_dies_rejoins_with_the_state_of_each_instance(seed: int) -> None:
    killed(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4, 104))
def test_100_agents_that_die_rejoin(seed: int) -> None:
    killed(seed)
