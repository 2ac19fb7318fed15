"""What a platform is handed of the other robots, and what it tells on the way."""

from __future__ import annotations

from benchmarks.fixtures.fleet import STARTS, Fleet


def test_a_platform_is_handed_the_slots_of_the_others_before_each_event() -> None:
    fleet = Fleet(n=3)
    for pid in range(3):
        fleet.boot(pid, avoid="x")
    fleet.run_rounds(4)
    for pid, robot in fleet.robots.items():
        seen = robot.platform.seen_paths
        assert seen[0] == {other: (STARTS[other],) for other in range(3) if other != pid}
    middle = fleet.robots[1].platform
    record = fleet.robots[0].records[-1]
    assert record.frame is not None
    handed = [paths[1] for paths in fleet.robots[0].platform.seen_paths]
    assert (record.frame.shared["x"][1],) in handed, "as its event saw the store"
    assert len(middle.seen_paths) == 1, "what has not changed is not handed on again: robots 0 and 2 publish once"


def test_without_avoid_nothing_is_handed_on() -> None:
    fleet = Fleet(n=2).boot_all()
    fleet.run_rounds(3)
    assert fleet.robots[0].platform.seen_paths == []


def test_what_a_platform_tells_is_in_the_log_once() -> None:
    fleet = Fleet(n=1).boot_all()
    robot = fleet.robots[0]
    robot.platform.told = ["the planner was late"]
    fleet.run_rounds(3)
    assert len([line for line in robot.lines if "the planner was late" in line]) == 1
