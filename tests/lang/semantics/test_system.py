"""Several applications on one fleet: what each instance sees and writes, and a round of all of them."""

from __future__ import annotations

from itertools import permutations
from random import Random

import pytest

from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.semantics.eval import Discarded
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.relations import instance_choices
from koordgen.lang.semantics.step import initial, round_, run_init
from koordgen.lang.semantics.system import (
    InstanceStep,
    SystemState,
    applied_to_system,
    initial_system,
    run_inits,
    system_round,
    view,
)
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.points import Point
from tests.lang.semantics.compositions import compiled, random_system, text

MAPPING = """
export:
  write List<int> done
  int place[N_SYS]
allwrite: List<int> done max 20
allread: int place[N_SYS]
Move:
  pre: place[pid] < 9
  eff: place[pid] = place[pid] + pid + 1
"""
TASK = """
import Mapping:
  write List<int> done max 20
  int place[Mapping.N_SYS]
local:
  int sum
  int mine
  int many
Look:
  pre: len(done) < 3
  eff: atomic:
    for p in place: sum += p
    mine = Mapping.pid
    many = Mapping.N_SYS
    done.append(pid)
"""


def pair() -> System:
    """Mapping on robots 1 and 2, Task on robots 0 and 2."""
    mapping = Application("mapping", compiled("mapping", MAPPING), (1, 2))
    return System((mapping, Application("task", compiled("task", TASK), (0, 2), (("Mapping", "mapping"),))), 3)


def begun(system: System) -> SystemState:
    return run_inits(system, initial_system(system))[0]


def test_an_importer_sees_the_members_and_slots_of_the_exporter() -> None:
    system = pair()
    state, steps = system_round(system, begun(system))
    assert [(s.instance, s.step.event) for s in steps] == [(2, "Look"), (0, "Move"), (1, "Move"), (3, None)]
    assert state.stores[0].slots["place"] == (1, 2) and state.stores[0].cells["done"] == (0,)
    assert state.locals[1][0] == {"sum": 0, "mine": -1, "many": 2}, "robot 0 runs no Mapping; it saw the round's start"
    state, steps = system_round(system, state)
    assert [s.instance for s in steps if s.step.event == "Look"] == [2]
    state, steps = system_round(system, state)
    assert [s.instance for s in steps if s.step.event == "Look"] == [3], "priority rotates"
    assert state.locals[1][1] == {"sum": 6, "mine": 1, "many": 2}, "robot 2 is pid 1 of both applications"
    assert view(system, state, 1).store.cells["place"] == (3, 6)


def test_transactions_of_several_applications_on_one_variable_share_a_lock() -> None:
    first = compiled("first", "export:\n  write int n\nallwrite: int n\nAdd:\n  pre: True\n  eff: atomic: n += 1\n")
    other = (
        "import First:\n  write int n\nallwrite: int m\nAdd:\n  pre: True\n  eff: atomic:\n    n += 10\n    m += 1\n"
    )
    second = compiled("second", other)
    system = System((Application("first", first, (0,)), Application("second", second, (0,), (("First", "first"),))), 1)
    assert system.locks() == {(0, 0): 0, (1, 0): 0}
    state, seen = begun(system), []
    for _ in range(4):
        state, _ = system_round(system, state)
        seen.append((state.stores[0].cells["n"], state.stores[1].cells["m"]))
    assert seen in ([(10, 1), (11, 1), (21, 2), (22, 2)], [(1, 0), (11, 1), (12, 1), (22, 2)]), "one commits a round"


def test_the_last_plain_write_in_the_order_of_applications_remains() -> None:
    write = "\nPut:\n  pre: True\n  eff: n = {}\n"
    first = compiled("first", "export:\n  write int n\nallwrite: int n" + write.format("pid + 1"))
    second = compiled("second", "import First:\n  write int n" + write.format("pid + 10"))
    system = System(
        (Application("first", first, (0, 1)), Application("second", second, (0, 1), (("First", "first"),))), 2
    )
    assert system_round(system, begun(system))[0].stores[0].cells["n"] == 11


def test_a_discarded_or_stopped_instance_holds_alone() -> None:
    counts = "local: int k\nGo:\n  pre: True\n  eff:\n    k += 1\n    {}\n"
    fails, stops = compiled("fails", counts.format("k = 1 // (k - 1)")), compiled("stops", counts.format("stop"))
    goes = compiled("goes", counts.format("pass"))
    system = System(tuple([Application(p.name, p, (0,)) for p in (fails, stops, goes)]), 1)
    state = begun(system)
    for _ in range(3):
        state, steps = system_round(system, state)
    assert isinstance(steps[0].step.outcome, Discarded) and steps[1].step.event is None
    assert [state.locals[i][0]["k"] for i in range(3)] == [0, 1, 3] and state.stopped == ((False,), (True,), (False,))


