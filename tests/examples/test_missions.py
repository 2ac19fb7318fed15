"""Missions of the examples: each reaches its goal, and invariants hold after every round, even a missed one."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import pytest

from koordgen.lang.semantics.state import State
from koordgen.lang.semantics.values import Value
from koordgen.runtime.values.gridmap import GridMap, is_free, is_occupied
from koordgen.runtime.values.points import Grid, Point
from tests.examples.stage import Stage

SKIPS = pytest.mark.parametrize("skips", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])


def stopped(state: State) -> bool:
    return all(robot.stopped for robot in state.robots)


def plan(p: Point) -> tuple[float, float]:
    return p.x, p.y


def of_robots(stage: Stage, local: str) -> list[Value]:
    return [robot.locals[local] for robot in stage.state.robots]


@SKIPS
def test_lineform_lines_up(skips: float) -> None:
    stage = Stage("lineform", skips)
    first, *_, last = places = [plan(body.position) for body in stage.bodies]
    for _ in range(400):
        stage.step()
    for pid, body in enumerate(stage.bodies):
        share = pid / (len(places) - 1)
        wanted = [a + share * (b - a) for a, b in zip(first, last, strict=True)]
        assert math.dist(plan(body.position), wanted) < 0.1


TASK_FLEETS = ("fleet", "fleet_2q1c", "fleet_1q2c", "fleet_4q", "fleet_4c")


def done(stage: Stage) -> list[int]:
    """Return the tasks that robots reported as done, ordered by id."""
    return sorted(int(line.split()[1]) for _, line in stage.lines if line.endswith("done"))


@SKIPS
@pytest.mark.parametrize("fleet", TASK_FLEETS)
def test_task_all_tasks_are_done_once(fleet: str, skips: float) -> None:
    stage = Stage("task", skips, f"{fleet}.yaml")
    moving = 0

    def over(state: State) -> bool:
        nonlocal moving
        moving = max(moving, sum(len(path) > 1 for path in state.store.slots["shared_paths"]))  # type: ignore[arg-type]
        return stopped(state)

    stage.until(over, 3000)
    assert done(stage) == list(range(1, 21)) and stage.state.store.cells["all_tasks"] == ()
    assert moving == len(stage.bodies), "all of them were under way at once"


@SKIPS
def test_task_whose_way_is_taken_waits(skips: float) -> None:
    """Cleo's path to the third task would lead between the two others."""
    places = [[5.0, 5.5, 0.0], [2.2, 5.5, 0.0], [3.5, 1.0, 0.0]]
    tasks = [{"target": place, "id": number} for number, place in enumerate(places)]
    stage = Stage("task", skips, "fleet_4c.yaml", eps=1.2, tasks=tasks)
    stage.until(stopped, 900)
    assert done(stage) == [0, 1, 2]


@SKIPS
@pytest.mark.parametrize(
    ("fleet", "left"), [("fleet_4c", [2, 3]), ("fleet_4q", [1]), ("fleet", [])], ids=["cars", "quads", "both"]
)
def test_task_that_nobody_can_reach_is_told_and_not_waited_for(fleet: str, left: list[int], skips: float) -> None:
    places = [[2.0, 5.5, 0.0], [5.0, 5.5, 1.5], [3.5, 1.0, 2.0]]
    tasks = [{"target": place, "id": number + 1} for number, place in enumerate(places)]
    stage = Stage("task", skips, f"{fleet}.yaml", tasks=tasks)
    stage.until(stopped, 1500)
    assert done(stage) == [number for number in (1, 2, 3) if number not in left]
    robots = range(len(stage.bodies))
    told = sorted((pid, line) for pid, line in stage.lines if "reachable" in line)
    assert told == [(pid, f"task {number} is not reachable") for pid in robots for number in left]


@SKIPS
def test_mapping_finds_the_walls(skips: float) -> None:
    stage = Stage("mapping", skips)
    starts = [body.position for body in stage.bodies]
    stage.until(stopped, 600)
    found = stage.state.store.cells["map"]
    assert isinstance(found, GridMap)
    assert all(math.dist(plan(a), plan(b.position)) > 2 for a, b in zip(starts, stage.bodies, strict=True))
    inside = [Grid(x, y, 0.5) for x in range(-8, 8) for y in range(-8, 8)]
    walls = {g for g in inside if any(touches(g, box["lo"], box["hi"]) for box in stage.fleet.obstacles)}
    assert {g for g in inside if is_occupied(found, g)} == walls
    assert all(is_free(found, g) for g in inside if g not in walls)


