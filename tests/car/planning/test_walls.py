"""Ways through doors, out of dead ends and around walls: found, found with every larger budget, and drivable."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from benchmarks.fixtures.car_checker import collisions, infeasible
from benchmarks.fixtures.car_rooms import room, solvable
from benchmarks.fixtures.car_scenes import ask, curve, world
from koordgen.runtime.values.points import Point
from targets.car.planning.ask import CarJudge
from targets.car.planning.field import FAR, Cells, Field
from targets.car.planning.overlap import ShapeTable
from targets.car.planning.planner import Area, price, segments
from targets.car.planning.shapes import Footprint, Shape
from targets.planning.pipe import Answer

SHORT, LONG = 40, 400  # units of work: about those of 60 ms and of 0.6 s
QUERIES = sorted(solvable())


def answer(seed: int, number: int, units: int, name: str = "rrt-smoothed") -> Answer:
    here = room(seed)
    query = here.queries[number]
    return ask(CarJudge(name, world(here.walls, seed=1, iterations=units)), query.start, Point(*query.goal, 0.0))


def check(seed: int, number: int, found: Answer) -> None:
    place, path = world(room(seed).walls), segments(curve(found))
    assert not collisions(place, path) and not infeasible(place, path)


def test_there_are_enough_queries() -> None:
    assert len(QUERIES) >= 255 and len({seed for seed, _ in QUERIES}) >= 51


def test_most_ways_are_found_soon_and_all_in_time() -> None:
    some = QUERIES[::10]
    late = [each for each in some if not answer(*each, SHORT, "rrt").path]
    assert len(late) <= 0.05 * len(some), late
    assert all(answer(*each, LONG, "rrt").path for each in late)


@pytest.mark.parametrize(("seed", "number"), QUERIES[3::40])
def test_a_larger_budget_is_never_worse(seed: int, number: int) -> None:
    costs = []
    for units in (1, 4, 16, 64, 128):
        found = answer(seed, number, units)
        costs.append(price(curve(found).pieces) if found.path else math.inf)
        if found.path:
            check(seed, number, found)
    assert costs == sorted(costs, reverse=True) and costs[-1] < math.inf


@pytest.mark.slow
def test_all_ways_are_found_drivable_and_found_again_with_more_time() -> None:
    late = 0
    for seed, number in QUERIES:
        soon = answer(seed, number, SHORT)
        later = answer(seed, number, LONG)
        assert later.path, (seed, number)
        check(seed, number, later)
        if soon.path:
            check(seed, number, soon)
            assert price(curve(later).pieces) <= price(curve(soon).pieces)
        late += not soon.path
    assert late <= 0.05 * len(QUERIES)


def test_a_table_of_shapes_says_what_the_outline_measures() -> None:
    dice = random.Random(3)
    body = Footprint(0.5, 0.28, 0.085)
    shapes: list[Shape] = []
    kept: list[float] = []
    for i in range(60):
        x, y = dice.uniform(0, 7), dice.uniform(0, 8)
        shapes += [
            [Shape(((x, y), (x + 0.5, y), (x + 0.5, y + 0.3), (x, y + 0.3)), 0.0, "box", True)],
            [Shape(((x, y),), 0.2, "disc")],
            [Shape(((x, y), (x + dice.uniform(-1, 1), y + dice.uniform(-1, 1))), 0.3, "line")],
            [Shape(((x, y), (x + 0.6, y + 0.1), (x + 0.2, y + 0.5)), 0.0, "triangle")],
        ][i % 4]
        kept.append(dice.uniform(0, 0.15))
    table = ShapeTable(shapes, kept, body, (-0.5, -0.5, 7.5, 8.5))
    x, y, yaw = np.random.default_rng(1).uniform((0, 0, -7), (7, 8, 7), (1000, 3)).T
    for pad in (0.0, 0.01):
        found = table.free(body, x, y, yaw, pad)
        for i, at in enumerate(zip(x.tolist(), y.tolist(), yaw.tolist(), strict=True)):
            away = min(body.distance(*at, shape) - least for shape, least in zip(shapes, kept, strict=True))
            assert found[i] == (away >= pad)
        assert 0.1 < found.mean() < 0.9


def test_a_field_leads_around_walls_and_through_doors() -> None:
    cells = Cells(Area(0.0, 0.0, 6.0, 6.0), 0.15)
    wall = (abs(cells.x - 3.0) < 0.2) & (cells.y < 5.0)
    field = Field((1.0, 1.0), cells, ~wall)
    x, y = np.array((1.0, 1.0, 5.0, 5.0)), np.array((1.0, 4.0, 5.5, 1.0))
    around = math.dist((1, 1), (2.8, 5)) + math.dist((3.2, 5), (5, 1)) + 0.4
    assert field(x, y) == pytest.approx((0.0, 3.0, 6.0, around), rel=0.1, abs=0.15)
    shut = Field((1.0, 1.0), cells, ~(wall | (abs(cells.x - 3.0) < 0.2)))
    assert shut(np.array((5.0,)), np.array((1.0,))) == FAR
