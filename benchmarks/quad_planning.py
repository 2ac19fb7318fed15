"""Planning in 20 seeded arenas of 7 x 8 x 3 m, 8 to 20 obstacles of all kinds: success, time, length, collisions.

`python benchmarks/quad_planning.py [--quick] [--json FILE] [--peer PATH]`. PATH is a checkout of
github.com/motion-planning/rrt-algorithms (it needs rtree), whose RRT-Connect then plans the same ways in the same run,
with the same distances, looked at every 5 cm of a line. An arena counts as solvable when an exhaustive search of a
lattice of 0.2 m with exact lines finds a way; that way, pulled tight, is the length to compare with. Collisions are
looked for by python-fcl, as capsules around each part of a path. Ratios are printed; nothing of time is
asserted. "of CPU" is what a run on an idle machine would take.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from itertools import pairwise
from pathlib import Path as FilePath
from statistics import median
from typing import Any

sys.path.insert(0, str(FilePath(__file__).parents[1]))

import fcl
import numpy as np

from benchmarks.fixtures.arenas import (
    ARENA,
    CLEARANCE,
    GOAL,
    KEPT,
    NOWHERE,
    RADIUS,
    START,
    Checker,
    Fine,
    arena,
    capsule,
    many,
)  # fmt: skip
from koordgen.runtime.values.obstacles import Obstacle
from koordgen.runtime.values.points import Point, distance
from targets.planning.ask import PlannerJudge
from targets.planning.room import Room, fixed, room
from targets.planning.rrt import length
from targets.planning.world import Path, World


def tight(path: Path, here: Room) -> float:
    """Return the length (m) of a path after shortening it by many random short cuts."""
    dice, points = random.Random(1), list(path)
    for _ in range(3000):
        lengths = np.cumsum([0.0, *(distance(p, q) for p, q in pairwise(points))])
        ends = sorted(dice.uniform(0.0, float(lengths[-1])) for _ in range(2))
        i, j = (min(int(np.searchsorted(lengths, end, "right")) - 1, len(points) - 2) for end in ends)
        p, q = (
            points[k] + (points[k + 1] - points[k]) * ((end - lengths[k]) / max(lengths[k + 1] - lengths[k], 1e-12))
            for k, end in zip((i, j), ends, strict=True)
        )
        if i < j and here.clear(p, q):
            points = [*points[: i + 1], p, q, *points[j + 1 :]]
    return length(tuple(points))


def peer(path: str | None, bodies: tuple[Obstacle, ...], seed: int) -> Path | None:
    """Return the peer's path, or None. It checks our obstacles by their distances from points."""
    if path not in sys.path and path is not None:
        sys.path.insert(0, path)
    from rrt_algorithms.rrt.rrt_connect import RRTConnect  # type: ignore[import-not-found]
    from rrt_algorithms.search_space.search_space import SearchSpace  # type: ignore[import-not-found]

    things = fixed(bodies)
    here = Room(START)
    here.keep(things, KEPT)

    class Ours(SearchSpace):  # type: ignore[misc]
        def obstacle_free(self, x: Any) -> bool:
            p = Point(float(x[0]), float(x[1]), float(x[2]))
            return here.clear(p, p)

    np.random.seed(seed)
    lo, hi = ARENA.lo, ARENA.hi
    space = Ours(np.array([(lo.x, hi.x), (lo.y, hi.y), (lo.z, hi.z)]))
    start, goal = (START.x, START.y, START.z), (GOAL.x, GOAL.y, GOAL.z)
    found = RRTConnect(space, 0.5, start, goal, 4096, 0.05, 0.0).rrt_connect()
    return tuple(Point(*map(float, p)) for p in found) if found else None


def checks(bodies: tuple[Obstacle, ...]) -> dict[str, float]:
    """Return microseconds to check a line of random length: ours (exact), and python-fcl's capsule and manager."""
    source = random.Random(1)
    lo, hi = ARENA.lo, ARENA.hi
    ends = [
        Point(source.uniform(lo.x, hi.x), source.uniform(lo.y, hi.y), source.uniform(lo.z, hi.z)) for _ in range(2001)
    ]
    near = [(p, p + (q - p) * min(1.0, 1.0 / max(distance(p, q), 1e-9))) for p, q in pairwise(ends)]
    here = Room(START)
    here.keep(fixed(bodies), KEPT)
    began = time.process_time()
    ours = [here.clear(p, q) for p, q in near]
    middle = time.process_time()
    manager = fcl.DynamicAABBTreeCollisionManager()
    manager.registerObjects(Checker(bodies).objects)
    manager.setup()
    theirs = []
    for p, q in near:
        data = fcl.CollisionData()
        manager.collide(capsule(p, q, KEPT), data, fcl.defaultCollisionCallback)
        theirs.append(not data.result.is_collision)
    end = time.process_time()
    differ = sum(a != b for a, b in zip(ours, theirs, strict=True))
    return {"exact, us": (middle - began) / 2e-3, "fcl, us": (end - middle) / 2e-3, "differ": differ}


