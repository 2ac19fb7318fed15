"""The outer robot of a squad: it runs on one inner robot, and survives its loss."""

from __future__ import annotations

import pytest

from koordgen.runtime.agent.squad import STORED
from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.points import Opaque, Point, distance
from tests.squads.disturbances import after_an_event
from tests.squads.levels import INNER, LOSSY, WAVE, Levels

LINE = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target at position clears reached
allread: Point x[N_SYS]
local: int k
init:
  x[pid] = Motion.position
Update:
  pre: not (pid == N_SYS - 1 or pid == 0)
  eff:
    k += 1
    Motion.target = (x[pid + 1] + x[pid - 1]) / 2
    x[pid] = Motion.position
"""

COUNT = """
using Motion:
  sensors: Point position
  actuators: Point target
allwrite: int total
allread: int own[N_SYS]
local: int k
Both:
  pre: k % 3 == 2
  eff:
    atomic:
      k += 1
      total = total + 1
      own[pid] = k
Count:
  pre: True
  eff:
    k += 1
    own[pid] = k + total
"""


def test_a_squad_takes_part_in_the_outer_fleet() -> None:
    levels = Levels(LINE, [0, 3, 0])
    levels.run_rounds(20)
    middle = (levels.nodes[0].platform.position + levels.nodes[4].platform.position) / 2
    position = levels.records[1, 20].sensors["Motion.position"]
    assert distance(position, middle) < 0.1, (position, middle)
    assert levels.records[1, 20].event == "Update"
    assert max(levels.limits) <= 0.2 * INNER, "an outer event delays the inner robot, whose process runs it"


def test_an_order_to_stop_in_the_outer_fleet_stops_the_inner_robots() -> None:
    levels = Levels(LINE, [0, 3, 3])
    levels.run_rounds(4)
    levels.nodes[0].agent.stop_all("emergency stop")
    assert levels.run(20.0, lambda: all(node.agent.phase == "stopped" for node in levels.nodes.values())), {
        place: node.agent.phase for place, node in levels.nodes.items()
    }
    lines = [line for place in levels.places(1) for line in levels.nodes[place].lines]
    assert any("error: bert: the outer robot stops safely" in line for line in lines)


@pytest.mark.parametrize("stopped", [1, 2], ids=["host", "other"])
@pytest.mark.parametrize("text", [LINE, COUNT], ids=["nothing to write", "messages wait"])
def test_an_emergency_stop_of_a_robot_of_a_squad_stops_the_robots_of_all_levels(stopped: int, text: str) -> None:
    levels = Levels(text, [0, 3, 3], 1, LOSSY)
    levels.run_rounds(4)
    after_an_event(levels, 1)
    levels.nodes[stopped].agent.stop_all("emergency stop")
    assert levels.run(20.0, lambda: all(node.agent.phase == "stopped" for node in levels.nodes.values())), {
        place: node.agent.phase for place, node in levels.nodes.items()
    }
    assert any("error: emergency stop of its robots" in line for line in levels.nodes[1].lines)
    assert not any("does not count" in line for line in levels.nodes[0].lines), "it was told, it did not conclude"


def test_the_safe_stop_of_one_inner_robot_stops_nobody_else() -> None:
    levels = Levels(LINE, [0, 3, 0], 1, LOSSY)
    levels.run_rounds(4)
    levels.nodes[1].agent.end("SIGTERM: stopping safely")
    assert levels.run(20.0, lambda: levels.nodes[1].agent.phase == "stopped")
    assert levels.run(8 * INNER, lambda: levels.host(1) is levels.nodes[2]), "nobody waits until its process has ended"
    levels.run_rounds(20)
    assert {levels.nodes[place].agent.phase for place in (0, 2, 3, 4)} == {"running"}


GO = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target at position clears reached
local: int k
Go:
  pre: Motion.reached
  eff:
    k += 1
    Motion.target = Point(2 * (k % 2), 0, 1)
"""


