"""A car on a commanded path, and its callable port."""

from __future__ import annotations

import math

from koordgen.runtime.values.points import Grid, Point
from tests.car.platform.world import World

PATH = (Point(1.5, 0.0, 0.0), Point(3.0, 1.5, 0.0), Point(3.0, 3.0, 0.0))


def test_a_path_is_driven_point_by_point_and_reached_at_its_end_only() -> None:
    world = World().begin()
    world.car.command({"Motion.path": PATH}, world.now)
    nearest = [math.inf] * len(PATH)
    early: list[float] = []

    def look() -> None:
        for i, p in enumerate(PATH):
            nearest[i] = min(nearest[i], world.distance(p.x, p.y))
        if world.value("reached") and world.distance(3.0, 3.0) > 0.15:
            early.append(world.now)

    world.run(0.1)
    world.run(30.0, look)
    assert not early
    assert world.value("reached")
    assert world.distance(3.0, 3.0) < 0.12
    assert all(d < 0.45 for d in nearest), nearest


def test_an_empty_path_means_stay() -> None:
    world = World().begin()
    world.car.command({"Motion.path": PATH}, world.now)
    world.run(2.0)
    world.car.command({"Motion.path": ()}, world.now)
    world.run(4.0)
    x, y = world.body.truth.x, world.body.truth.y
    world.run(4.0)
    assert world.distance(x, y) < 0.05
    assert world.value("reached")


def test_the_planner_answers_from_the_present_place_and_refuses_heights() -> None:
    world = World().begin()
    path = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0),))
    assert path[-1] == Point(3.0, 0.0, 0.0) and world.distance(path[0].x, path[0].y) < 0.05
    assert world.car.call("Motion.planner", (Point(3.0, 0.0, 1.0),)) == ()
    wall = tuple(Grid(6, j, 0.25) for j in range(-8, 8))
    around = world.car.call("Motion.planner", (Point(3.0, 0.0, 0.0), wall))
    assert len(around) > 2
