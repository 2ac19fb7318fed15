"""Exploration of several applications: compared with brute force by the executable semantics, and its results."""

from __future__ import annotations

import json
from collections.abc import Collection
from random import Random

import pytest

from koordgen.lang.ir import decl
from koordgen.lang.node import replace
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.system import initial_system, run_inits, system_round
from koordgen.verify.explore.environment import Environment, SensorDomain
from koordgen.verify.explore.machine import Packed, RobotStep
from koordgen.verify.explore.search import DEADLOCK, WELL_DEFINED
from koordgen.verify.explore.system.rounds import SystemRounds
from koordgen.verify.explore.system.search import SystemResult
from koordgen.verify.explore.system.show import document, itf, report
from tests.lang.semantics.compositions import compiled, random_system
from tests.lang.semantics.programs import compiled as alone
from tests.lang.semantics.test_system import pair
from tests.verify.explore import reference
from tests.verify.explore.random_programs import program as random_text
from tests.verify.explore.systems import (
    NOTHING,
    brute_force,
    explored,
    guarded_system,
    key,
    random_body_system,
    search,
    started,
)

MOST = 60  # states of a composition that brute force explores every day
BUILDING = """
export:
  write List<int> done
    guarantee Kept: len(done) <= len(done')
    guarantee Few: len(done) < {few}
allwrite: List<int> done max 9
Put:
  pre: len(done) < 2
  eff: {put}
invariant Below: len(done) < 9
"""
TASK = """
import Building:
  write List<int> done max 9
local: int seen
Look:
  pre: len(done) > seen
  eff: seen = len(done)
{more}
invariant Seen: forall i in ID: seen[i] <= len(done)
"""


def building(put: str = "atomic: done.append(pid)", few: int = 4, more: str = "") -> System:
    """Building on robots 0 and 1, Task on robots 1 and 2."""
    exporter = Application("building", compiled("building", BUILDING.format(put=put, few=few)), (0, 1))
    importer = compiled("task", TASK.format(more=more))
    return System((exporter, Application("task", importer, (1, 2), (("Building", "building"),))), 3)


def unjudged(system: System) -> System:
    """Return a system without invariants and guarantees, so that nothing ends a search early."""
    bare = []
    for application in system.applications:
        program = application.program
        kept = tuple([p for p in program.properties if p.kind == "initially"])
        exports = tuple([replace(export, guarantees=()) for export in program.exports])
        bare.append(replace(application, program=replace(program, properties=kept, exports=exports)))
    return System(tuple(bare), system.robots)


def compare(system: System, rounds: int, around: Environment = NOTHING, most: int = MOST) -> bool:
    """Compare the search with brute force, with and without the reduction. Return whether brute force was possible."""
    expected = brute_force(system, rounds, around, most)
    if expected is None:
        return False
    first = min(expected.broken.values(), default=None)
    for independence in (True, False):
        made, result = explored(unjudged(system), around, rounds, deadlock=False, independence=independence)
        assert result.violation is None
        assert {key(system, made.machine.state(fleet)) for fleet in made.known} == expected.states
        _, result = explored(system, around, rounds, deadlock=False, independence=independence)
        if result.violation is None:
            assert not expected.broken
        else:
            found = result.violation
            assert expected.broken[found.application or 0, found.name] == found.run_states[-1].round == first
    return True


@pytest.mark.parametrize("seed", [pytest.param(n, marks=pytest.mark.slow) if n >= 12 else n for n in range(24)])
def test_random_compositions_reach_what_the_semantics_reaches(seed: int) -> None:
    compare(guarded_system(seed), 2)


@pytest.mark.parametrize("seed", range(10))
def test_robots_with_sensors_reach_what_the_semantics_reaches(seed: int) -> None:
    system, around = random_body_system(seed)
    compare(system, 2, around)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(16))
