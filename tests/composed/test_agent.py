"""A robot with several applications: each fails, stops and runs out of time alone; traces and counts name them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.fixtures.fleet import FakePlatform, Fleet
from koordgen.lang.semantics.composition import Application, System
from koordgen.runtime.agent.machine import VIOLATED
from koordgen.runtime.program.fleet_program import FleetApplication, FleetProgram
from koordgen.runtime.program.runner import LATE
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Sensed
from tests.composed.agents import fleet_program, properties_of
from tests.lang.semantics.compositions import compiled

MOTION = "using Motion:\n  sensors:\n    Point position\n    bool reached\n"
DRIVES = MOTION + "  actuators: Point target at position clears reached\n"
ARM = "using Arm:\n  sensors: int load\n  actuators: int grip\n"
COUNTS = "local: int k\nallwrite: int {name}\nGo:\n  pre: True\n  eff:\n    k += 1\n    {name} = k\n    {more}\n"


class Body(FakePlatform):
    """Vehicle with an arm."""

    def sense(self, now: float) -> Sensed:
        sensed = super().sense(now)
        return Sensed({**sensed.values, "Arm.load": 3}, sensed.time)


def counts(name: str, more: str = "pass", head: str = "") -> str:
    return head + COUNTS.format(name=name, more=more)


def system(*texts: str, robots: int = 2) -> System:
    programs = [compiled(name, text) for name, text in zip(("first", "second", "third"), texts, strict=False)]
    return System(tuple([Application(p.name, p, tuple(range(robots))) for p in programs]), robots)


def flown(program: FleetProgram, rounds: int, **more: Any) -> Fleet:
    fleet = Fleet(n=program.robots, program=program)
    for robot in range(program.robots):
        fleet.boot(robot, Body(Point()), **more)
    fleet.run(60, until=lambda: all(r.agent.done or r.agent.round >= rounds for r in fleet.robots.values()))
    return fleet


def values(fleet: Fleet, name: str) -> list[int]:
    """Return the values of a local variable in the instances of robot 0."""
    return [instance.runner.locals[name] for instance in fleet.robots[0].agent._instances]


def test_a_discarded_event_holds_its_application_alone() -> None:
    fleet = flown(fleet_program(system(counts("a", "k = 1 // (k - 1)"), counts("b", head=DRIVES))), 8)
    robot = fleet.robots[0]
    assert values(fleet, "k")[0] == 0 and values(fleet, "k")[1] >= 6 and not robot.platform.held
    assert len([line for line in robot.lines if "the event is discarded, application first holds" in line]) == 1
    assert robot.agent.counters()["first: faults"] == robot.agent.counters()["faults"] >= 6
    assert "second: faults" not in robot.agent.counters()


def test_the_status_names_each_application_with_its_last_event_and_faults() -> None:
    stops = "first", "k = 1 // (k - 1)", ""
    fleet = flown(fleet_program(system(counts(*stops), counts("b", "if k > 2:\n      stop", DRIVES))), 8)
    first, second = fleet.robots[0].agent.snapshot(0.0)["applications"]
    assert first["name"] == "first" and not first["stopped"] and first["round"] >= 6 and not first["event"]
    assert "ZeroDivisionError" in first["fault"] and first["counts"]["faults"] >= 6
    assert second["stopped"] and (second["event"], second["event_round"]) == ("Go", 3) and second["fault"] == ""
    assert (second["pid"], second["members"]) == (0, (0, 1)) and second["counts"].get("faults", 0) == 0


def test_the_status_of_a_robot_with_one_application_does_not_name_it() -> None:
    fleet = flown(fleet_program(system(counts("a", head=DRIVES))), 3)
    assert "applications" not in fleet.robots[0].agent.snapshot(0.0)


def test_the_vehicle_holds_if_the_application_that_commands_it_fails() -> None:
    fleet = flown(fleet_program(system(counts("a"), counts("b", "k = 1 // (k - 1)", DRIVES))), 8)
    assert fleet.robots[0].platform.held and values(fleet, "k")[0] >= 6


@pytest.mark.parametrize(("stopping", "holds"), [("first", False), ("second", True)])
def test_the_vehicle_holds_when_its_owner_has_stopped(stopping: str, holds: bool) -> None:
    texts = [counts("a", "stop" if stopping == "first" else "pass"), counts("b", "stop" if holds else "pass", DRIVES)]
    fleet = flown(fleet_program(system(*texts)), 9)
    robot = fleet.robots[0]
    stopped, goes_on = (1, 0) if holds else (0, 1)
    assert values(fleet, "k")[stopped] == 1 and values(fleet, "k")[goes_on] >= 7
    assert robot.platform.held is holds and robot.agent.phase == "running"


def test_the_agents_end_when_all_instances_have_stopped() -> None:
    ends = "Go:\n  pre: True\n  eff: stop\n"
    slow = "local: int k\nGo:\n  pre: k < 5\n  eff: k += 1\nEnd:\n  pre: True\n  eff: stop\n"
    fleet = flown(fleet_program(system(ends, slow)), 100)
    assert all(robot.agent.done and not robot.agent.status for robot in fleet.robots.values())
    assert all(27 <= robot.agent.round <= 31 for robot in fleet.robots.values()), "6 rounds and LINGER"


def test_an_application_without_a_sensor_value_skips_alone() -> None:
    class Blind(Body):
        def sense(self, now: float) -> Sensed:
            sensed = super().sense(now)
            return Sensed({**sensed.values, "Arm.load": None}, sensed.time)

    program = fleet_program(system(counts("a", "k += Arm.load", ARM), counts("b", head=DRIVES)))
    fleet = Fleet(n=2, program=program)
    for robot in range(2):
        fleet.boot(robot, Blind(Point()))
    fleet.run_rounds(8)
    assert values(fleet, "k")[0] == 0 and values(fleet, "k")[1] >= 6
    skipped = {r.skipped for r in fleet.robots[0].records if r.application == "first"}
    assert skipped == {"no sensor value: Arm.load has no value"}


def test_traces_records_and_status_name_the_application() -> None:
    out = "using Log:\n  stream stdout\n"
    fleet = flown(fleet_program(system(counts("a", 'Log.stdout << "x"', out), counts("b", head=DRIVES))), 6)
    robot = fleet.robots[0]
    (header, *_) = robot.trace("header")
    assert header["applications"] == ["first", "second"] and header["app"] == "first+second"
    assert [line["application"] for line in robot.trace("init")] == ["first", "second"]
    rounds = [(line["round"], line["application"]) for line in robot.trace("round")]
    assert rounds[:4] == [(1, "first"), (1, "second"), (2, "first"), (2, "second")]
    assert {line["application"] for line in robot.trace("stream")} == {"first"}
    assert any("first: Log.stdout: x" in line for line in robot.lines)
    report = robot.agent.snapshot(robot.clock.now())
    assert {"first.a", "second.b"} == {row[0] for row in report["shared"]}
    assert {row[3] for row in report["outcomes"]} == {"first: Go", "second: Go"}
    snapshot = robot.agent.metrics.snapshot(0.0, {})
    assert snapshot["rounds"] <= robot.agent.round and snapshot["events"] == 2 * snapshot["rounds"]


def test_one_application_is_not_named() -> None:
    (only,) = system(counts("a"), robots=2).applications
    fleet = flown(fleet_program(System((only,), 2)), 5)
    robot = fleet.robots[0]
    assert {line["application"] for line in robot.trace("round")} == {"first"}
    assert {r.application for r in robot.records} == {""} and not any(": " in k for k in robot.agent.counters())


def test_each_application_has_its_monitors_and_actions() -> None:
    small = "invariant Small: {} < 5\n"
    both = system(counts("a") + small.format("a"), counts("b", head=DRIVES) + small.format("b"))
    program = fleet_program(both)
    given = {"properties": properties_of(both), "monitors": {"second.Small": "hold", "default": "log"}}
    fleet = flown(program, 4, **given)
    assert fleet.robots[0].agent.monitors.report() == {"counts": {"held": 2}, "violated": []}
    fleet = flown(program, 12, **given)
    robot = fleet.robots[0]
    report = robot.agent.monitors.report()
    assert [(v["name"], v["action"]) for v in report["violated"]] == [("first.Small", "log"), ("second.Small", "hold")]
    assert robot.platform.held and robot.agent.phase == "running"
    assert any("first: invariant Small (first.koord:" in line and "is violated" in line for line in robot.lines)
    found = [(line["application"], line["outcome"]) for line in robot.trace("monitor")]
    assert found == [("first", "held"), ("second", "held"), ("first", "violated"), ("second", "violated")]
    stops = flown(program, 12, properties=properties_of(both), monitors={"first.Small": "stop"})
    assert stops.robots[0].agent.status == VIOLATED


def test_time_that_an_application_leaves_goes_to_the_next_and_the_first_place_rotates() -> None:
    program = fleet_program(system(counts("a"), counts("b"), robots=1))
    fleet = Fleet(n=1)
    seconds = {"first": 0.03, "second": 0.01}  # of 0.05 up to the publish deadline

    def taking(application: FleetApplication) -> FleetApplication:
        (event,) = application.program.events

        def effect(state: Any) -> None:
            event.effect(state)
            fleet.time.time += seconds[application.name]

        events = (replace(event, effect=effect),)
        return replace(application, program=replace(application.program, events=events))

    fleet.program = replace(program, applications=tuple([taking(each) for each in program.applications]))
    fleet.boot(0, Body(Point()))
    fleet.run_rounds(9)
    late: dict[str, list[int]] = {r.application: [] for r in fleet.robots[0].records}
    for record in fleet.robots[0].records:
        if record.fault is not None:
            assert record.fault.reason == LATE
            late[record.application].append(record.round)
    assert late["second"] == [] and late["first"] == [2, 4, 6, 8], (
        "half of the time is too little, what is left is enough"
    )


@pytest.mark.parametrize(
    ("given", "shares"), [((None, None), [0.5, 0.5]), ((0.7, None), [0.7, 0.3]), ((0.2, 0.2), [0.2, 0.2])]
)
def test_applications_without_a_share_divide_the_rest(given: tuple[float | None, ...], shares: list[float]) -> None:
    program = fleet_program(system(counts("a"), counts("b")))
    applications = [replace(a, share=share) for a, share in zip(program.applications, given, strict=True)]
    shared = replace(program, applications=tuple(applications))
    assert [shared.share(instance) for instance in shared.of_robot(0)] == pytest.approx(shares)


def test_paths_of_others_are_those_of_the_members() -> None:
    text = MOTION + "allread: Point x[N_SYS]\nlocal: int k\nGo:\n  pre: True\n  eff: x[pid] = Point(pid + 1, 0, 0)\n"
    first, second = compiled("first", counts("a")), compiled("second", text)
    both = System((Application("first", first, (0, 1, 2)), Application("second", second, (0, 2))), 3)
    fleet = flown(fleet_program(both), 6, avoid="second.x")
    seen = [robot.platform.seen_paths[-1] for robot in fleet.robots.values()]
    one, two = (Point(1, 0, 0),), (Point(2, 0, 0),)
    assert seen == [{2: two}, {0: one, 2: two}, {0: one}]