def plans(seeds: list[int], peer_path: str | None) -> tuple[list[dict[str, Any]], list[int]]:
    """Return a row for each solvable arena, and the seeds of the others."""
    rows, unsolvable = [], []
    for seed in seeds:
        bodies = arena(seed)
        world = World(ARENA, bodies, CLEARANCE, RADIUS)
        here = room(world, fixed(bodies), NOWHERE, START)
        lattice = Fine(world).plan(START, GOAL, NOWHERE, 0.0)
        if not lattice:
            unsolvable.append(seed)
            continue
        row: dict[str, Any] = {"seed": seed, "obstacles": len(bodies), "lattice": tight(lattice, here)}
        checker = Checker(bodies)
        for name, seconds in (("rrt", 0.04), ("rrt-smoothed", 0.007), ("rrt-smoothed", 0.04), ("rrt-star", 0.04)):
            asked = PlannerJudge(name, world)
            asked.answer(START, GOAL, NOWHERE, 0.001)
            began, worked = time.perf_counter(), time.process_time()
            path, _ = asked.answer(START, GOAL, NOWHERE, seconds)
            took, cpu = time.perf_counter() - began, time.process_time() - worked
            key = f"{name} {seconds * 1e3:.0f} ms"
            row[key] = {
                "ms": took * 1e3,
                "cpu": cpu * 1e3,
                "m": length(path),
                "collides": bool(path) and checker.collides(path),
            }
        if peer_path is not None:
            began, worked = time.perf_counter(), time.process_time()
            theirs = peer(peer_path, bodies, seed)
            took, cpu = time.perf_counter() - began, time.process_time() - worked
            row["peer"] = {
                "ms": took * 1e3,
                "cpu": cpu * 1e3,
                "m": length(theirs or ()),
                "collides": checker.collides(theirs or ()),
            }
        rows.append(row)
        if sys.stderr.isatty():
            print(f"\r{len(rows) + len(unsolvable)} of {len(seeds)} arenas", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return rows, unsolvable


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="five arenas, 100 ways")
    parser.add_argument("--json", type=FilePath, metavar="FILE")
    parser.add_argument("--peer", metavar="PATH", help="a checkout of rrt-algorithms")
    options = parser.parse_args()
    seeds = list(range(5 if options.quick else 20))
    rows, unsolvable = plans(seeds, options.peer)
    straight = distance(START, GOAL)
    lattice = sum(row["lattice"] for row in rows) / len(rows)
    print(f"{len(rows)} of {len(seeds)} arenas are solvable (lattice of 0.2 m); not: {unsolvable or 'none'}")
    print(f"straight line {straight:.2f} m; lattice, pulled tight, mean {lattice:.2f} m\n")
    print(
        f"{'':24}{'found':>8}{'median ms':>11}{'of CPU':>8}{'most ms':>9}{'mean m':>8}{'/ lattice':>11}{'collide':>9}"
    )
    result: dict[str, Any] = {"rows": rows, "unsolvable": unsolvable}
    for key in [k for k in rows[0] if k not in ("seed", "obstacles", "lattice")]:
        got = [row for row in rows if row[key]["m"]]
        times, lengths = [row[key]["ms"] for row in rows], [row[key]["m"] for row in got]
        cpu = [row[key]["cpu"] for row in rows]
        ratio = sum(row[key]["m"] / row["lattice"] for row in got) / max(1, len(got))
        hits = sum(row[key]["collides"] for row in got)
        print(
            f"{key:24}{len(got):>5}/{len(rows)}{median(times):>11.2f}{median(cpu):>8.2f}{max(times):>9.1f}"
            f"{sum(lengths) / max(1, len(got)):>8.2f}{ratio:>11.3f}{hits:>9}"
        )
        result[key] = {
            "found": len(got),
            "median ms": median(times),
            "median CPU ms": median(cpu),
            "over lattice": ratio,
            "collide": hits,
        }
    if options.peer:
        sooner = result["peer"]["median CPU ms"] / result["rrt 40 ms"]["median CPU ms"]
        print(f"\nthe first path comes {sooner:.0f} times as soon as the peer's")
    found, colliding, none = many(seeds, 100 if options.quick else 1000)
    total = 100 if options.quick else 1000
    print(f"\n{total} random ways, 7 ms each: {found} found, {colliding} collide, {none} with start or goal not free")
    result |= {"ways": total, "found": found, "colliding": colliding, "not free": none}
    result["check"] = checks(arena(max(seeds)))
    print(f"a line of 1 m at most among {len(arena(max(seeds)))} obstacles:",
          ", ".join(f"{k} {v:.1f}" for k, v in result["check"].items()))  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