def test_many_random_compositions_reach_what_the_semantics_reaches(part: int) -> None:
    compared = [compare(guarded_system(10 * part + n), 2, most=150) for n in range(100, 110)]
    compared += [compare(guarded_system(10 * part + n, robots=3), 1, most=400) for n in range(100, 110)]
    for system, around in [random_body_system(10 * part + n) for n in range(100, 110)]:
        compared.append(compare(system, 2, around, most=150))
    assert sum(compared) > 10


def within(seed: int, robots: int, rounds: int) -> None:
    """Compare rounds of agents, some of whose instances skip, with the states that the search reaches."""
    system = unjudged(guarded_system(seed, robots))
    made, _ = explored(system, rounds=rounds, deadlock=False)
    reached = {key(system, made.machine.state(fleet)) for fleet in made.known}
    (state,) = started(system)
    count = len(system.instances())
    for number in range(rounds):
        state, _ = system_round(system, state, skipping=[n for n in range(count) if (seed + number + n) % 5 == 0])
        assert key(system, state) in reached


@pytest.mark.parametrize("seed", range(12))
def test_rounds_of_agents_are_among_those_explored(seed: int) -> None:
    within(seed, 2, 2)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(25))
def test_many_rounds_of_agents_are_among_those_explored(part: int) -> None:
    for seed in range(1000 + 10 * part, 1010 + 10 * part):
        within(seed, 2, 3)
        within(seed, 3, 1)


def follow(system: System, seed: int, rounds: int) -> int:
    """Follow the rounds of a composition's agents with the explorer's steps. Return the number of steps.

    In each round some instances skip. Each step must be a choice of the explorer, in the order of the effects."""
    made, dice, taken = search(system), Random(seed), 0
    (before,) = made.around.starts()
    fleet = made.machine.packed(initial_system(system, before))
    (fleet,) = made.machine.after_init(fleet)
    state, _ = run_inits(system, initial_system(system))
    for _ in range(rounds):
        assert key(system, made.machine.state(fleet)) == key(system, state)
        skipping = [number for number in range(len(system.instances())) if dice.random() < 0.2]
        state, steps = system_round(system, state, skipping)
        begun = fleet
        for number, step in steps:
            if isinstance(step.outcome, Writes):
                phases = range(len(made.rounds._explorers[0].phases))
                choices = [c for index in phases for c in made.rounds._choices(index, number, fleet, begun)]
                (choice,) = [c for c in choices if made._event_name(number, c.event) == step.event]
                fleet = made.machine.applied(fleet, number, begun[made.machine.own_places[number]], choice)
                taken += 1
    return taken


@pytest.mark.parametrize("seed", range(20))
def test_each_step_of_agents_is_a_choice_of_the_explorer(seed: int) -> None:
    follow(random_system(seed), seed, 20)


@pytest.mark.slow
def test_many_steps_of_agents_are_choices_of_the_explorer() -> None:
    taken = sum([follow(guarded_system(seed, robots, 7), seed, 20) for seed in range(1000, 1500) for robots in (2, 3)])
    assert taken > 20_000


class RoundsOfSome(SystemRounds):
    """Rounds in which only the instances in `acting` run events: some of all the rounds that the explorer allows."""

    acting: Collection[int] = ()

    def _choices(self, index: int, number: int, fleet: Packed, begun: Packed) -> tuple[RobotStep, ...]:
        return super()._choices(index, number, fleet, begun) if number in self.acting else ()

    def _first(self, number: int, fleet: Packed) -> tuple[int, int | None] | None:
        return super()._first(number, fleet) if number in self.acting else None


def successors(system: System, seed: int, rounds: int = 20, independence: bool = True) -> int:
    """Look up the result of each round of agents among the results that the explorer finds for the round.

    It is one of all results, and one of those of rounds that agents can execute. Some instances skip each round. The
    explorer need not look at rounds in which other instances act than in the round of the agents. Return the number of
    events."""
    made, dice, taken = search(system), Random(seed), 0
    allowed, agents = (
        RoundsOfSome(made.machine, made.guarantees, independence, as_agents) for as_agents in (False, True)
    )
    state, _ = run_inits(system, initial_system(system))
    for number in range(1, rounds + 1):
        fleet = made.machine.packed(state)
        skipping = [instance for instance in range(len(system.instances())) if dice.random() < 0.2]
        state, steps = system_round(system, state, skipping)
        ran = [instance for instance, step in steps if isinstance(step.outcome, Writes)]
        result = (sum([1 << instance for instance in ran]), made.machine.packed(state))
        for of in (allowed, agents):
            of.acting = ran
            assert result in of.ends(fleet), (number, ran)
        taken += len(ran)
    return taken


