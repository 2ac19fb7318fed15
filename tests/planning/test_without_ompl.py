"""Planning with a Python that OMPL has no wheel for: quads' own trees, a car's own lengths, and what is refused."""

from __future__ import annotations

import sys
from itertools import pairwise

import pytest

from benchmarks.fixtures import car_scenes as scenes
from benchmarks.fixtures.car_checker import collisions
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point, distance
from targets.car.planning import ask as car
from targets.car.planning.planner import segments
from targets.planning import own_trees
from targets.planning.ask import BadPlanner, PlannerJudge
from targets.planning.exact import solid_distance
from targets.planning.world import Path, Scene, World
from tests.planning.test_contract import ARENA, CLEARANCE, GOAL, KEPT, RADIUS, START, WALL, keeps


@pytest.fixture(autouse=True)
def no_ompl(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "ompl" or "ompl_" in name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "ompl", None)
    with monkeypatch.context() as now:
        now.setattr(sys, "version_info", (3, 13))
        assert not own_trees.is_needed(), "where OMPL has a wheel, a missing one is to be installed"
        now.setattr(sys, "version_info", (3, 14))
        assert own_trees.is_needed()
    monkeypatch.setattr(own_trees, "is_needed", lambda: True)


def planned(name: str, seed: int, *obstacles: Block) -> Path:
    world = World(ARENA, obstacles, CLEARANCE, RADIUS, seed=seed, iterations=2000)
    return PlannerJudge(name, world).answer(START, GOAL, Scene(), 5.0)[0]


@pytest.mark.parametrize("name", ["rrt", "rrt-smoothed"])
def test_a_quad_finds_its_way_around_a_wall(name: str) -> None:
    for seed in range(20):
        path = planned(name, seed, WALL)
        keeps(path, START, GOAL)
        assert min(solid_distance(WALL, a, b) for a, b in pairwise(path)) >= KEPT - 1e-9
        assert path == planned(name, seed, WALL), "the same seed gives the same path"
        if name == "rrt-smoothed":
            assert sum(distance(a, b) for a, b in pairwise(path)) < 11.0


def test_a_quad_whose_goal_is_walled_off_gets_no_path() -> None:
    assert planned("rrt-smoothed", 1, Block(Point(-0.2, -4.0, 0.0), Point(0.2, 4.0, 3.0))) == ()


def test_a_car_finds_its_way_around_a_wall() -> None:
    wall = Block(Point(3.4, 0.0, 0.0), Point(3.6, 5.5, 1.0))
    for reverse in (True, False):
        place = scenes.world((wall,), reverse, seed=3, iterations=200)
        answer = scenes.ask(car.CarJudge("rrt-smoothed", place), (1.0, 4.0, 0.0), Point(6.0, 4.0, 0.0))
        assert answer.path and answer.path[-1] == Point(6.0, 4.0, 0.0)
        assert not collisions(place, segments(scenes.curve(answer)))


@pytest.mark.parametrize("asked", [PlannerJudge, car.CarJudge])
def test_rrt_star_is_refused_and_said_why(asked: type[PlannerJudge | car.CarJudge]) -> None:
    with pytest.raises(BadPlanner, match="needs OMPL, which has no wheel for this Python; use rrt-smoothed"):
        asked("rrt-star", scenes.world())
