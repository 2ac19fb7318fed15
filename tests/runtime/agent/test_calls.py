"""Callable ports: answers are inputs of the event, recorded, with a budget; actuators of every type."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.program.program import Cell, Event, Frame, Port, Program, Slots
from koordgen.runtime.values.bounds import Fixed, Many
from koordgen.runtime.values.points import Point

Answer = Callable[[tuple[Any, ...]], Any]


class Planning(State):
    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.path: Cell[tuple[Point, ...]] = self.actuator("Motion.path")
        self.level: Cell[float] = self.actuator("Valve.level")


def plan(s: Planning) -> None:
    s.path.value = s.call("Motion.planner", (Point(1, 2, 0),))
    s.level.value = s.level.value + 0.5


PLANNER: Program = replace(
    PROGRAM,
    begin=Planning,
    ports=(
        *PROGRAM.ports,
        Port("Motion.path", "actuator", tuple[Point, ...], Many(8, Fixed(28)), lambda: ()),
        Port("Valve.level", "actuator", float, Fixed(9), lambda: 0.0),
        Port("Motion.planner", "callable", tuple[Point, ...]),
    ),
    events=(Event("Plan", 3, lambda s: True, plan),),
)


class Planner(FakePlatform):
    def __init__(self, answer: Answer) -> None:
        super().__init__(Point(0, 0, 0))
        self.answer = answer

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        assert port == "Motion.planner"
        return self.answer(args)


def fleet_with(answer: Answer) -> Fleet:
    fleet = Fleet(n=1, program=PLANNER)
    fleet.boot(0, Planner(answer))
    fleet.run_rounds(3)
    return fleet


def test_an_answer_is_an_input_of_the_event_and_is_recorded() -> None:
    robot = fleet_with(lambda args: [Point(0, 0, 0), *args]).robots[0]
    way = (Point(0, 0, 0), Point(1, 2, 0))
    assert [r.calls for r in robot.records[:3]] == [(("Motion.planner", (Point(1, 2, 0),), way),)] * 3
    assert robot.trace("round")[0]["calls"] == [["Motion.planner", [[1, 2, 0]], [[0, 0, 0], [1, 2, 0]]]]
    assert [c["Valve.level"] for _, c in robot.platform.commands[:3]] == [0.5, 1.0, 1.5]
    first = robot.records[0].frame
    assert first is not None and (first.actuators["Motion.path"], first.actuators["Valve.level"]) == ((), 0.0)
    assert "slow calls" not in robot.agent.counters()


def breaks(args: tuple[Any, ...]) -> Any:
    raise RuntimeError("no map")


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (breaks, "RuntimeError: no map"),
        (lambda args: 3, "ValidationError: Expected `array`, got `int`"),
        (lambda args: [Point(float("inf"), 0, 0)], "ValueError: Motion.planner returned a value that is not finite"),
        (lambda args: [Point()] * 9, "Motion.path would become a list of 9 elements, beyond its `max 8`"),
    ],
)
def test_a_planner_that_fails_discards_the_event(answer: Answer, reason: str) -> None:
    robot = fleet_with(answer).robots[0]
    assert robot.records[0].fault is not None and robot.records[0].fault.reason == reason
    assert robot.held() and not robot.platform.commands


def test_a_slow_planner_is_counted_and_told_once() -> None:
    fleet = Fleet(n=1, program=PLANNER)

    def slow(args: tuple[Any, ...]) -> Any:
        fleet.time.time += 0.012
        return args

    fleet.boot(0, Planner(slow))
    fleet.run_rounds(4)
    robot = fleet.robots[0]
    assert robot.records[0].effects is not None
    assert robot.agent.counters()["slow calls"] >= 3
    assert len([line for line in robot.lines if "beyond its budget of 10 ms" in line]) == 1


def test_slots_are_copies() -> None:
    slots = Slots([1, 2, 3], 1)
    before = slots.all
    slots.own = 9
    assert (before, slots.all, slots[1]) == ((1, 2, 3), (1, 9, 3), 9)