@pytest.mark.parametrize("robots", [2, 3])
@pytest.mark.parametrize("seed", [12, 17, 38, 45])  # each rule about conflicts and carried writes matters in one
def test_the_result_of_each_round_of_agents_is_one_of_the_explorer(seed: int, robots: int) -> None:
    successors(random_system(seed, robots), seed)


@pytest.mark.parametrize("seed", range(3))
def test_without_reduction_the_result_of_each_round_is_one_of_the_explorer(seed: int) -> None:
    successors(random_system(seed, 2), seed, 4, independence=False)


@pytest.mark.slow
@pytest.mark.parametrize("robots", [2, 3])
@pytest.mark.parametrize("part", range(20))
def test_the_results_of_10_000_rounds_of_agents_are_those_of_the_explorer(part: int, robots: int) -> None:
    """500 compositions for each number of robots, 20 rounds each."""
    taken = sum([successors(random_system(seed, robots), seed) for seed in range(2000 + 25 * part, 2025 + 25 * part)])
    assert taken > 500


@pytest.mark.parametrize("seed", range(6))
def test_one_application_reaches_the_states_of_its_program(seed: int) -> None:
    program = reference.unjudged(alone(random_text(seed)))
    system = System((Application("only", program, (0, 1)),), 2)
    made, _ = explored(system, reference.LEVEL, 2, deadlock=False)
    plain, _ = reference.explored(program, 2, reference.LEVEL, 2, deadlock=False, symmetry=False, forgetting=False)
    found = {reference.key(made.machine.view_state(fleet, 0)) for fleet in made.known}
    assert found == {reference.key(plain.machine.state(fleet)) for fleet in plain.known}
    assert made.progress()[:4] == plain.progress()[:4]


def names(result: SystemResult) -> list[tuple[int, str, int | None]]:
    assert result.violation is not None
    return [(s.round, s.event, s.instance) for s in result.violation.run_states]


def test_a_composition_that_keeps_its_guarantees_is_explored_completely() -> None:
    _, result = explored(building(), deadlock=False)
    assert result.violation is None and not result.stopped and not result.unseen and not result.unchecked
    shown = report(result, building(), "fleet.yaml", ("ann", "bob", "cleo"))
    assert "fleet.yaml, 2 applications, 3 robots: HOLDS" in shown
    assert "Kept of building, Few of building, Seen of task" in " ".join(shown.split())
    assert "no two robots count as alike" in shown


def test_a_plain_append_breaks_the_guarantee_that_the_list_never_gets_shorter() -> None:
    """The second robot appends to the list of the round's start, so the list does not grow: its items change."""
    system = building("done = [pid] if len(done) < 1 or pid == 1 else [0, pid]")
    _, result = explored(system, deadlock=False)
    assert names(result)[-1][0] == 2 and result.violation is not None
    assert (result.violation.application, result.violation.name) == (0, "Kept")
    last = result.violation.run_states[-1]
    assert last.instance == 1, "robot 1 writes one item where there are two"
    shown = report(result, system, "fleet.yaml", ("ann", "bob", "cleo"))
    assert "Kept of building is violated after 2 rounds" in shown and "Put of building on bob" in shown
    assert "done = [0, 0], done' = [1]" in " ".join(shown.split()) and "(building.koord:4)" in shown
    assert all(len(line) <= 100 for line in shown.splitlines())


