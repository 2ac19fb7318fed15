"""Modules served by the user's drivers: what they sense and take, and what happens when they fail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from benchmarks.fixtures.lineform import PROGRAM, State
from koordgen.runtime.program.program import Cell, Event, Frame, Port, Program
from koordgen.runtime.values.bounds import Fixed
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.drivers import Driven, with_drivers
from koordgen.runtime.vehicle.platform import Finding, Unready


class Heating(State):
    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.temp: float = frame.sensors["HVAC.temp"]
        self.spots: tuple[Point, ...] = frame.sensors["HVAC.spots"]
        self.heat: Cell[bool] = self.actuator("HVAC.heat")


def heat(s: Heating) -> None:
    s.heat.value = s.temp < 20
    s.target.value = s.spots[0]


HEATING: Program = replace(
    PROGRAM,
    begin=Heating,
    init=None,
    ports=(
        *PROGRAM.ports,
        Port("HVAC.temp", "sensor", float),
        Port("HVAC.spots", "sensor", tuple[Point, ...]),
        Port("HVAC.heat", "actuator", bool, Fixed(1), lambda: False),
        Port("HVAC.ask", "callable", tuple[Point, ...]),
    ),
    events=(Event("Heat", 3, lambda s: True, heat),),
)


class Hvac:
    def __init__(self) -> None:
        self.sensed: Any = {"temp": 15, "spots": [[1, 2, 0]], "more": 3}
        self.taken: list[Mapping[str, Any]] = []
        self.raises: BaseException | None = None
        self.closed = False

    def sense(self) -> Any:
        if self.raises is not None:
            raise self.raises
        return self.sensed

    def command(self, actuators: Mapping[str, Any]) -> None:
        self.taken.append(actuators)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        return [*args, port]

    def close(self) -> None:
        self.closed = True
        raise ValueError("at the end")


def fleet_with(driver: Hvac) -> tuple[Fleet, FakePlatform]:
    body = FakePlatform(Point(0, 0, 0))
    fleet = Fleet(n=1, program=HEATING)
    fleet.boot(0, with_drivers(body, HEATING, {"HVAC": lambda: driver}))  # type: ignore[arg-type]
    return fleet, body


def test_what_a_driver_senses_goes_to_the_program_and_its_commands_come_back() -> None:
    driver = Hvac()
    fleet, body = fleet_with(driver)
    fleet.run_rounds(3)
    sensors = fleet.robots[0].records[0].sensors
    assert repr(sensors["HVAC.temp"]) == "15.0" and sensors["HVAC.spots"] == (Point(1, 2, 0),)
    assert driver.taken[0] == {"heat": True}
    assert body.commands[0][1] == {"Motion.target": Point(1, 2, 0)}


@pytest.mark.parametrize(
    "failure",
    [
        {"raises": OSError("no bus")},
        {"raises": SystemExit()},
        {"sensed": {"temp": float("nan"), "spots": []}},
        {"sensed": {"temp": "15", "spots": []}},
        {"sensed": {"temp": 15}},
        {"sensed": None},
    ],
)
def test_a_driver_that_does_not_sense_makes_its_robot_skip_until_it_does(failure: dict[str, Any]) -> None:
    driver = Hvac()
    fleet, _ = fleet_with(driver)
    fleet.run_rounds(3)
    before = vars(driver).copy()
    vars(driver).update(failure)
    fleet.run(0.5)
    robot = fleet.robots[0]
    last = robot.records[-1]
    assert last.effects is None
    assert (last.skipped or "").startswith("no sensor value: HVAC.")
    vars(driver).update({key: before[key] for key in failure})
    fleet.run(0.5)
    last = robot.records[-1]
    assert last.effects is not None
    assert robot.agent.phase == "running"


def test_a_mission_waits_for_its_drivers() -> None:
    driver = Hvac()
    driver.raises = OSError("no bus")
    fleet, _ = fleet_with(driver)
    fleet.run(2)
    robot = fleet.robots[0]
    assert robot.agent.phase == "starting"
    assert any("the driver of HVAC does not sense: OSError: no bus" in line for line in robot.lines)
    driver.raises = None
    fleet.run_rounds(2)


def test_a_driver_that_takes_no_command_brings_the_robot_to_rest() -> None:
    class Broken(Hvac):
        def command(self, actuators: Mapping[str, Any]) -> None:
            raise OSError("no relay")

    fleet, body = fleet_with(Broken())
    fleet.run(5, until=lambda: fleet.robots[0].agent.done)
    assert body.stopping is not None
    assert any("the driver of HVAC refused a command: OSError: no relay" in line for line in fleet.robots[0].lines)


def test_the_rest_of_a_platform() -> None:
    body, driver = FakePlatform(Point(0, 0, 0)), Hvac()
    driven = Driven(body, HEATING, {"HVAC": lambda: driver})
    assert driven.diagnose() == [Finding("fake", "ok", "a fake body"), Finding("drivers", "ok", "HVAC by Hvac")]
    assert driven.call("HVAC.ask", (1, 2)) == [1, 2, "ask"]
    assert driven.call("Motion.planner", (Point(),)) == (Point(),)
    driver.raises = OSError("no bus")
    found = driven.diagnose()[-1]
    assert found.state == "fail" and "OSError: no bus" in found.found
    driven.close()
    assert body.closed and driver.closed


def test_what_an_earlier_life_commanded_is_resumed_by_a_platform_that_can() -> None:
    class Amid(FakePlatform):
        def resume(self, actuators: Mapping[str, Any], now: float) -> None:
            self.resumed = dict(actuators)

    body, driver = Amid(Point(0, 0, 0)), Hvac()
    driven = Driven(body, HEATING, {"HVAC": lambda: driver})
    driven.resume({"Motion.target": Point(1), "HVAC.heat": True}, 1.0)
    assert body.resumed == {"Motion.target": Point(1)} and body.commands == []
    assert driver.taken == [{"heat": True}]
    plain = FakePlatform(Point(0, 0, 0))
    Driven(plain, HEATING, {"HVAC": lambda: driver}).resume({"Motion.target": Point(1)}, 1.0)
    assert plain.commands == [(1.0, {"Motion.target": Point(1)})]


def test_a_driver_that_cannot_be_made() -> None:
    def make() -> Hvac:
        raise OSError("no bus")

    body = FakePlatform(Point(0, 0, 0))
    with pytest.raises(Unready, match="the driver of HVAC cannot be created: OSError: no bus"):
        with_drivers(body, HEATING, {"HVAC": make})
    assert body.closed
    assert with_drivers(body, HEATING, {}) is body