@pytest.mark.parametrize("kills", [0, 1])
def test_a_command_clears_a_sensor_until_the_inner_fleet_has_it_and_reaches_it(kills: int) -> None:
    levels = Levels(GO, [3, 0, 0], 1, Conditions(loss=0.1, delay=0.001, jitter=0.01))
    levels.run_rounds(4)
    if kills:
        levels.kill(0)
        levels.run(3.0)
        levels.boot(0)
    levels.run_rounds(40)
    commanded: list[Point] = []
    for round_ in range(1, levels.complete):
        record = levels.records.get((0, round_))
        if record is None or record.event is None:
            continue
        if commanded:
            assert distance(record.sensors["Motion.position"], commanded[-1]) < 0.2, (round_, commanded[-1])
        assert record.effects is not None
        commanded.append(record.effects.actuators["Motion.target"])
    assert len(commanded) >= 4 and commanded == [Point(2 * (k % 2), 0, 1) for k in range(1, len(commanded) + 1)]


def test_the_host_is_the_robot_of_lowest_pid_and_keeps_the_outer_robot() -> None:
    levels = Levels(COUNT, [3, 3, 0])
    levels.run_rounds(4)
    assert {(squad, pid) for _, squad, pid in levels.hosts} == {(0, 0), (1, 0)}
    levels.kill(0)
    levels.run_rounds(20)
    levels.boot(0)
    levels.run_rounds(40)
    assert [(squad, pid) for _, squad, pid in levels.hosts[2:]] == [(0, 1)], "it does not go back"
    assert levels.follow(40)["event"] > 90


def test_a_host_that_is_cut_off_ends_its_outer_agent_when_it_hears_of_its_successor() -> None:
    levels = Levels(COUNT, [3, 0, 0])
    levels.run_rounds(4)
    levels.cut(0, outside=False)
    assert levels.run(10, lambda: [pid for _, _, pid in levels.hosts] == [0, 1])
    assert levels.run(10, lambda: levels.nodes[0].outer is None), "it hears the outer fleet, and so of its successor"
    levels.run_rounds(max(levels.applied) + 10)
    levels.restore()
    levels.run_rounds(max(levels.applied) + 3)
    levels.cut(1, outside=True)
    assert levels.run(10, lambda: [pid for _, _, pid in levels.hosts] == [0, 1, 0]), "its process never ended"
    levels.run_rounds(max(levels.applied) + 10)
    assert levels.follow(levels.complete)["event"] > 50 and not levels.sent_by_former_hosts


def test_the_outer_robot_goes_on_when_another_inner_robot_dies() -> None:
    levels = Levels(COUNT, [3, 0, 0])
    levels.run_rounds(6)
    levels.kill(2)
    levels.run_rounds(20)
    seen = levels.follow(20)
    assert len(levels.hosts) == 1
    skipped = [r for r in range(1, 21) if levels.records[0, r].skipped]
    assert len(skipped) <= 4 and seen["event"] >= 60 - 6, skipped


def test_the_outer_robot_holds_without_an_inner_majority() -> None:
    levels = Levels(LINE, [0, 3, 0])
    levels.run_rounds(6)
    host = levels.host(1)
    assert host is not None
    levels.kill(2)
    levels.kill(3)
    levels.run(20)
    assert host.outer is not None and host.outer.phase == "running"
    assert any("the inner fleet is" in line and "rounds behind" in line for line in host.lines), host.lines
    ended = max(r for p, r in levels.records if p == 1)
    assert levels.run(1, lambda: levels.records[0, ended + 20].event is None), "the others went on without it"
    levels.boot(2)
    assert levels.run(
        60, lambda: any(p == 1 and r > ended + 20 and levels.records[p, r].event for p, r in levels.records)
    )


def test_an_outer_robot_moves_although_it_heard_the_last_robot_just_before_its_mission() -> None:
    levels = Levels(WAVE, [3, 3, 0], 4, LOSSY)
    levels.run_rounds(8)
    for squad in (0, 1):
        position = levels.records[squad, 8].sensors["Motion.position"]
        assert position.z > 1, (squad, position)


def test_a_record_that_no_host_wrote_stops_the_inner_robots_safely() -> None:
    levels = Levels(COUNT, [3, 0, 0])
    levels.run_rounds(4)
    host = levels.host(0)
    assert host is not None and host.host is not None and host.agent.state is not None
    host.agent.state.shared = {**host.agent.state.shared, STORED: Opaque(b"no record")}
    assert levels.run(20, lambda: all(levels.nodes[p].agent.phase == "stopped" for p in levels.places(0)))
    assert any("internal error, please report it" in line for line in host.lines)
