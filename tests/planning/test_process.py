"""The planner's own process, for real: killed, hanging, raising, printing, answering rubbish; and the agent's end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path as FilePath

import pytest

from koordgen.runtime.config.settings import Box
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Grid, Point
from koordgen.runtime.vehicle.platform import Unready
from targets.planning import process
from targets.planning.process import Beside, Inside, made
from targets.planning.world import Scene, World

ROOT = FilePath(__file__).parents[2]
WORLD = World(Box(Point(-5, -4, 0.5), Point(5, 4, 3)), (Block(Point(-0.2, -4, 0), Point(0.2, 0.5, 3)),), 0.1, 0.2)
START = Point(-4.0, 2.0, 1.5)
EASY, LATE, GONE = Point(4.0, 0.95, 1.5), Point(4.0, 2.0, 1.5), Point(4.0, 3.5, 1.5)


@contextmanager
def beside(name: str, budget: float = 0.05, world: World = WORLD) -> Iterator[Beside]:
    planning = Beside(name, world, budget)
    try:
        made(planning, time.sleep)
        yield planning
    finally:
        planning.close()


def until(planning: Beside, holds: Callable[[], bool], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come about"
        planning.poll()
        time.sleep(0.01)


def alive(pid: int) -> bool:
    try:
        return FilePath(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_it_answers_as_one_in_the_same_process_does() -> None:
    goal = Point(4.0, -2.0, 1.5)
    world = World(WORLD.arena, WORLD.obstacles, WORLD.clearance, WORLD.radius, seed=3, iterations=500)
    inside = Inside("rrt-smoothed", world, 0.05)
    inside.start()
    with beside("rrt-smoothed", budget=1.0, world=world) as planning:
        path = planning.plan(START, goal, Scene())
        assert len(path) > 2 and path == inside.plan(START, goal, Scene())
        assert planning.log_lines() == inside.log_lines() == []
        pid = planning.pid
    assert not alive(pid)


def test_a_large_scene_goes_through_the_pipe() -> None:
    cells = tuple(Grid(i, j, 0.05) for i in range(-2, 2) for j in range(-500, -100)) + tuple(
        Grid(2 * i, 90 + 2 * j, 0.05) for i in range(60) for j in range(60)
    )
    with beside("rrt", budget=2.0) as planning:
        assert planning.plan(START, EASY, Scene(grids=cells)) or planning.log_lines()
        assert planning.ready


def test_one_that_is_killed_is_begun_anew_and_told() -> None:
    with beside("straight") as planning:
        assert planning.plan(START, EASY, Scene()) == (START, EASY)
        os.kill(planning.pid, signal.SIGKILL)
        until(planning, lambda: not planning.ready)
        assert planning.plan(START, EASY, Scene()) == ()
        assert planning.log_lines() == [
            "the planner ended by itself; it is started again", "no path: the planner is not running",
        ]  # fmt: skip
        until(planning, lambda: planning.ready)
        assert planning.plan(START, EASY, Scene()) == (START, EASY)


def test_one_that_is_late_does_not_keep_the_agent_and_its_late_answer_is_dropped() -> None:
    with beside("tests.planning.own:Sleeps", budget=0.05) as planning:
        pid = planning.pid
        began = time.monotonic()
        assert planning.plan(START, LATE, Scene()) == ()
        assert time.monotonic() - began < 0.15
        assert planning.plan(START, EASY, Scene()) == ()
        assert planning.log_lines() == [
            "no path: the planner did not answer within 50 ms", "no path: the planner is still at the last question",
        ]  # fmt: skip
        time.sleep(0.3)
        assert planning.plan(START, EASY, Scene()) == (START, EASY), "and not what was late"
        assert planning.pid == pid


def test_one_that_hangs_is_ended_and_begun_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "PATIENCE", 0.3)
    with beside("tests.planning.own:Sleeps", budget=0.05) as planning:
        pid = planning.pid
        assert planning.plan(START, GONE, Scene()) == ()
        until(planning, lambda: not planning.ready)
        until(planning, lambda: not alive(pid))
        assert planning.log_lines()[-1] == "the planner has not answered for 0.3 s; it is started again"
        until(planning, lambda: planning.ready)
        assert planning.plan(START, EASY, Scene()) == (START, EASY)


def test_one_that_raises_goes_on_and_says_why() -> None:
    with beside("tests.planning.own:Raises") as planning:
        assert planning.plan(START, EASY, Scene()) == ()
        assert planning.log_lines() == ["no path: the planner failed: RuntimeError: no map"]
        assert planning.ready


@pytest.mark.parametrize("name", ["Nan", "Elsewhere", "Outside", "Text", "Short"])
def test_rubbish_is_refused(name: str) -> None:
    with beside(f"tests.planning.own:{name}") as planning:
        assert planning.plan(START, EASY, Scene()) == ()
        (told,) = planning.log_lines()
        assert "the planner's path was refused" in told


def test_one_that_leaves_and_prints(capfd: pytest.CaptureFixture[str]) -> None:
    with beside("tests.planning.own:Ends") as planning:
        assert planning.plan(START, EASY, Scene()) == (START, EASY), "what it prints is no answer"
        assert planning.plan(START, LATE, Scene()) == ()
        assert planning.log_lines() == ["the planner ended by itself; it is started again"]
        until(planning, lambda: planning.ready)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("tests.planning.own:Refuses", "RuntimeError: no licence"),
        ("tests.planning.own:Nobody", "AttributeError"),
        ("tests.planning.nowhere:Nobody", "ModuleNotFoundError"),
    ],
)
def test_one_that_cannot_be_made_keeps_the_robot_from_starting(name: str, said: str) -> None:
    planning = Beside(name, WORLD, 0.05)
    with pytest.raises(Unready, match=said):
        made(planning, time.sleep)
    assert planning.pid == 0
    planning.close()
    with pytest.raises(Unready, match=said):
        Inside(name, WORLD, 0.05).start()


def test_a_call_that_is_interrupted_leaves_no_half_message() -> None:
    """An event that is out of time is ended by an exception, wherever it is."""

    class OutOfTime(BaseException):
        pass

    def ring(number: int, frame: object) -> None:
        raise OutOfTime

    before = signal.signal(signal.SIGALRM, ring)
    try:
        with beside("tests.planning.own:Sleeps", budget=1.0) as planning:
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            with pytest.raises(OutOfTime):
                planning.plan(START, LATE, Scene())
            until(planning, lambda: planning.ready)
            assert planning.plan(START, EASY, Scene()) == (START, EASY)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


AGENT = """
import sys, time
from tests.planning.test_process import START, EASY, GONE, WORLD
from targets.planning.process import Beside, made
from targets.planning.world import Scene
planning = Beside(sys.argv[1], WORLD, 0.05)
made(planning, time.sleep)
assert planning.plan(START, EASY, Scene())
if sys.argv[2] == "hanging":
    planning.plan(START, GONE, Scene())
