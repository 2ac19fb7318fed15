"""Planning for a car in seeded scenes of 7 x 8 m, clutter and walls with doors: success, time, length, collisions.

`python benchmarks/car_planning.py [--quick] [--json FILE] [--pythonrobotics PATH]`. PATH is a checkout of
github.com/AtsushiSakai/PythonRobotics. Its RRT with Dubins paths and RRT* with Reeds-Shepp paths then plan from the
same pose to the same pose among the same obstacles, to their first path, with at most 200 iterations. They only know
discs: they see a box as the disc inside it, and the car as a disc of its width, so they have more room than our car.

Without reverse, many scenes have no path: the car may stand with its front to a wall. A scene counts as solvable if an
exhaustive search of a state lattice finds a path. `fixtures/car_checker.py` checks paths: the outline each centimetre
against every obstacle, and the curvature. Times are those of the planner as its process runs it, without the pipe. Our
budgets count CPU time. The exit status is 1 if a solvable scene is not solved, or if a path is infeasible or collides;
no time is asserted.

The second table has rooms with walls (`fixtures/car_rooms.py`): doors, dead ends, U shapes, offset doors. Our planner
is called as a program's `planner(goal)` is, for any heading at the goal, with several values of `planner_budget`. For
PythonRobotics a wall is a row of discs as wide as the wall is thick; it plans every sixth query.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import random
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path as FilePath
from statistics import mean, median
from types import SimpleNamespace
from typing import Any
from unittest import mock

sys.path.insert(0, str(FilePath(__file__).parents[1]))

from benchmarks.fixtures.car_checker import collides, collisions, infeasible
from benchmarks.fixtures.car_lattice import Lattice
from benchmarks.fixtures.car_rooms import room, solvable
from benchmarks.fixtures.car_scenes import CAR, Case, ask, case, curve
from koordgen.runtime.values.obstacles import Block, Cylinder, Obstacle
from koordgen.runtime.values.points import Point
from targets.car.planning.ask import CarJudge
from targets.car.planning.planner import segments
from targets.planning.process import SHARE

SCENES, QUICK = 60, 15
BUDGET, PATIENCE = 0.036, 2.0  # seconds: to shorten a path (40 ms in all); limit of the search for any path
ITERATIONS = 200
RUNS = 5  # of our planner with 40 ms, in each scene
BUDGETS = (0.01, 0.04, 0.06, 0.3, 0.6)  # seconds, in rooms with walls
QUICK_STEP = 12  # with --quick, only every 12th query
PEERS_STEP = 6  # the peers answer every sixth of the queries: one answer can take a minute


@dataclass
class Row:
    """Results of one planner: lengths (m) by scene, wall-clock and CPU seconds."""

    name: str
    lengths: dict[int, float] = field(default_factory=dict)
    passed: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    infeasible: int | None = None  # None: not checked
    colliding: int = 0

    def timed(self, call: Callable[[], Any]) -> Any:
        begun, worked = time.perf_counter(), time.process_time()
        found = call()
        self.passed.append(time.perf_counter() - begun)
        self.cpu.append(time.process_time() - worked)
        return found


def ours(row: Row, number: int, scene: Case, seconds: float, patience: float = PATIENCE, reverse: bool = True,
         runs: int = 1) -> None:  # fmt: skip
    """Plan a scene several times with other random numbers; the length is the mean. One failure fails the scene."""
    lengths = [one_of_ours(row, scene, seconds, patience, reverse) for _ in range(runs)]
    if all(lengths):
        row.lengths[number] = mean(lengths)


def one_of_ours(row: Row, scene: Case, seconds: float, patience: float, reverse: bool, pose: bool = True) -> float:
    """Return the path's length (m), 0 without a path. Without `pose` the car may have any heading at the goal.

    `seconds` and `patience` are CPU time.
    """
    world = scene.world(reverse, seed=None)
    asked = CarJudge("rrt" if seconds == 0.0 else "rrt-smoothed", world)
    goal, heading = Point(scene.goal[0], scene.goal[1], 0.0), scene.goal[2] if pose else None
    with mock.patch("targets.planning.limit.time", SimpleNamespace(perf_counter=time.process_time)):
        answer = row.timed(lambda: ask(asked, scene.start, goal, seconds=seconds, heading=heading, patience=patience))
    if not answer.path:
        return 0.0
    found = curve(answer)
    path = segments(found)
    row.infeasible = (row.infeasible or 0) + bool(infeasible(world, path))
    row.colliding += bool(collisions(world, path))
    return found.length


def in_rooms(kinds: dict[str, Any], quick: bool) -> list[Row]:
    """Return the rows of queries in rooms with walls."""
    first = Row("ours, first path")
    rows = {budget: Row(f"ours, planner_budget {budget:g}") for budget in BUDGETS}
    strangers = {name: Row(name) for name in kinds}
    queries = list(solvable())[:: QUICK_STEP if quick else 1]
    for number, (seed, i) in enumerate(queries):
        query = room(seed).queries[i]
        scene = Case(query.start, (*query.goal, query.heading), room(seed).walls)
        for row, seconds, patience in [(first, 0.0, PATIENCE), *((rows[b], SHARE * b, 0.0) for b in BUDGETS)]:
            length = one_of_ours(row, scene, seconds, patience, reverse=True, pose=False)
            if length:
                row.lengths[number] = length
        if number % PEERS_STEP == 0:
            for name, kind in kinds.items():
                theirs(strangers[name], kind, number, scene)
    found = [first, *rows.values()]
    table(found, len(queries))
    if kinds:
        table([*strangers.values()], len(queries[::PEERS_STEP]))
    return [*found, *strangers.values()]


def peers(path: str) -> dict[str, Any]:
    """Return PythonRobotics' two planners."""
    import matplotlib

    matplotlib.use("Agg")
    sys.path[:0] = [path, f"{path}/PathPlanning"]
    from PathPlanning.RRTDubins.rrt_dubins import RRTDubins  # type: ignore[import-not-found]
    from PathPlanning.RRTStarReedsShepp.rrt_star_reeds_shepp import RRTStarReedsShepp  # type: ignore[import-not-found]

    return {"PythonRobotics, Dubins RRT": RRTDubins, "PythonRobotics, Reeds-Shepp RRT*": RRTStarReedsShepp}


