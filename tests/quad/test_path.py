"""A quad on a commanded path, and its callable port."""

from __future__ import annotations

import math

from koordgen.runtime.values import Grid, Point, distance
from tests.quad.rig import Rig

PATH = (Point(3.0, -2.0, 1.5), Point(3.0, 2.0, 2.5), Point(-1.0, 2.0, 1.5))


def at(rig: Rig) -> Point:
    return Point(*rig.body.position)


def test_a_path_is_flown_point_by_point_and_reached_at_its_end_only() -> None:
    rig = Rig()
    rig.fly()
    nearest = [math.inf] * len(PATH)
    early: list[float] = []

    def watch() -> None:
        for i, p in enumerate(PATH):
            nearest[i] = min(nearest[i], distance(at(rig), p))
        if rig.reached() and distance(at(rig), PATH[-1]) > 0.2:
            early.append(rig.now)

    rig.quad.command({"Motion.path": PATH}, rig.now)
    rig.watch = watch
    assert rig.run(30.0, rig.reached)
    assert not early
    assert distance(at(rig), PATH[-1]) < 0.2
    assert all(d < 0.25 for d in nearest), nearest  # 0.1 m by the reference, the rest by the vehicle


def test_an_empty_path_means_stay() -> None:
    rig = Rig()
    rig.fly()
    rig.quad.command({"Motion.path": PATH}, rig.now)
    rig.run(2.0)
    rig.quad.command({"Motion.path": ()}, rig.now)
    assert rig.reached()
    rig.run(4.0)
    here = at(rig)
    rig.run(4.0)
    assert distance(at(rig), here) < 0.05


def test_the_planner_answers_from_the_present_place_and_refuses_the_ground() -> None:
    rig = Rig()
    rig.fly()
    goal = Point(4.0, 0.0, 1.5)
    path = rig.quad.call("Motion.planner", (goal,))
    assert path[-1] == goal and distance(path[0], at(rig)) < 0.1
    assert rig.quad.call("Motion.planner", (Point(4.0, 0.0, 0.0),)) == ()
    assert rig.quad.call("Motion.planner", (Point(40.0, 0.0, 1.5),)) == ()
    wall = tuple(Grid(10, j, 0.25) for j in range(-12, 8))
    assert len(rig.quad.call("Motion.planner", (goal, wall))) > 2
