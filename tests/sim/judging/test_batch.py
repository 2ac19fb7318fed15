"""Many moments at once: what is surely so is so, and most of what holds is seen at once."""

from __future__ import annotations

import time
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from koordgen.runtime.program.property import UNKNOWN, Properties, judged
from koordgen.runtime.values.points import Point
from targets.sim.judging import watch
from targets.sim.judging.batch import Batch
from tests.sim.run.fake_fleet import beside

HEAD = """\
param float eps = 0.5
param Point lo = Point(-1, -1, 0)
param Point hi = Point(1, 1, 2)
using Motion:
  sensors:
    Point position
    Point velocity
    bool reached
  actuators: Point target
allread:
  Point x[N_SYS]
  List<Point> way[N_SYS]
allwrite:
  float sum
  int least
local:
  bool on
  int mine
E:
  pre: True
  eff: pass
"""
SURE = [
    "forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > eps",
    "forall i in ID: Motion.position[i] in Rect(lo, hi) and x[i] in Rect(hi, lo)",
    "forall i in ID: not on[i] or Motion.position[i] in Ball(x[i] / 2, 2 * eps)",
    "not exists i in ID: on[i] and not Motion.position[i] in Rect(lo, hi)",
    "forall i in ID: not (Motion.position[i] in Ball(lo, eps)) or Motion.reached[i]",
    "exists i in ID: Motion.position[i].x + 1 >= sum and mine[i] >= least - 1",
    "forall i in ID: exists j in ID: i != j and Motion.velocity[j].z * 2 < -Motion.position[i].y + 1",
    "not forall i in ID: on[i] == Motion.reached[i] or Motion.position[i].y > sum",
    "forall i in ID: N_SYS > 2 and distance(Point(sum, Motion.position[i].y, 0), Motion.target[i]) < 3",
]
BEYOND = [
    "forall i in ID: not (Motion.position[i] in Ball(lo + hi, eps)) or Motion.reached[i]",  # lo + hi may be infinite
    "forall i in ID: Motion.position[i] == x[i]",
    "forall i in ID: sum / Motion.position[i].x > 1",
    "forall i in ID: sqrt(Motion.position[i].x) > 1",
    "forall i in range(1, N_SYS): Motion.position[i].x > Motion.position[i - 1].x",
    "forall i in ID: path_distance(way[i], [Motion.position[i]]) < 1",
    "Motion.position[0].x > 0",
]
N = 4


def properties(root: Path, *formulas: str) -> Properties:
    beside(root, HEAD + "".join(f"invariant P{k}: {formula}\n" for k, formula in enumerate(formulas)))
    return watch.load_fleet(root, 1)[0].properties


def place(rng: Random) -> Point:
    """Often on an edge, or within what arrays round of it."""
    return Point(*(rng.choice((-1.0, 0.0, 0.5, 1.0)) + rng.choice((0.0, 0.0, 1e-16, 0.3)) for _ in range(3)))


def values(rng: Random) -> dict[str, Any]:
    return {
        "x": [place(rng) for _ in range(N)], "Motion.target": [place(rng) for _ in range(N)],
        "Motion.reached": [rng.random() < 0.5 for _ in range(N)], "on": [rng.random() < 0.5 for _ in range(N)],
        "mine": [rng.randrange(3) for _ in range(N)], "sum": rng.choice((0.0, 0.5, 1.0)), "least": rng.randrange(3),
        "way": [()] * N,
    }  # fmt: skip


def arrays(moments: list[dict[str, list[Point]]]) -> dict[str, Any]:
    return {n: np.array([[(p.x, p.y, p.z) for p in moment[n]] for moment in moments]) for n in moments[0]}