def discs(bodies: tuple[Obstacle, ...]) -> list[tuple[float, float, float]]:
    """Return discs inside bodies; a box gets a row of discs that touch each other."""
    found = []
    for body in bodies:
        match body:
            case Block(lo, hi):
                wide, high = hi.x - lo.x, hi.y - lo.y
                size = min(wide, high)
                count = max(1, round(max(wide, high) / size))
                for k in range(count):
                    share = (k + 0.5) / count
                    x = lo.x + (share * wide if wide > high else wide / 2)
                    y = lo.y + (share * high if high >= wide else high / 2)
                    found.append((x, y, size / 2))
            case Cylinder(base, radius, _):
                found.append((base.x, base.y, radius))
    return found


def theirs(row: Row, kind: Any, number: int, scene: Case) -> None:
    """Plan with PythonRobotics. Its poses are at most 0.2 m apart, and only these are checked."""
    random.seed(number)
    lo, hi = scene.world().arena.lo, scene.world().arena.hi
    planner = kind(
        list(scene.start), list(scene.goal), discs(scene.obstacles), [lo.x, hi.y], max_iter=ITERATIONS,
        robot_radius=CAR.width / 2 + CAR.clearance,
    )  # fmt: skip
    planner.curvature = 1 / CAR.planned_radius
    with contextlib.redirect_stdout(io.StringIO()):
        found = row.timed(lambda: planner.planning(animation=False, search_until_max_iter=False))
    if not found:
        return
    row.lengths[number] = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(found))
    row.colliding += any(collides(scene.world(), *pose) for pose in headed(found))


