"""Properties as Python: their values, the values that made them false, and properties that cannot be evaluated."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.runtime.program.property import UNKNOWN, BoundName, Known, Outcome, Properties, Read, Trail, judged
from koordgen.runtime.values.points import Point
from tests.build.emit.generated import _module, checked

TEXT = """\
def Task:
  Point at
  int id
param float eps = 0.5
param List<int> few = [1, 2]
spec fun calm(Point p) -> bool
using Motion:
  sensors: Point position
  actuators: Point target
  PathPlanner planner
  assume position' in Rect(position, target)
  assume planner(goal) == [] or last(planner(goal)) == goal
using Heater:
  sensors: Point position
allread: Point x[N_SYS]
allwrite: List<Task> tasks
local: bool on
E:
  pre: True
  eff: pass
axiom Nothing: calm(Point(0, 0, 0))
initially: forall i in ID: distance(Motion.position[i], x[i]) < eps
invariant Apart:
  forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > eps
invariant Some: exists i in ID: on[i]
invariant Listed: forall t in tasks: exists k in few: t.id == k
invariant Beyond: on[N_SYS + len(tasks)]
invariant Calm: forall i in ID: calm(x[i])
"""


@pytest.fixture(scope="module")
def found() -> Properties:
    program = checked(TEXT)
    sys.modules["program"] = _module("program", program_text(program))
    module: Any = _module("properties", properties_text(program, {"Heater"}))
    properties: Properties = module.PROPERTIES
    return properties


def ask(found: Properties, name: str, trail: Trail | None = None, **values: Any) -> tuple[Outcome, str]:
    known = found.fleet(3, trail)
    places = [Point(), Point(1.0), Point(2.0)]
    known.put({"Motion.position": places, "x": places, "tasks": (), "on": [False, True, False]})
    known.put({name.replace("__", "."): value for name, value in values.items()})
    return judged(next(p for p in found.properties if p.name == name).holds, known)


def test_properties_know_their_lines_and_what_they_read(found: Properties) -> None:
    lines = {(p.kind, p.name): (TEXT.splitlines()[p.line - 1].split()[0], p.reads) for p in found.properties}
    assert lines["invariant", "Apart"] == ("invariant", ("Motion.position",))
    assert lines["initially", ""] == ("initially:", ("Motion.position", "x"))
    assert [a.reads for a in found.assumptions] == [("Motion.position'", "Motion.position", "Motion.target"), ()]
    assert found.measured == ("Motion.position",), "what a driver serves is the driver's to say"


def test_what_no_one_can_evaluate_is_listed(found: Properties) -> None:
    assert [(u.kind, u.name, u.why) for u in found.unchecked] == [
        ("axiom", "Nothing", "an axiom is assumed"),
        ("invariant", "Calm", "calm (line 6) is a spec fun, which only axioms describe"),
    ]


def test_a_false_property_tells_of_whom_and_by_what(found: Properties) -> None:
    trail: Trail = []
    near = [Point(), Point(1.0), Point(1.25)]
    assert ask(found, "Apart", trail, Motion__position=near) == ("violated", "")
    assert trail == [
        BoundName("i", 1, True), BoundName("j", 2, True),
        Read("Motion.position", 1, near[1]), Read("Motion.position", 2, near[2]),
    ]  # fmt: skip
    trail.clear()
    Task = sys.modules["program"].Task
    assert ask(found, "Listed", trail, tasks=(Task(Point(), 1), Task(Point(), 7)))[0] == "violated"
    assert [b for b in trail if isinstance(b, BoundName)] == [BoundName("t", Task(Point(), 7), False)]
    trail.clear()
    assert ask(found, "Apart", trail) == ("held", "") and not trail


def test_what_is_not_known_leaves_open_only_what_needs_it(found: Properties) -> None:
    gone = [Point(), UNKNOWN, Point(0.25)]
    assert ask(found, "Apart", Motion__position=gone)[0] == "violated", "robots 0 and 2 are known to be too near"
    gone = [Point(), UNKNOWN, Point(2.0)]
    assert ask(found, "Apart", Motion__position=gone) == ("unknown", "Motion.position[1]")
    assert ask(found, "Some", on=[UNKNOWN, True, False]) == ("held", "")
    assert ask(found, "Some", on=[UNKNOWN, False, False])[0] == "unknown"
    assert ask(found, "Listed", tasks=UNKNOWN)[0] == "unknown"


def test_a_property_may_have_no_value(found: Properties) -> None:
    assert ask(found, "Beyond") == ("no value", "index 3 names no robot (0 to 2)")


def test_assumptions_are_of_one_robots_ports_at_two_moments(found: Properties) -> None:
    within, ends = found.assumptions

    def step(x: float, *answers: Point) -> Known:
        known = found.step(3, None)
        known.put({"Motion.position": Point(), "Motion.target": Point(2.0), "Motion.position'": Point(x)})
        known.asked = tuple(("Motion.planner", (goal,), (Point(), Point(1.0))) for goal in answers)
        return known

    assert within.holds_of_calls(step(1.0)) and not within.holds_of_calls(step(2.5))
    assert ends.holds_of_calls(step(0.0)) and ends.holds_of_calls(step(0.0, Point(1.0)))
    assert not ends.holds_of_calls(step(0.0, Point(1.0), Point(3.0)))