print(planning.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("state", ["idle", "hanging"])
def test_the_end_of_the_agent_ends_it(state: str) -> None:
    """Killed, so that it can tell nobody; also while the planner does not come back from a call."""
    command = [sys.executable, "-c", AGENT, "tests.planning.own:Sleeps", state]
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, env=surroundings) as agent:
        assert agent.stdout is not None
        child = int(agent.stdout.readline())
        assert alive(child)
        agent.kill()
    end = time.monotonic() + 5.0
    while alive(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not alive(child)


def test_a_reason_is_told_once_until_there_is_a_path_again() -> None:
    inside = Inside("straight", WORLD, 0.05)
    inside.start()
    for x in (-0.1, 0.0, 0.1):
        assert inside.plan(START, Point(x, 0.0, 1.5), Scene()) == ()
    assert inside.log_lines() == ["no path: the goal is too near to obstacle 0"]
    assert inside.plan(START, Point(9.0, 0.0, 1.5), Scene()) == ()
    assert inside.log_lines() == ["no path: the goal is outside the arena"]
    assert inside.plan(START, EASY, Scene()) == (START, EASY)
    assert inside.plan(START, Point(0.0, 0.0, 1.5), Scene()) == () and len(inside.log_lines()) == 1


def test_a_judge_that_misses_a_package_says_what_to_do() -> None:
    with pytest.raises(Unready, match=r"No module named 'no_such_package'; install the bundle's requirements\.txt"):
        Inside("rrt", WORLD, 0.05, "no_such_package:Judge").start()