def test_an_importer_that_breaks_a_guarantee_is_named_with_the_exporter() -> None:
    system = building(more="Clear:\n  pre: len(done) > 1\n  eff: atomic: done = []")
    _, result = explored(system, deadlock=False)
    told = document(result, system, ("ann", "bob", "cleo"))["violation"]
    assert (told["application"], told["what"], told["rounds"]) == ("building", "Kept", 1)
    last = told["run"][-1]
    assert (last["event"], last["application"], last["robot"]) == ("Clear", "task", "bob")
    assert last["pid"] == 0 and last["applications"]["building"]["shared"] == {"done": "[]"}
    assert json.loads(json.dumps(told)) == told


def test_a_state_guarantee_is_checked_in_each_state() -> None:
    _, result = explored(building(few=2), deadlock=False)
    assert result.violation is not None and result.violation.name == "Few"
    assert names(result)[2:] == [(1, "Put", 0), (1, "Put", 1)]


def test_an_invariant_of_an_importer_is_checked_after_writes_of_the_exporter() -> None:
    system = building("atomic: done = [] if len(done) > 0 else [1]", few=9)
    program = replace(system.applications[0].program, exports=(replace(system.applications[0].program.exports[0],
                                                                       guarantees=()),))  # fmt: skip
    system = System((replace(system.applications[0], program=program), system.applications[1]), 3)
    _, result = explored(system, deadlock=False)
    assert result.violation is not None
    assert (result.violation.application, result.violation.name) == (1, "Seen")
    assert [event for _, event, _ in names(result)] == ["", "init", "Put", "Look", "Put"]


def test_an_event_without_a_result_names_its_application() -> None:
    system = building(more="Bad:\n  pre: len(done) > 1\n  eff: atomic: seen = 1 // (len(done) - 2)")
    for independence in (True, False):
        _, result = explored(system, deadlock=False, independence=independence)
        found = result.violation
        assert found is not None and (found.application, found.name) == (1, WELL_DEFINED)
        assert names(result)[2:] == [(1, "Put", 0), (1, "Put", 1)], "an atomic event reads the writes of the round"
        assert "Bad of task on robot 1 has no result" in found.reason


def test_a_loop_invariant_names_its_application() -> None:
    loop = "Loop:\n  pre: len(done) > 1\n  eff:\n    for k in range(2):\n      invariant k < 1\n      seen = k"
    _, result = explored(building(more=loop), deadlock=False)
    found = result.violation
    assert found is not None and (found.application, found.name) == (1, "line 12")
    assert names(result)[-1][1:] == ("Loop", 2) and "in Loop of task on robot 1" in found.reason


def test_a_deadlock_of_all_applications_is_found() -> None:
    _, result = explored(building())
    assert result.violation is not None and result.violation.name == DEADLOCK
    state = result.violation.run_states[-1].state
    assert state.stores[0].cells["done"] in ((0, 1), (1, 0)) and state.locals[1] == ({"seen": 2}, {"seen": 2})
    moving = building(more="Go:\n  pre: True\n  eff: seen = min(seen, len(done))")
    assert explored(moving)[1].violation is None, "an application that goes on is no deadlock"


def test_agents_commit_one_transaction_for_each_lock_of_the_system() -> None:
    """Putting twice, by one application or by both, takes agents two rounds, because the applications share a lock."""
    system = building(few=2, more="More:\n  pre: True\n  eff: atomic: done.append(9)")
    _, free = explored(system, deadlock=False)
    assert names(free)[-1][0] == 1
    _, agents = explored(system, deadlock=False, as_agents=True)
    assert agents.violation is not None and agents.violation.name == "Few"
    assert [number for number, event, _ in names(agents)[2:] if event in ("Put", "More")] == [1, 2]


