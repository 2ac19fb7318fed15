"""True values of each of several applications, from the records of all agents."""

from __future__ import annotations

from typing import Any

import pytest

from koordgen.lang.semantics.composition import System
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.trace.schema import InitRecord, Round, decoded
from targets.sim.trace.truth import Truth
from tests.composed.agents import QUIET, ComposedAgents
from tests.lang.semantics.compositions import random_system

ROUNDS = 15
ROUGH = Conditions(loss=0.25, delay=0.001, jitter=0.03)


def heard(agents: ComposedAgents, application: int, robots: tuple[int, ...] = (0, 1, 2)) -> Truth:
    """Return the truth of an application from the traces of these robots."""
    truth = Truth(agents.program, application)
    for pid in robots:
        robot = agents.fleet.robots[pid]
        for line in robot.file.getvalue().splitlines()[1:]:
            record = decoded(line)
            if isinstance(record, InitRecord | Round):
                truth.hear(pid, record)
    return truth


def of_view(truth: Truth) -> dict[str, Any]:
    """Shared variables in the form in which events see them: allread variables as tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in truth.values.items()}


def compare(system: System, seed: int, conditions: Conditions) -> int:
    """Compare what each event read with the truth before it. Return the number of values that were compared."""
    agents, count = ComposedAgents(system, seed, conditions).run(ROUNDS), 0
    for index, application in enumerate(agents.program.applications):
        truth = heard(agents, index)
        truth.begin()
        for round_ in range(ROUNDS):
            truth.advance()
            known = of_view(truth)
            for instance in [i for i in agents.program.instances if i.application == index]:
                frame = agents.records[instance.number, round_ + 1].frame
                if frame is None:
                    continue
                for name, value in frame.shared.items():
                    assert known[name] == value, (application.name, name, round_)
                for name, value in frame.locals.items():
                    assert truth.values[name][instance.pid] == value, (application.name, name, round_)
                count += len(frame.shared) + len(frame.locals)
    return count


@pytest.mark.parametrize("seed", range(4))
def test_the_truth_of_an_application_is_what_its_next_events_read(seed: int) -> None:
    assert compare(random_system(seed), seed, QUIET) > 100


def test_lost_datagrams_do_not_change_the_truth() -> None:
    assert compare(random_system(5), 5, ROUGH) > 20


def test_the_last_round_of_a_robot_is_that_of_all_its_applications() -> None:
    agents = ComposedAgents(random_system(1), 1).run(2)
    robot = agents.program.instances[0].robot
    others = tuple([r for r in range(3) if r != robot and agents.program.of_robot(r)])
    assert heard(agents, 0).last_recorded(robot) == 2
    truth = heard(agents, 0, others)
    assert truth.last_recorded(robot) == -1
    assert others and all(truth.last_recorded(other) == 2 for other in others)
