"""Plans of random counterexamples of several applications: agents can execute all runs that the explorer says so of."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from koordgen.lang.ir import decl
from koordgen.lang.semantics.composition import Application, System
from koordgen.verify.explore.system.search import SystemViolation
from koordgen.verify.explore.system.trace import trace
from koordgen.verify.follow.plan import ExecutionPlan, ModelOnly, make_plan
from koordgen.verify.follow.read import read
from koordgen.verify.prove.report.trace import RunOrigin
from tests.lang.semantics.compositions import compiled
from tests.verify.explore.systems import explored, guarded_system

NAMES = ("ann", "bob", "cleo")


def planned(system: System, found: SystemViolation, folder: Path) -> ExecutionPlan:
    """Return the plan for a violation, by the text of its trace."""
    path = folder / "cx.jsonl"
    origins = [RunOrigin("0")] * len(system.applications)
    path.write_text(trace(found, system, NAMES[: system.robots], origins))
    return make_plan(system, read(path), [{}] * len(system.applications))


def plans(seed: int, robots: int, folder: Path) -> str:
    """Plan the counterexamples of a random composition. Return how agents execute the shortest run of the language."""
    system = guarded_system(seed, robots)
    _, agents = explored(system, rounds=3, deadlock=False, as_agents=True)
    if agents.violation is not None:
        plan = planned(system, agents.violation, folder)
        assert len(plan.rounds) == agents.violation.run_states[-1].round + 1, (
            "one round of agents for each of the trace"
        )
    _, free = explored(system, rounds=2, deadlock=False)
    if free.violation is None:
        return "holds"
    try:
        plan = planned(system, free.violation, folder)
    except ModelOnly:
        return "model only"
    check_last_step(system, free.violation, plan)
    return "planned"


def check_last_step(system: System, found: SystemViolation, plan: ExecutionPlan) -> None:
    """If a step guarantee is broken, the agents' last step leads from the same value to the same value."""
    exports = [] if found.application is None else system.applications[found.application].program.exports
    broken = [(e.variable, g) for e in exports for g in e.guarantees if g.name == found.name and decl.is_step(g)]
    for variable, _ in broken:
        assert found.application is not None
        states = [each.state for each in found.run_states[-2:]]
        owner = [state.stores[found.application] for state in states]
        before, after = [s.slots[variable] if variable in s.slots else s.cells[variable] for s in owner]
        assert before != after
        last = found.run_states[-1]
        events = plan.rounds[-2].events
        assert last.instance is not None and events[last.instance] == last.event


def planned_events(system: System, folder: Path) -> list[dict[int, str]]:
    """Return the events of each of the agents' rounds for the shortest run to a violation."""
    _, result = explored(system, deadlock=False)
    assert result.violation is not None and result.violation.run_states[-1].round == 1
    return [dict(each.events) for each in planned(system, result.violation, folder).rounds]


def test_transactions_of_two_applications_with_one_lock_take_two_rounds(tmp_path: Path) -> None:
    """Both write what nobody reads in this run, so the state after one round of agents would be that of the trace."""
    first = "export:\n  write int a\nallwrite: int a\nTake:\n  pre: a == 0\n  eff: atomic: a = 1\n"
    second = "import First:\n  write int a\nallwrite: int b\nTake:\n  pre: b == 0\n  eff: atomic: b = 1\n"
    second += "Both:\n  pre: a + b > 5\n  eff: atomic: a = b\ninvariant One: a + b < 2\n"
    bound = (("First", "first"),)
    applications = (
        Application("first", compiled("first", first), (0,)),
        Application("second", compiled("second", second), (1,), bound),
    )
    assert planned_events(System(applications, 2), tmp_path)[:2] in (
        [{0: "Take"}, {1: "Take"}],
        [{1: "Take"}, {0: "Take"}],
    )


def test_a_broken_step_guarantee_keeps_the_order_of_its_step(tmp_path: Path) -> None:
    """In one round, agents would write slot 0 first, which keeps the guarantee and leads to the same state."""
    text = (
        "export:\n  int n[N_SYS]\n    guarantee Led: not (n[N_SYS - 1] > 0 and n[0] < n'[0])\nallread: int n[N_SYS]\n"
    )
    program = compiled("first", text + "Up:\n  pre: n[pid] < 1\n  eff: n[pid] = 1\n")
    system = System((Application("first", program, (0, 1)),), 2)
    assert planned_events(system, tmp_path) == [{1: "Up"}, {0: "Up"}, {}]


@pytest.mark.parametrize("seed", range(8))
def test_agents_execute_what_the_explorer_says(seed: int, tmp_path: Path) -> None:
    plans(seed, 2, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("robots", [2, 3])
def test_agents_execute_many_runs_of_the_explorer(robots: int, tmp_path: Path) -> None:
    seen = Counter([plans(seed, robots, tmp_path) for seed in range(100, 300)])
    assert seen["planned"] > 50, seen