def test_transactions_of_two_applications_exclude_one_another() -> None:
    """Each application takes its flag if the other is down. Agents read both at the round's start, under a lock."""
    take = "Take:\n  pre: {} == 0\n  eff: atomic: {} = 1\n"
    export = "export:\n  write int a\n  write int b\nallwrite:\n  int a\n  int b\n"
    first = compiled("first", export + take.format("b", "a") + "invariant Mutex: a + b <= 1\n")
    second = compiled("second", "import First:\n  write int a\n  write int b\n" + take.format("a", "b"))
    bound = (("First", "first"),)
    system = System((Application("first", first, (0,)), Application("second", second, (0,), bound)), 1)
    for as_agents in (False, True):
        _, result = explored(system, deadlock=False, as_agents=as_agents)
        assert result.violation is None and not result.unseen


DRIVES = """
using Motion:
  sensors: bool reached
  actuators: Point target clears reached
local: int sent
Go:
  pre: Motion.reached and sent < 1
  eff:
    Motion.target = Point(1, 0, 0)
    sent += 1
"""
READS = """
using Motion:
  sensors: bool reached
local: bool away
Look:
  pre: not Motion.reached
  eff: away = True
invariant Here: forall i in ID: not away[i]
"""


IDLE = "local: int k\nWait:\n  pre: k < 0\n  eff: k = 0\n"


@pytest.mark.parametrize("independence", [True, False])
def test_the_applications_of_a_robot_see_the_same_ports(independence: bool) -> None:
    """The reader sees in the next round that a command of the other application has cleared the sensor."""
    first, second, third = compiled("drives", DRIVES), compiled("reads", READS), compiled("idle", IDLE)
    members = (Application("drives", first, (0,)), Application("reads", second, (0,)), Application("idle", third, (0,)))
    around = Environment({"Motion.reached": SensorDomain((False, True))}, {})
    _, result = explored(System(members, 1), around, deadlock=False, independence=independence)
    assert result.violation is not None and result.violation.name == "Here"
    events = [(number, event, instance) for number, event, instance in names(result) if event]
    assert events[1] == (1, "Go", 0) and events[-1] == (2, "Look", 1), "not in the round of the command"
    other = System((Application("drives", first, (0,)), Application("reads", second, (1,))), 2)
    _, result = explored(other, around, deadlock=False, independence=independence)
    assert names(result)[-1] == (1, "Look", 1), "nobody commands robot 1, so its sensor is free"


@pytest.mark.parametrize("independence", [True, False])
def test_a_step_after_a_command_keeps_the_cleared_sensor(independence: bool) -> None:
    drives = "export:\n  int sent\nallwrite: int sent\n" + DRIVES.replace("local: int sent\n", "")
    reads = READS.replace("not Motion.reached", "Motion.reached").replace(
        "forall i in ID: not away[i]", "sent == 0 or {}"
    )
    reads = "import Drives:\n  int sent\n" + reads.format("forall i in ID: not Motion.reached[i]")
    first, second = compiled("drives", drives), compiled("reads", reads)
    bound = (("Drives", "drives"),)
    system = System((Application("drives", first, (0,)), Application("reads", second, (0,), bound)), 1)
    around = Environment({"Motion.reached": SensorDomain((False,))}, {})
    _, result = explored(system, around, deadlock=False, independence=independence)
    assert result.violation is None and not result.unseen


def test_a_transaction_of_an_importer_sees_writes_of_the_round() -> None:
    first = compiled("first", "export:\n  int n\nallwrite: int n\nUp:\n  pre: n < 1\n  eff: n = 1\n")
    second = compiled("second", "import First:\n  int n\nlocal: int got\nGet:\n  pre: got < 1\n"
                                "  eff: atomic: got = n\ninvariant Old: forall i in ID: got[i] == 0\n")  # fmt: skip
    bound = (("First", "first"),)
    system = System((Application("first", first, (0,)), Application("second", second, (1,), bound)), 2)
    for independence in (True, False):
        _, result = explored(system, deadlock=False, independence=independence)
        assert names(result)[2:] == [(1, "Up", 0), (1, "Get", 1)]