def test_what_is_surely_so_is_so(tmp_path: Path) -> None:
    found, rng = properties(tmp_path, *SURE), Random(7)
    held, sure = [0] * len(SURE), [0] * len(SURE)
    for _ in range(60):
        of_round = values(rng)
        names = ("Motion.position", "Motion.velocity")
        moments = [{name: [place(rng) for _ in range(N)] for name in names} for _ in range(5)]
        known = found.fleet(N, None)
        for k, property_ in enumerate(found.properties):
            assert property_.screening is not None, SURE[k]
            unsure = Batch(len(moments), N, arrays(moments), of_round).unsure(property_.screening)
            for m, moment in enumerate(moments):
                known.put({**of_round, **moment})
                outcome, why = judged(property_.holds, known)
                assert outcome in ("held", "violated"), why
                held[k] += outcome == "held"
                sure[k] += m not in unsure
                assert m in unsure or outcome == "held", (SURE[k], moment, of_round)
    assert sum(held) < 0.9 * 300 * len(SURE) and sum(sure) > 0.7 * sum(held), (sure, held)
    assert sum(s > 0 for s in sure) >= len(SURE) - 1, "but for what is held on an edge only"


ASSUMED = [
    "position' in Rect(position, target) or position' in Ball(target, 0.5)",
    "distance(position', target) <= distance(position, target) + 0.01",
    "pid != 0 or not (position'.z > target.z) or reached",
]


def test_what_surely_is_of_each_robot_is(tmp_path: Path) -> None:
    lines = "".join(f"  assume {formula}\n" for formula in ASSUMED)
    beside(tmp_path, HEAD.replace("allread:\n", f"{lines}allread:\n", 1))
    found, rng = watch.load_fleet(tmp_path, 1)[0].properties, Random(3)
    held = sure = 0
    for _ in range(60):
        before = values(rng) | {"Motion.position": [place(rng) for _ in range(N)]}
        later = [{"Motion.position'": [place(rng) for _ in range(N)]} for _ in range(4)]
        for assumption in found.assumptions:
            assert assumption.screening is not None
            unsure = Batch(4, N, arrays(later), before).unsure_of(assumption.screening)
            for m, moment in enumerate(later):
                for pid in range(N):
                    known = found.step(N, None)
                    known.pid = pid
                    known.put({name: v[pid] for name, v in {**before, **moment}.items() if name.startswith("Motion")})
                    outcome, why = judged(assumption.holds_of_calls, known)
                    assert outcome in ("held", "violated"), why
                    assert (m, pid) in unsure or outcome == "held"
                    held, sure = held + (outcome == "held"), sure + ((m, pid) not in unsure)
    assert 0.5 * held < sure < held < 0.9 * 60 * 4 * N * len(ASSUMED), (sure, held)


def test_what_has_no_such_form_has_none(tmp_path: Path) -> None:
    assert [p.screening for p in properties(tmp_path, *BEYOND).properties] == [None] * len(BEYOND)


def test_what_is_not_known_is_not_sure(tmp_path: Path) -> None:
    (found,) = properties(tmp_path, SURE[2]).properties
    of_round = {**values(Random(1)), "on": [False, UNKNOWN, False, False]}
    moment = {"Motion.position": [Point()] * N, "Motion.velocity": [Point()] * N}
    assert found.screening is not None
    assert Batch(2, N, arrays([moment, moment]), of_round).unsure(found.screening) == [0, 1]


@pytest.mark.parametrize("n", [25])
def test_many_moments_at_once_cost_little(tmp_path: Path, n: int) -> None:
    """Beside asking one by one, in the same run."""
    found = properties(tmp_path, SURE[0])
    (apart,) = found.properties
    assert apart.screening is not None
    places = [Point(2.0 * k, 0.0, 0.0) for k in range(n)]
    moments = [{"Motion.position": places}] * 24
    known = found.fleet(n, None)
    began = time.process_time()
    for moment in moments:
        known.put(moment)
        assert judged(apart.holds, known)[0] == "held"
    one_by_one = time.process_time() - began
    began = time.process_time()
    for _ in range(10):
        assert not Batch(24, n, arrays(moments), {}).unsure(apart.screening)
    assert (time.process_time() - began) / 10 < one_by_one / 4
