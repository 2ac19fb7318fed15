"""Runs in which nothing goes on: tasks that nobody can do are told, not waited for."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.fixtures.fleet import NAMES
from koordgen.runtime.values.points import Point
from targets.sim.judging.idle import Idle, same
from tests.sim.judging.watched import Watched

TASKS = """\
using Motion:
  sensors: Point position
  actuators: Point target
using Log:
  stream stdout
allread: Point at[N_SYS]
allwrite: List<Point> tasks = [Point(0, 0, 0), Point(0, 0, 99)]
local:
  bool busy
  int turns
Take:
  pre: pid == 0 and not busy and len(tasks) > 0 and tasks[0].z < 9
  eff: atomic:
    Motion.target = tasks[0]
    tasks.pop(0)
    busy = True
Arrive:
  pre: busy and distance(Motion.position, Motion.target) < 0.1
  eff: busy = False
Look:  # enabled in every round, and writes a place that is never quite the same
  pre: not busy
  eff:
    at[pid] = Motion.position + Point(0.001 * pid, 0, 0)
Tick:
  pre: TICKS
  eff: turns += 1
"""


def tasks(tmp_path: Path, timeout: float, ticks: bool = False, stops: bool = False) -> Watched:
    text = TASKS.replace("TICKS", str(ticks))
    if ticks:
        text = text.replace("pre: not busy\n", "pre: False\n")
    if stops:
        text = text.replace("at[pid] = Motion.position + Point(0.001 * pid, 0, 0)", "stop")
    watched = Watched(tmp_path, text, n=2)
    idle = Idle(NAMES[:2], timeout)
    idle.launched(watched.run_)
    watched.companions.append(idle)
    return watched


def test_a_task_that_nobody_takes_ends_the_run_with_a_word_of_it(tmp_path: Path) -> None:
    watched = tasks(tmp_path, 3.0)
    watched.moved = lambda pid, t, place: place + Point(0.05 * (int(10 * t) % 2), 0, 0)
    watched.run(30.0)
    (found,) = watched.violations()
    assert watched.run_.finished == "idle" and found.what == "idle" and found.robots == ("alice", "bert")
    assert 3.0 < watched.t(found) < 6.0, "since the first task was done, 4.3 m away at 1 m/s"
    assert "for 3 s" in found.detail and "alice: Look; bert: Look" in found.detail
    t = watched.fleet.time.time - (watched.run_.zero or 0.0)
    assert t == pytest.approx(watched.t(found) + 3.0, abs=0.2)


@pytest.mark.parametrize(("timeout", "ticks", "stops"), [(0.0, False, False), (3.0, True, False), (3.0, False, True)])
def test_what_goes_on_or_has_stopped_is_not_idle(tmp_path: Path, timeout: float, ticks: bool, stops: bool) -> None:
    watched = tasks(tmp_path, timeout, ticks, stops).run(11.0)
    assert not watched.run_.finished and not watched.violations()


def test_numbers_are_the_same_but_for_little() -> None:
    assert same([1.0, "a", [2.05]], [1.1, "a", [2.0]]) and not same([1.0], [1.25])
    assert not same(1, 2) and same(1, 1) and not same(True, False) and not same(None, 0.0) and not same([1], [1, 2])