def test_an_assumption_of_one_application_restricts_what_the_others_see() -> None:
    first = compiled("first", "using Door:\n  sensors: int level\n  assume level' <= 1\nlocal: int k\n"
                              "Go:\n  pre: k < 1\n  eff: k += 1\n")  # fmt: skip
    second = compiled("second", "using Door:\n  sensors: int level\nlocal: int k\n"
                                "Go:\n  pre: k < 1\n  eff: k += Door.level\n"
                                "initially: forall i in ID: Door.level[i] == 0\n"
                                "invariant Low: forall i in ID: Door.level[i] <= 1\n")  # fmt: skip
    around = Environment({"Door.level": SensorDomain((0, 1, 2))}, {})
    together = System((Application("first", first, (0,)), Application("second", second, (0,))), 1)
    assert explored(together, around, deadlock=False)[1].violation is None
    apart = System((Application("first", first, (1,)), Application("second", second, (0,))), 2)
    found = explored(apart, around, deadlock=False)[1].violation
    assert found is not None and found.name == "Low"


def test_records_pass_between_applications() -> None:
    record = "def Job:\n  int id = 0\n  int by = 0\n"
    first = compiled("first", record + "export:\n  write List<Job> jobs\nallwrite: List<Job> jobs max 3\n"
                     "Put:\n  pre: len(jobs) < 1\n  eff: atomic: jobs.append(Job(4, pid))\n")  # fmt: skip
    second = compiled("second", record + "import First:\n  write List<Job> jobs max 3\nlocal: int got\n"
                      "Get:\n  pre: len(jobs) == 1\n  eff: atomic:\n    got = jobs[0].id\n    jobs = []\n"
                      "invariant None_got: forall i in ID: got[i] == 0\n")  # fmt: skip
    system = System((Application("first", first, (0,)), Application("second", second, (0,), (("First", "first"),))), 1)
    _, result = explored(system, deadlock=False)
    assert result.violation is not None and result.violation.name == "None_got"
    assert [event for _, event, _ in names(result)] == ["", "init", "Put", "Get"]


def test_a_run_is_written_for_viewers() -> None:
    system = building(few=2)
    _, result = explored(system, deadlock=False)
    assert result.violation is not None
    written = json.loads(itf(result.violation, system, ("ann", "bob", "cleo")))
    assert [(s["step"], s["application"], s["robot"]) for s in written["states"]][-1] == ("Put", "building", "bob")
    assert set(written["vars"]) >= {"building.done", "task.seen[1]"}


def test_a_guarantee_of_an_allread_variable_compares_the_slots_of_all_robots() -> None:
    text = (
        "export:\n  int n[N_SYS]\n    guarantee Led: not (n[N_SYS - 1] > 0 and n[0] < n'[0])\nallread: int n[N_SYS]\n"
    )
    text += "Up:\n  pre: n[pid] < 1\n  eff: n[pid] = 1\n"
    system = System((Application("first", compiled("first", text), (0, 1)),), 2)
    for independence in (True, False):
        _, result = explored(system, deadlock=False, independence=independence)
        assert names(result)[2:] == [(1, "Up", 1), (1, "Up", 0)]


def test_limits_and_properties_without_a_meaning_are_reported() -> None:
    system = pair()
    _, result = explored(system, rounds=1, deadlock=False)
    assert result.stopped == "the limit of 1 round"
    text = "export:\n  int n\n    guarantee Fine: good(n)\nspec fun good(int n) -> bool\nallwrite: int n\n"
    text += "Up:\n  pre: n < 1\n  eff: n = 1\nDown:\n  pre: n > 1\n  eff: n = 0\n"
    other = System((Application("first", compiled("first", text), (0,)),), 1)
    _, result = explored(other, deadlock=False)
    assert result.unchecked == ((0, "Fine"),) and [(a, e.name) for a, e in result.unseen] == [(0, "Down")]
    shown = report(result, other, "fleet.yaml", ("ann",))
    assert "not checked, since a spec fun cannot be evaluated: Fine of first" in shown
    assert "never enabled: Down of first (line 9)" in shown
    assert decl.is_step(BROKEN.exports[0].guarantees[0])


BROKEN = compiled("building", BUILDING.format(put="pass", few=1))
