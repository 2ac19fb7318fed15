"""The benchmark's arenas: every way that there is, is found, and none collides, as python-fcl sees it."""

from __future__ import annotations

import random

import pytest

from benchmarks.fixtures.arenas import (
    ARENA,
    CLEARANCE,
    GOAL,
    GRAZE,
    KEPT,
    NOWHERE,
    RADIUS,
    START,
    Checker,
    Fine,
    arena,
    many,
)  # fmt: skip
from koordgen.runtime.values.points import Point
from targets.planning.ask import PlannerJudge
from targets.planning.room import Room, fixed
from targets.planning.world import World


@pytest.mark.parametrize("seed", range(20))
def test_every_solvable_arena_is_solved_and_no_path_collides(seed: int) -> None:
    bodies = arena(seed)
    world, checker = World(ARENA, bodies, CLEARANCE, RADIUS, seed=1, iterations=5000), Checker(bodies)
    for name in ("rrt", "rrt-smoothed"):
        path, why = PlannerJudge(name, world).answer(START, GOAL, NOWHERE, 0.0)
        assert path or not Fine(world).plan(START, GOAL, NOWHERE, 0.0), why
        assert not checker.collides(path)


def test_the_checker_and_the_planners_agree_on_lines() -> None:
    source, clear, lines = random.Random(4), 0, 0
    for seed in range(5):
        bodies = arena(seed)
        checker, here = Checker(bodies), Room(START)
        here.keep(fixed(bodies), KEPT)
        for _ in range(200):
            a, b = (Point(source.uniform(0, 7), source.uniform(0, 8), source.uniform(0.5, 3)) for _ in "ab")
            found = here.clear(a, b)
            clear, lines = clear + found, lines + 1
            assert not checker.collides((a, b), KEPT - GRAZE) if found else checker.collides((a, b), KEPT + GRAZE)
    assert 0.02 * lines < clear < 0.9 * lines


@pytest.mark.slow
def test_a_thousand_ways_without_a_collision() -> None:
    found, colliding, none = many(list(range(20)), 1000)
    assert colliding == 0 and found + none > 900
