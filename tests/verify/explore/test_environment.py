"""Environment files, and the states that follow from them."""

from __future__ import annotations

import math

import pytest

from koordgen.lang.ir.decl import Program
from koordgen.runtime.values.points import Point
from koordgen.verify.explore.environment import STRAIGHT, Environment, MissingEnvironment
from koordgen.verify.explore.lidar import lidar
from tests.lang.semantics.programs import compiled
from tests.verify.explore.reference import explored
from tests.verify.explore.test_search import MOTION, read

ROOM = """
param float wanted = 20.0
using HVAC:
  sensors:
    float temp
    int people
  actuators: bool heat
local: bool told
Look:
  pre: not told
  eff: told = HVAC.temp > wanted
initially: forall i in ID: HVAC.temp[i] < 20.5
invariant Cold: forall i in ID: HVAC.temp[i] < 21.5
"""
TEMP = "HVAC.temp: {lo: 20, hi: 22, step: 0.5, change: 0.5}\n"
PEOPLE = "HVAC.people: {lo: 0, hi: 2}\n"
PLAN = """
using Motion:
  sensors: Point position
  actuators: List<Point> path
  PathPlanner planner
  assume planner(goal) == [] or last(planner(goal)) == goal
local:
  List<Point> way
  bool twice
Go:
  pre: len(way) == 0
  eff:
    way = Motion.planner(Point(2, 0, 0))
    twice = way == Motion.planner(Point(2, 0, 0))
invariant Agree: forall i in ID: twice[i] or len(way[i]) == 0
"""


def around(program: Program, text: str) -> Environment:
    found, mistakes = read(program, text)
    assert found is not None and not mistakes, mistakes
    return found


def test_intervals() -> None:
    found = around(compiled(ROOM), TEMP + PEOPLE)
    values, near, starts, _ = found.domains["HVAC.temp"]
    assert values == (20.0, 20.5, 21.0, 21.5, 22.0) and starts is None and near is not None
    assert near(20.0, 20.5) and near(21.0, 20.5) and not near(20.0, 21.0)
    assert found.domains["HVAC.people"].values == (0, 1, 2) and found.domains["HVAC.people"].near is None


def test_a_change_is_bounded_in_each_round() -> None:
    program = compiled(ROOM)
    found = explored(program, 1, around(program, TEMP + PEOPLE), deadlock=False)[1].violation
    assert found is not None and found.name == "Cold" and found.run_states[-1].round == 3  # 20, 20.5, 21, 21.5
    found = explored(program, 1, around(program, TEMP.replace("change: 0.5", "change: 2") + PEOPLE), deadlock=False)[
        1
    ].violation
    assert found is not None and found.run_states[-1].round == 1


def test_where_it_begins_and_values_of_one_robot() -> None:
    program = compiled(ROOM)
    text = (
        "HVAC.temp: {values: [20, 21], start: [20]}\n"
        + PEOPLE
        + "robots: {1: {HVAC.temp: {start: [21]}, HVAC.people: [7]}}\n"
    )
    found = around(program, text)
    assert found.of(0).domains["HVAC.temp"].starts == (20.0,) and found.of(0).domains["HVAC.people"].values == (0, 1, 2)
    assert found.of(1).domains["HVAC.temp"][0::2] == ((20.0, 21.0), (21.0,))
    assert found.of(1).domains["HVAC.people"].values == (7,)
    made, result = explored(program, 2, found)
    assert "robot 1" in made.apart and "initially" in result.stopped  # robot 1 begins too warm
    made, _ = explored(program, 2, found._replace(robots={}), deadlock=False)
    assert not made.apart


def test_robots_that_are_not_in_the_fleet_may_have_values() -> None:
    assert not around(compiled(ROOM), TEMP + PEOPLE + "robots: {9: {HVAC.people: [7]}}\n").robots


def test_params() -> None:
    assert around(compiled(ROOM), TEMP + PEOPLE + "params: {wanted: 21.5}\n").params == {"wanted": 21.5}