def headed(path: list[list[float]]) -> Iterator[list[float]]:
    """Return the poses of a path whose points are listed from goal to start; a forward path lists positions only."""
    for after, at in pairwise(path):
        if len(at) > 2:
            yield at
        elif at[:2] != after[:2]:
            yield [*at[:2], math.atan2(after[1] - at[1], after[0] - at[0])]


def table(rows: list[Row], count: int) -> None:
    print(f"{'':34}   found  median ms (CPU)     p90 ms (CPU)   mean m  infeasible  colliding or outside")
    for row in rows:
        late = sorted(zip(row.passed, row.cpu, strict=True))[int(0.9 * len(row.cpu))]
        length = mean(row.lengths.values()) if row.lengths else math.nan
        middle = f"{median(row.passed) * 1e3:8.1f} ({median(row.cpu) * 1e3:6.1f})"
        sharp = "-" if row.infeasible is None else str(row.infeasible)
        print(
            f"{row.name:34} {len(row.lengths):3d}/{count:3d} {middle} {late[0] * 1e3:8.1f} ({late[1] * 1e3:6.1f})"
            f" {length:7.2f} {sharp:>8} {row.colliding:10d}"
        )


def ratios(rows: list[Row], against: Row) -> dict[str, float]:
    """Return mean lengths relative to another planner, over the scenes that both solve."""
    found = {}
    for row in rows:
        both = row.lengths.keys() & against.lengths.keys()
        if row is not against and both:
            found[row.name] = sum(row.lengths[i] for i in both) / sum(against.lengths[i] for i in both)
            print(f"length of {row.name} over {against.name}: {found[row.name]:.3f} ({len(both)} scenes)")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer scenes")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--pythonrobotics", metavar="PATH")
    options = parser.parse_args()
    count = QUICK if options.quick else SCENES
    scenes = {seed: case(seed) for seed in range(count)}
    first, short, forward = Row("ours, first path"), Row("ours, 40 ms"), Row("ours, without reverse")
    rows = [first, short, forward]
    lattice = Row("exhaustive lattice")
    kinds = peers(options.pythonrobotics) if options.pythonrobotics else {}
    strangers = [Row(name) for name in kinds]
    for number, scene in scenes.items():
        ours(first, number, scene, 0.0)
        ours(short, number, scene, BUDGET, runs=1 if options.quick else RUNS)
        ours(forward, number, scene, BUDGET, 0.3, reverse=False)
        pieces = lattice.timed(partial(Lattice(scene.world()).solved, scene.start, scene.goal))
        if pieces is not None:
            lattice.lengths[number] = sum(abs(way) for _, way in pieces)
        for row, kind in zip(strangers, kinds.values(), strict=True):
            theirs(row, kind, number, scene)
    rows += [lattice, *strangers]
    table(rows, count)
    solvable = set(lattice.lengths)
    missed = sorted(solvable - set(first.lengths)) + sorted(solvable - set(short.lengths))
    print(f"the lattice solves {len(solvable)} of {count}; of these, not solved by ours: {missed or 'none'}")
    found = {row.name: ratios([first, short, lattice], row) for row in [*strangers, lattice]}
    print("rooms with walls:")
    rooms = in_rooms(kinds, options.quick)
    if options.json:
        told = {
            "rows": [
                {
                    "name": row.name, "found": len(row.lengths), "median_s": median(row.passed),
                    "median_cpu_s": median(row.cpu), "infeasible": row.infeasible, "colliding": row.colliding,
                }
                for row in [*rows, *rooms]
            ],
            "ratios": found,
            "missed": missed,
        }  # fmt: skip
        FilePath(options.json).write_text(json.dumps(told, indent=1), encoding="utf-8")
    wrong = sum((row.infeasible or 0) + row.colliding for row in (first, short, forward, *rooms[: 1 + len(BUDGETS)]))
    return 1 if missed or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