def test_a_discarded_transaction_leaves_the_lock_to_another() -> None:
    text = "allwrite: int n\nlocal: int k\nAdd:\n  pre: True\n  eff: atomic:\n    n += 1 + 1 // (pid + k)\n"
    system = System((Application("only", compiled("only", text), (0, 1)),), 2)
    state = begun(system)
    for number in range(1, 3):
        state, steps = system_round(system, state)
        assert state.stores[0].cells["n"] == 2 * number, "instance 1 commits in each round"
        assert {s.instance for s in steps if isinstance(s.step.outcome, Discarded)} == {0}


@pytest.mark.parametrize("seed", range(40))
def test_one_application_has_the_meaning_of_its_program(seed: int) -> None:
    program = compiled("only", text(Random(seed), "only", []))
    system = System((Application("only", program, (0, 1, 2)),), 3)
    alone, _ = run_init(program, initial(program, 3))
    state = begun(system)
    for _ in range(6):
        state, steps = system_round(system, state)
        holders = {
            event.lock: s.step.pid
            for s in steps
            for event in program.events
            if event.name == s.step.event and event.lock is not None and isinstance(s.step.outcome, Writes)
        }
        alone, _ = round_(program, alone, grants=holders)
        assert view(system, state, 0) == alone


@pytest.mark.parametrize("seed", range(60))
def test_a_round_is_one_that_the_language_allows(seed: int) -> None:
    """Some order of the instances leads to the round's result, each instance running an event that it may run."""
    system = random_system(seed, robots=2)
    state = begun(system)
    for _ in range(8):
        after, steps = system_round(system, state)
        orders = permutations([s.instance for s in steps if isinstance(s.step.outcome, Writes)])
        assert any(leads(system, state, after, order, {s.instance: s.step.event for s in steps}) for order in orders)
        owned(system, state, after, steps)
        state = after


def leads(
    system: System, state: SystemState, after: SystemState, order: tuple[int, ...], events: dict[int, str | None]
) -> bool:
    """Return whether the steps in this order lead to `after`, each as relations.py allows it."""
    at = state
    for number in order:
        step = next((s for s in instance_choices(system, at, state, number) if s.event == events[number]), None)
        if step is None:
            return False
        at = applied_to_system(system, at, InstanceStep(number, step))
    return at._replace(round=after.round) == after


def owned(system: System, before: SystemState, after: SystemState, steps: list[InstanceStep]) -> None:
    """A variable changes only if an application that may write it has taken a step."""
    acted = {system.instances()[s.instance].application for s in steps if isinstance(s.step.outcome, Writes)}
    for index, application in enumerate(system.applications):
        exported = {e.variable for e in application.program.exports if e.is_written}
        for name, value in before.stores[index].cells.items():
            others = [
                other
                for other, each in enumerate(system.applications)
                for imported in each.program.imports
                if name in imported.written and system.exporter(other, imported) == index
            ]
            assert not others or name in exported
            assert after.stores[index].cells[name] == value or acted & {index, *others}
        assert after.stores[index].slots == before.stores[index].slots or index in acted
        assert after.locals[index] == before.locals[index] or index in acted


def test_the_number_of_members_is_the_exporters() -> None:
    task = Application("task", compiled("task", TASK), (2,), (("Mapping", "mapping"),))
    system = System((Application("mapping", compiled("mapping", MAPPING), (0, 1, 2)), task), 3)
    state, _ = system_round(system, begun(system))
    assert state.locals[1] == ({"sum": 0, "mine": 2, "many": 3},)


def test_the_applications_of_a_robot_see_the_same_ports() -> None:
    """One application commands, the other reads what the command clears; each sees the ports of its own modules."""
    drives = "using Motion:\n  sensors:\n    Point position\n    bool reached\n"
    drives += "  actuators: Point target at position clears reached\n"
    first = compiled("first", drives + "Go:\n  pre: Motion.reached\n  eff: Motion.target = Point(1, 0, 0)\n")
    reads = "using Motion:\n  sensors: bool reached\nusing Arm:\n  sensors: int load\nlocal: bool there\n"
    second = compiled("second", reads + "Look:\n  pre: Arm.load > 2\n  eff: there = Motion.reached\n")
    system = System((Application("first", first, (0,)), Application("second", second, (0, 1))), 2)
    here: dict[str, Value] = {"Motion.position": Point(5.0, 0.0, 0.0), "Motion.reached": True, "Arm.load": 3}
    state, _ = run_inits(system, initial_system(system, [here, {"Arm.load": 1}]))
    assert view(system, state, 0).robots[0].ports["Motion.target"] == Point(5.0, 0.0, 0.0), "held at the position"
    assert view(system, state, 1).robots[0].ports == {"Motion.reached": True, "Arm.load": 3}
    assert view(system, state, 1).robots[1].ports == {"Motion.reached": False, "Arm.load": 1}
    state, _ = system_round(system, state)
    assert state.locals[1][0]["there"] is True, "the round's start"
    assert state.ports[0]["Motion.target"] == Point(1.0, 0.0, 0.0) and state.ports[0]["Motion.reached"] is False
    state, steps = system_round(system, state)
    assert state.locals[1][0]["there"] is False and [s.step.event for s in steps] == [None, "Look", None]