@pytest.mark.parametrize("planner, states", [
    ("straight", [0, 1]),
    ("none", [0]),
    ("either", [0, 1]),
    ("[straight, [[0, 0, 0], [1, 1, 0], [2, 0, 0]], none]", [0, 1, 2]),
    ("[straight, [[0, 0, 0], [5, 5, 0]]]", [0, 1]),  # one is not as assumed
])  # fmt: skip
def test_a_planner_answers_as_it_may_and_alike_within_an_event(planner: str, states: list[int]) -> None:
    program = compiled(PLAN)
    found = around(program, f"Motion.position: [[0, 0, 0]]\nMotion.planner: {planner}\n")
    made, result = explored(program, 1, found, deadlock=False)
    assert result.violation is None and not result.stopped
    ways = {made.machine.state(fleet).robots[0].locals["way"] for fleet in made.known}
    assert len(ways) == len(states) and () in ways


def test_a_planner_whose_answers_all_break_an_assumption() -> None:
    program = compiled(PLAN)
    found = around(program, "Motion.position: [[0, 0, 0]]\nMotion.planner: [[[5, 5, 0]]]\n")
    with pytest.raises(MissingEnvironment, match=r"Motion\.planner.*allow none of its answers"):
        explored(program, 1, found)


def test_init_may_ask_a_planner() -> None:
    program = compiled(MOTION + "init:\n  sent = len(Motion.planner(Motion.position)) > 0\n")
    found = around(program, "Motion.position: [[0, 0, 0]]\nMotion.planner: either\n")
    assert found.answers == {"Motion.planner": (STRAIGHT, ())}
    made, _ = explored(program, 2, found, rounds=0, symmetry=False, deadlock=False)
    sent = {tuple(r.locals["sent"] for r in made.machine.state(fleet).robots) for fleet in made.known}
    assert sent == {(a, b) for a in (False, True) for b in (False, True)}


def test_a_run_that_begins_with_an_answer_is_shown() -> None:
    program = compiled(
        MOTION
        + "init:\n  sent = len(Motion.planner(Motion.position)) > 0\ninvariant Never: forall i in ID: not sent[i]\n"
    )
    found = explored(program, 2, around(program, "Motion.position: [[0, 0, 0]]\nMotion.planner: either\n"))[1].violation
    assert found is not None and found.name == "Never" and found.run_states[-1].event == "init"
    assert any(robot.locals["sent"] for robot in found.run_states[-1].state.robots)


def test_a_lidar_sees_walls() -> None:
    look = lidar(4, 3.0, ((Point(1, -1, 0), Point(2, 1, 1)), (Point(-1, 0.5, 0), Point(1, 4, 1))))
    ((place, scan),) = look(Point(0, 0, 0))
    assert place == Point(0, 0, 0) and scan.max_range == 3.0
    assert scan.angles == tuple([k * math.pi / 2 for k in range(4)])
    assert [round(r, 9) for r in scan.ranges] == [1.0, 0.5, 3.0, 3.0]
    ((_, far),) = look(Point(0, 8, 0))
    assert [round(r, 9) for r in far.ranges] == [3.0, 3.0, 3.0, 3.0]


SCANS = """
using M:
  sensors:
    Point position
    List<Point, Scan> pscan
local: float r
Look:
  pre: len(M.pscan) > 0
  eff:
    for p, s in M.pscan:
      if len(s.ranges) > 0: r = s.ranges[0]
"""


def test_what_a_lidar_sees_follows_from_where_it_is() -> None:
    program = compiled(SCANS)
    wall = "{lo: [2, 0, 0], hi: [3, 1, 1]}"
    text = f"M.position: [[0, 0.5, 0], [1, 0.5, 0]]\nM.pscan: {{lidar: {{rays: 4, range: 5, walls: [{wall}]}}}}\n"
    made, result = explored(program, 1, around(program, text), forgetting=False)
    assert result.violation is None
    assert {made.machine.state(f).robots[0].locals["r"] for f in made.known} == {0.0, 1.0, 2.0}


