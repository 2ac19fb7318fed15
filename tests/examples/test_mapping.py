"""Calls of Mapping to its Python functions and its planner, event by event, for one robot.

Each call must be about the robot's own strip, from its position, around what the fleet's map shows. test_missions.py
tests that the fleet completes the map.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.semantics.exec import Writes
from koordgen.lang.semantics.state import State, World
from koordgen.lang.semantics.step import enabled, execute, initial
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.gridmap import GridMap, area, mark_free, mark_occupied, merge
from koordgen.runtime.values.points import Grid, Point
from tests.examples.stage import EXAMPLES

N_SYS, PID = 3, 1
HERE, GOAL = Point(-1.0, 0.5, 0.0), Point(2.25, 1.25, 0.0)
BLANK = area(Point(-4, -4, 0), Point(4, 4, 0), 0.5)
FLEETS = mark_occupied(BLANK, Grid(3, 2, 0.5))  # what all know
OWN = mark_free(BLANK, Grid(-2, 1, 0.5))  # what this robot alone has seen
OBSTACLES = (Grid(3, 2, 0.5), Grid(4, 2, 0.5))
WAY = (HERE, Point(0.0, 3.0, 0.0), GOAL)


@cache
def program() -> Program:
    return check_file(str(EXAMPLES / "mapping/mapping.koord")).program


class Asked:
    """World with given answers that records the calls, as (port or function, arguments)."""

    def __init__(self, way: tuple[Point, ...] = WAY, explored: frozenset[int] = frozenset()) -> None:
        self.questions: list[tuple[object, ...]] = []
        self.way, self.explored = way, explored
        answers = {"pickFrontierPos": GOAL, "findObs": OBSTACLES}
        externs: dict[str, Any] = {name: self.remembered(name, answer) for name, answer in answers.items()}
        self.world = World({**externs, "explored": self.is_explored}, self.plan)

    def remembered(self, name: str, answer: object) -> Any:
        def called(*args: object) -> object:
            self.questions.append((name, *args))
            return answer

        return called

    def is_explored(self, known: GridMap, part: int, parts: int, refused: object) -> bool:
        self.questions.append(("explored", known, part, parts, refused))
        return part in self.explored

    def plan(self, pid: int, port: str, args: tuple[object, ...]) -> tuple[Point, ...]:
        self.questions.append((pid, port, *args))
        return self.way


def state(on_path: bool, reached: bool = True) -> State:
    sensors: list[dict[str, Value]] = [
        {"MotionWithScan.position": Point(9.0, 9.0, 9.0), "MotionWithScan.reached": reached}
    ] * N_SYS
    sensors[PID] = {**sensors[PID], "MotionWithScan.position": HERE}
    start = initial(program(), N_SYS, sensors)
    robots = [r._replace(locals={**r.locals, "onPath": on_path, "localMap": OWN, "looked": True}) for r in start.robots]
    return start._replace(robots=tuple(robots), store=start.store._replace(cells={"map": FLEETS}))


def run(event: str, asked: Asked, on_path: bool) -> Writes:
    (found,) = [e for e in program().events if e.name == event]
    outcome = execute(program(), found.effect, state(on_path), PID, asked.world)
    assert isinstance(outcome, Writes), outcome
    return outcome


def holds(event: str, asked: Asked, on_path: bool, reached: bool = True) -> bool:
    (found,) = [e for e in program().events if e.name == event]
    return enabled(program(), found, state(on_path, reached), PID, asked.world)


def test_a_new_target_is_of_the_own_strip_and_the_way_leads_around_what_all_know() -> None:
    asked = Asked()
    outcome = run("NewTarget", asked, on_path=False)
    assert asked.questions == [
        ("pickFrontierPos", FLEETS, HERE, PID, N_SYS, ()),
        ("findObs", FLEETS),
        (PID, "MotionWithScan.planner", GOAL, OBSTACLES),
    ]
    assert outcome.ports == {"MotionWithScan.path": WAY}
    assert outcome.locals == {
        "localMap": FLEETS, "target": GOAL, "onPath": True, "obstacles": OBSTACLES, "looked": True,
    }  # fmt: skip
    assert not outcome.cells and not outcome.stopped


def test_without_a_way_it_is_not_on_one() -> None:
    outcome = run("NewTarget", Asked(way=()), on_path=False)
    assert outcome.ports == {"MotionWithScan.path": ()} and outcome.locals["onPath"] is False
    assert outcome.slots == {"refused": (GOAL,)}, "and it does not make for it again"


@pytest.mark.parametrize(("explored", "wanted"), [({0, 2}, True), ({1}, False)])
def test_a_new_target_is_wanted_while_the_own_strip_is_not_explored(explored: set[int], wanted: bool) -> None:
    asked = Asked(explored=frozenset(explored))
    assert holds("NewTarget", asked, on_path=False) is wanted
    assert asked.questions == [("explored", FLEETS, PID, N_SYS, ())]
    assert not holds("NewTarget", asked, on_path=True)


@pytest.mark.parametrize(("explored", "wanted"), [({0, 1, 2}, True), ({0, 1}, False), ({1, 2}, False), ({0, 2}, False)])
def test_it_is_done_when_every_strip_is_explored(explored: set[int], wanted: bool) -> None:
    asked = Asked(explored=frozenset(explored))
    assert holds("Done", asked, on_path=False) is wanted
    assert all(known == FLEETS and parts == N_SYS for _, known, _, parts, _ in asked.questions)
    assert not holds("Done", asked, on_path=True)


def test_what_was_seen_is_handed_in_on_arrival() -> None:
    assert holds("GUpdate", Asked(), on_path=True) and not holds("GUpdate", Asked(), on_path=True, reached=False)
    assert not holds("GUpdate", Asked(), on_path=False)
    outcome = run("GUpdate", Asked(), on_path=True)
    assert outcome.cells == {"map": merge(FLEETS, OWN)} and outcome.locals["onPath"] is False
