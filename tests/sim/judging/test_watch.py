"""Properties over the truth of a run: what holds, who broke it and when, what left the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.net.network import Conditions
from koordgen.runtime.values.points import Point
from tests.sim.judging.watched import LINE, Watched

WHOLE = (
    LINE
    + """\
initially: forall i in ID: Motion.target[i] == Motion.position[i] and sum == 0 and mine[i] == 0
invariant Apart: forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 0.5
invariant Near: forall i in ID: distance(x[i], Motion.position[i]) < 1
invariant Counted: forall i in ID: mine[i] <= 6 and turns[0] == 0
"""
)
SUMS = "invariant Sum: sum <= 12\ninvariant First: sum == 0 or exists i in ID: mine[i] > 0\n"


def lined(tmp_path: Path, more: str = "", **options: Any) -> Watched:
    return Watched(tmp_path, WHOLE + more, **options)


def test_what_holds_is_held_at_every_step(tmp_path: Path) -> None:
    watched = lined(tmp_path).run(4.0)
    verdicts = watched.end()
    assert {v.outcome for v in verdicts.values()} == {"held"}, verdicts
    assert not watched.violations()
    rounds = watched.watcher._truth.round
    assert verdicts["Apart"].observations == pytest.approx(rounds * 25, abs=30), (
        "each physics step, twice where rounds meet"
    )
    assert verdicts["Counted"].observations == rounds + 1, "once a round, and before the first"
    assert verdicts["initially"].observations == 1
    assert watched.watcher.seconds > 0


def test_the_first_violation_is_told_with_its_time_and_the_robots(tmp_path: Path) -> None:
    watched = lined(tmp_path)
    watched.moved = lambda pid, t, place: Point(-4, -1.2, 0) if pid == 1 and t >= 1.0 else place
    watched.run(4.0)
    verdicts = watched.end()
    (found,) = [v for v in watched.violations() if v.name == "Apart"]
    assert found.what == "property" and found.robots == ("alice", "bert") and found.line == "a.koord:27"
    assert watched.t(found) == pytest.approx(1.0, abs=2 / 240)
    assert "Motion.position[1] = (-4, -1.2, 0)" in found.detail and "i = 0 (alice), j = 1 (bert)" in found.detail
    assert verdicts["Apart"].outcome == "violated" and verdicts["Apart"].since == pytest.approx(1.0, abs=0.01)
    assert verdicts["Counted"].outcome == "held"
    assert verdicts["Near"].robots == ("bert",)


def test_shared_and_own_values_are_those_after_each_round(tmp_path: Path) -> None:
    watched = lined(tmp_path, SUMS).run(6.0)
    verdicts = watched.end()
    (found,) = watched.violations()
    assert verdicts["Sum"].outcome == "violated" and found.robots == () and "sum = 13" in found.detail
    assert verdicts["First"].outcome == "held", "a commit's locals and its shared writes count at one time"
    records = [r for robot in watched.fleet.robots.values() for r in robot.records]
    first = min(r.round for r in records if r.frame is not None and r.frame.shared["sum"] == 13)
    assert watched.t(found) == pytest.approx((first - 2) * 0.1, abs=0.01), "from the moment of the round that wrote it"


@pytest.mark.parametrize("seed", range(3))
def test_the_store_is_that_of_the_agents_whatever_the_network_does(tmp_path: Path, seed: int) -> None:
    conditions = Conditions(loss=0.1, delay=0.001, jitter=0.02, duplication=0.1)
    watched = lined(tmp_path, seed=seed, conditions=conditions)
    truth, seen = watched.watcher._truth, 0
    advance = truth.advance

    def checked() -> None:
        nonlocal seen
        advance()
        for pid, robot in watched.fleet.robots.items():
            for record in robot.records:
                if record.round == truth.round + 1 and record.frame is not None:
                    seen += 1
                    shared = {name: list(v) if name in ("x", "turns") else v for name, v in record.frame.shared.items()}
                    assert {name: truth.values[name] for name in shared} == shared, (pid, record.round)
                    assert truth.values["mine"][pid] == record.frame.locals["mine"]

    truth.advance = checked  # type: ignore[method-assign]
    watched.run(6.0).end()
    assert seen > 40


def test_an_assumption_is_of_each_robot_over_each_round(tmp_path: Path) -> None:
    watched = lined(tmp_path)
    watched.moved = lambda pid, t, place: place + Point(0, 0, 5 * (t - 2.0)) if pid == 2 and t > 2.0 else place
    watched.run(4.0)
    watched.end()
    (found,) = [v for v in watched.violations() if v.name == "Motion"]
    assert found.robots == ("cleo",) and 2.0 < watched.t(found) < 2.2 and found.line == "a.koord:6"
    assert "Motion.position' = " in found.detail


def test_a_robot_that_leaves_the_model_is_no_violation(tmp_path: Path) -> None:
    watched = lined(tmp_path).run(3.0)
    watched.fleet.robots[1].agent.end("landing")
    since = watched.fleet.time.time - (watched.run_.zero or 0.0)
    watched.moved = lambda pid, t, place: Point(-4, -1.2, -3) if pid == 1 and t >= since else place
    watched.run(2.0)
    verdicts = watched.end()
    assert not watched.violations()
    assert verdicts["Apart"].outcome == verdicts["Near"].outcome == verdicts["Motion"].outcome == "out of model"
    assert verdicts["Apart"].since == pytest.approx(since, abs=0.02) and "bert" in verdicts["Apart"].detail
    assert verdicts["Counted"].outcome == "held", "its variables are what they are"


def test_the_others_are_watched_on_when_one_has_left(tmp_path: Path) -> None:
    watched = lined(tmp_path).run(3.0)
    watched.fleet.robots[1].agent.end("landing")
    watched.run(0.5)
    watched.moved = lambda pid, t, place: Point(-4, -1.2, 0) if pid == 2 else place
    watched.run(1.0)
    assert watched.end()["Apart"].robots == ("alice", "cleo")


def test_a_robot_that_dies_has_left_the_model(tmp_path: Path) -> None:
    watched = lined(tmp_path).run(2.0)
    dead = watched.fleet.robots[2]
    dead.wake = 1e9
    watched.run_.agents[2].alive = False
    watched.run(3.0)
    verdicts = watched.end()
    assert verdicts["Apart"].outcome == "out of model" and verdicts["Counted"].outcome == "held"
    assert verdicts["Counted"].observations > 30, "the run goes on, and so does the watch"


def test_a_fleet_that_has_stopped_has_not_left_the_model(tmp_path: Path) -> None:
    text = WHOLE + "invariant Never: sum >= 0\nDone:\n  pre: True\n  eff: stop\n"
    watched = Watched(tmp_path, text.replace("pid == 1 and N_SYS > 2", "False")).run(8.0)
    assert all(robot.agent.phase == "stopped" for robot in watched.fleet.robots.values())
    assert {v.outcome for v in watched.end().values()} == {"held"}


def test_what_has_no_value_and_what_cannot_be_asked(tmp_path: Path) -> None:
    more = (
        "spec fun calm(Point p) -> bool\ninvariant Calm: forall i in ID: calm(x[i])\n"
        "invariant Beyond: 1 / (3 - sum) < 2\n"
    )
    watched = lined(tmp_path, more).run(3.0)
    verdicts = watched.end()
    assert verdicts["Calm"].outcome == "unchecked" and "calm (line 30)" in verdicts["Calm"].detail
    assert verdicts["Beyond"].outcome == "no value" and "division by zero" in verdicts["Beyond"].detail
    (found,) = watched.violations()
    assert found.detail.startswith("invariant Beyond has no value: ")


def test_a_mission_that_never_began_has_shown_nothing(tmp_path: Path) -> None:
    verdicts = lined(tmp_path).run(0.05).end()
    assert {v.outcome for v in verdicts.values()} == {"unchecked"}


LOOPS = """\
Turn:
  pre: turns[pid] == 0 and mine > 0
  eff:
    for i in range(mine):
      invariant i < 1
      invariant mine >= old(mine)
      turns[pid] += 1
"""


def test_a_false_loop_invariant_is_a_violated_property(tmp_path: Path) -> None:
    text = LINE.replace("mine < 6", "mine < 3 and turns[pid] > 0 or mine == 0") + LOOPS
    line = text[: text.index("invariant i < 1")].count("\n") + 1
    watched = Watched(tmp_path, text).run(3.0)
    verdicts = watched.end()
    (found,) = watched.violations()
    assert (found.what, found.name, found.line) == ("property", f"line {line}", f"a.koord:{line}")
    assert found.detail.startswith(f"loop invariant line {line} does not hold: in the event Turn of {found.robots[0]}")
    verdict = verdicts[f"line {line}"]
    assert (verdict.of, verdict.outcome) == ("loop invariant", "violated") and f"line {line + 1}" not in verdicts
    assert verdict.since == pytest.approx(watched.t(found), abs=1e-6)