@pytest.mark.parametrize("text, code, line", [
    ("HVAC.temp: {lo: 20, hi: 22}", "F003", 1),
    ("HVAC.temp: {lo: 20, hi: 22, step: 0}", "F005", 1),
    ("HVAC.temp: {lo: 23, hi: 22, step: 1}", "F005", 1),
    ("HVAC.temp: {lo: 0, hi: 1, step: 0.000001}", "F005", 1),
    ("HVAC.temp: {lo: 20, hi: 22, step: 1, change: -1}", "F005", 1),
    ("HVAC.temp: {lo: 20, hi: 22, step: 1, chnge: 1}", "F002", 1),
    ("HVAC.temp: {lo: cold, hi: 22, step: 1}", "F004", 1),
    ("HVAC.people: {lo: 0.5, hi: 2}", "F004", 1),
    ("HVAC.people: [0, 1.5]", "F004", 1),
    ("HVAC.people: [99999999999999999999]", "F004", 1),
    ("HVAC.temp: [true]", "F004", 1),
    ("HVAC.temp: {grid: {lo: [0, 0, 0], hi: [1, 1, 1], step: 1}}", "F004", 1),
    ("HVAC.temp: {lidar: {rays: 4, range: 1}}", "F004", 1),
    ("HVAC.temp: {values: [20, 21], start: [22]}", "F005", 1),
    ("HVAC.temp: {values: [], start: [22]}", "F005", 1),
    ("params: {wanted: warm}", "F004", 1),
    ("params: {wnted: 1}", "F002", 1),
    ("\nrobots: {bert: {HVAC.people: [1]}}", "F002", 2),
    ("robots: {0: {HVAC.peple: [1]}}", "F002", 1),
    ("robots: [0]", "F004", 1),
    ("HVAC.temp: [20]\nHVAC.temp: [21]", "F006", 2),
    ("Motion.position: [[0, 0, 0]]", "F002", 1),  # another program's
])  # fmt: skip
def test_mistakes_are_told_at_their_place(text: str, code: str, line: int) -> None:
    found, mistakes = read(compiled(ROOM), text)
    assert found is None and [(m[0], m[2].line) for m in mistakes] == [(code, line)]


@pytest.mark.parametrize("planner", ["[curved]", "[]", "3", "{a: 1}", "[[[0, 0]]]"])
def test_mistakes_in_answers_are_told(planner: str) -> None:
    found, mistakes = read(compiled(PLAN), f"Motion.position: [[0, 0, 0]]\nMotion.planner: {planner}\n")
    assert found is None and [m[2].line for m in mistakes] == [2]


def test_a_wrong_key_says_what_there_is() -> None:
    _, mistakes = read(compiled(ROOM), "Motion.position: [[0, 0, 0]]")
    assert "HVAC.people, HVAC.temp, params, robots" in mistakes[0][3]


def test_values_are_what_their_decimals_say() -> None:
    found = around(compiled(ROOM), "HVAC.temp: {lo: 18, hi: 18.4, step: 0.1, start: [18.1, 18.3]}\n" + PEOPLE)
    assert found.domains["HVAC.temp"].values == (18.0, 18.1, 18.2, 18.3, 18.4)
    found = around(
        compiled(PLAN), "Motion.position: {grid: {lo: [0, 0, 0], hi: [0.3, 0, 0], step: 0.1}}\nMotion.planner: none\n"
    )
    assert found.domains["Motion.position"].values == tuple([Point(x, 0.0, 0.0) for x in (0.0, 0.1, 0.2, 0.3)])


COMMANDED = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target
local: int n
Back:
  pre: n == 0
  eff:
    n = 1
    Motion.target = Motion.position
Wait:
  pre: n == 1 and Motion.reached
  eff: n = 2
"""


def test_reached_stays_true_until_something_is_commanded() -> None:
    program = compiled(COMMANDED + "invariant Here: forall i in ID: Motion.reached[i] or n[i] > 0\n")
    found = around(program, "Motion.position: [[0, 0, 0]]\n")
    for forgetting in (True, False):
        made, result = explored(program, 2, found, forgetting=forgetting, symmetry=False, deadlock=False)
        assert result.violation is None and not result.stopped
        robots = {(r.locals["n"], r.ports["Motion.reached"]) for f in made.known for r in made.machine.state(f).robots}
        # Where it was commanded, to the very place where it began, it may say anything.
        assert robots == {(0, True), (1, False), (1, True), (2, False), (2, True)}


def test_what_was_commanded_in_an_earlier_round_is_known_where_a_run_is_shown() -> None:
    program = compiled(COMMANDED + "invariant No: forall i in ID: n[i] < 2 or Motion.reached[i]\n")
    found = explored(program, 2, around(program, "Motion.position: [[0, 0, 0]]\n"), deadlock=False)[1].violation
    assert (
        found is not None
        and found.name == "No"
        and not all(r.ports["Motion.reached"] for r in found.run_states[-1].state.robots)
    )
    assert [m.round for m in found.run_states if m.event == "Wait"] == [2]
