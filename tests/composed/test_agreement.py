"""Agents of several applications compute what the executable semantics says, in every round."""

from __future__ import annotations

from random import Random

import pytest

from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.program.runner import FAULT, LOST_CONTENTION, NO_EVENT, STOPPED
from tests.composed.agents import ComposedAgents, observing
from tests.lang.semantics.compositions import compiled, random_system

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


def everywhere(seed: int) -> System:
    """Return a random composition whose applications run on all robots."""
    system = random_system(seed)
    return replace(system, applications=tuple([replace(a, members=(0, 1, 2)) for a in system.applications]))


def killed(system: System, seed: int, rounds: int = 45) -> None:
    """An agent dies at some time and starts again at some time."""
    agents, rng = ComposedAgents(system, seed), Random(seed)
    robot = rng.randrange(3)
    with observing(agents.applied):
        agents.fleet.run_rounds(rng.randrange(3, 8))
        agents.fleet.run(rng.random() * agents.fleet.delta)
        agents.kill(robot)
        agents.fleet.run(rng.choice([0.05, 0.5, 2.5]))
        agents.boot(robot)
    agents.run(rounds).follow(rounds)
    assert not any(each.agent.status for each in agents.fleet.robots.values()), "no robot is lost"


@pytest.mark.parametrize("seed", range(8))
def test_an_agent_that_dies_rejoins_with_the_state_of_each_instance(seed: int) -> None:
    killed(everywhere(seed), seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4, 104))
def test_100_agents_that_die_rejoin(seed: int) -> None:
    killed(everywhere(seed) if seed % 2 else random_system(seed), seed)


RARELY = "local: int k\nOnce:\n  pre: k == 0\n  eff: k = pid + 1\n"
OFTEN = "local: int k\nGo:\n  pre: True\n  eff: k += 1\n"
CONTENDS = "{0}local: int k\nAdd:\n  pre: True\n  eff: atomic:\n    n += 1\n    k += 1\n"


def contending() -> System:
    """Return three applications on three robots that all want one lock: each instance wins it every ninth round."""
    first = compiled("first", CONTENDS.format("export:\n  write int n\nallwrite: int n\n"))
    others = [compiled(name, CONTENDS.format("import First:\n  write int n\n")) for name in ("second", "third")]
    bound = [Application(p.name, p, (0, 1, 2), (("First", "first"),)) for p in others]
    return System((Application("first", first, (0, 1, 2)), *bound), 3)


def restarted(system: System, round_: int) -> ComposedAgents:
    """Kill the agent of robot 1 in a round, and start it again."""
    agents = ComposedAgents(system)
    with observing(agents.applied):
        agents.fleet.run_rounds(round_)
        agents.fleet.run(0.07)
        agents.kill(1)
        agents.boot(1)
    agents.run(round_ + 12).follow(round_ + 12)
    assert not any(each.agent.status for each in agents.fleet.robots.values()), "no robot is lost"
    return agents


def test_an_instance_that_rarely_acts_finds_its_state_after_a_restart() -> None:
    programs = [compiled("rarely", RARELY), compiled("often", OFTEN)]
    agents = restarted(System(tuple([Application(p.name, p, (0, 1, 2)) for p in programs]), 3), 25)
    rarely, often = agents.fleet.robots[1].agent._instances
    assert rarely.runner.locals == {"k": 2} and often.runner.locals["k"] >= 30


@pytest.mark.parametrize("round_", [13, 15, 17])
def test_an_instance_that_lost_its_lock_many_times_finds_its_state_after_a_restart(round_: int) -> None:
    restarted(contending(), round_)