def touches(g: Grid, lo: list[float], hi: list[float]) -> bool:
    x, y = g.x * g.size, g.y * g.size
    return x < hi[0] and lo[0] < x + g.size and y < hi[1] and lo[1] < y + g.size


@SKIPS
def test_delivery_every_parcel_at_its_door(skips: float) -> None:
    stage = Stage("delivery", skips)
    stage.until(stopped, 1500)
    by: Any = stage.state.store.cells["delivered_by"]
    assert [label for label, _ in by] == ["E1", "E3", "W2", "W4"]
    assert sorted(line for _, line in stage.lines) == sorted(f"robot {pid} delivered {label}" for label, pid in by)


@SKIPS
def test_delivery_one_after_the_other(skips: float) -> None:
    """The doors in the middle are 4 m apart, so paths to different doors come too close to one another."""
    Stage("delivery", skips, eps=4.5).until(stopped, 2500)


@SKIPS
def test_patrol_all_see_all_waypoints(skips: float) -> None:
    stage = Stage("patrol", skips)
    for _ in range(1200):
        stage.step()
    assert {(pid, line) for pid, line in stage.lines} == {(p, f"seen waypoint {w}") for p in range(3) for w in range(4)}


@SKIPS
def test_rendezvous_ends_on_a_ring(skips: float) -> None:
    stage = Stage("rendezvous", skips)
    stage.until(stopped, 300)
    middle = sum((b.position for b in stage.bodies), Point()) / len(stage.bodies)
    for body in stage.bodies:
        assert math.isclose(math.dist(plan(body.position), plan(middle)), 1.2 * 4 / (2 * math.pi), abs_tol=0.1)
    for one, other in combinations(stage.bodies, 2):
        assert math.dist(plan(one.position), plan(other.position)) > 1.0
    assert sorted(stage.lines) == [(pid, "all 4 have met") for pid in range(4)]


@SKIPS
def test_follow_keeps_the_gap(skips: float) -> None:
    stage = Stage("follow", skips)
    for _ in range(400):
        stage.step()
        for ahead, behind in zip(stage.bodies[:-1], stage.bodies[1:], strict=True):
            away = math.dist(plan(ahead.position), plan(behind.position))
            assert 0.7 < away < 2.5
    assert math.dist(plan(stage.bodies[0].position), (0, 3)) < 0.1 and stage.state.robots[0].stopped
    assert all(
        math.isclose(math.dist(plan(a.position), plan(b.position)), 1.0, abs_tol=0.05)
        for a, b in zip(stage.bodies[:-1], stage.bodies[1:], strict=True)
    )


@SKIPS
def test_formation_is_a_polygon_that_turns(skips: float) -> None:
    stage = Stage("formation", skips)
    for _ in range(300):
        stage.step()
    turned = stage.state.store.cells["turned"]
    assert isinstance(turned, float) and turned > 0.5
    for pid, body in enumerate(stage.bodies):
        angle = 2 * math.pi * pid / 5 + turned
        assert math.dist(plan(body.position), (2.5 * math.cos(angle), 2.5 * math.sin(angle))) < 0.3


@SKIPS
def test_election_has_one_leader(skips: float) -> None:
    stage = Stage("election", skips)
    stage.until(stopped, 100)
    leaders, bids = of_robots(stage, "leader"), stage.state.store.slots["bid"]
    assert leaders == [bids.index(max(bids))] * 5  # type: ignore[type-var]
    assert sorted(stage.lines) == [(pid, f"robot {leaders[0]} leads") for pid in range(5)]


@SKIPS
def test_atomicsum_loses_nothing(skips: float) -> None:
    stage = Stage("atomicsum", skips)
    stage.until(stopped, 300)
    assert stage.state.store.cells["total"] == 15
    assert sorted(stage.lines) == [(pid, "sum 15 of 5 robots") for pid in range(5)]


@SKIPS
def test_hvac_rooms_become_and_stay_warm(skips: float) -> None:
    stage = Stage("hvac", skips)
    for turn in range(1500):
        stage.step()
        assert turn < 150 or all(19.5 < body.temp < 22.5 for body in stage.bodies)
    assert len({pid for pid, line in stage.lines if line.startswith("off")}) == 3


@pytest.mark.parametrize("name", ["task", "mapping", "delivery", "hvac", "follow", "formation", "rendezvous"])
def test_no_event_is_discarded(name: str) -> None:
    stage = Stage(name, 0.1)
    for _ in range(150):
        stage.step()
    assert not stage.discarded
