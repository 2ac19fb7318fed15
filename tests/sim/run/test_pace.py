"""The world keeps up with the host's clock, and tells where it could not."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from targets.sim.base.scenario import load
from targets.sim.physics.world import STEP
from targets.sim.realtime import realtime
from targets.sim.realtime.realtime import BURST, MOST_BEHIND, Pace
from targets.sim.run.run import Run
from tests.sim.run.fake_fleet import bundle, enlist
from tests.sim.run.test_harness import sim, summary


def test_the_pace_keeps_absolute_ticks() -> None:
    pace = Pace(100.0, 0.25)
    assert pace.due(99.9) == 0
    assert [pace.due(now) for now in (100.0, 100.1, 100.24, 100.25, 100.5, 100.9)] == [1, 0, 0, 1, 1, 1]
    assert (pace.done, pace.late, pace.slip) == (4, 0, 0.0)


def test_the_pace_catches_up_what_is_little_and_slips_what_is_much() -> None:
    pace = Pace(0.0, 1 / 128)
    assert pace.due(10 / 128) == 11 and pace.late == 9
    assert pace.due(10.0) == BURST
    assert pace.slip == pytest.approx(10.0 - 11 / 128 - MOST_BEHIND)
    assert pace.factor(10.0) < 0.1


@pytest.mark.parametrize(("autopilot", "steps"), [("simulated", MOST_BEHIND / STEP), ("external", 2.0 / STEP)])
def test_an_external_autopilots_clock_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, autopilot: str, steps: float
) -> None:
    """The host takes the processor away for 2 s; the world is the only clock that an external autopilot has."""
    enlist()
    root = bundle(tmp_path / "sim", ["good"])
    scenario = json.loads((root / "scenario.json").read_text())
    scenario["robots"][0]["sim"] = {"autopilot": autopilot}
    (root / "scenario.json").write_text(json.dumps(scenario))
    host = [100.0]
    clock = SimpleNamespace(monotonic=lambda: host[0], sleep=lambda seconds: None)
    monkeypatch.setattr(realtime, "time", clock)
    conduct = realtime.RealTime(load(root), root, tmp_path, 0)
    made: list[float] = []
    host[0] += 2.0
    for _ in range(100):
        conduct.go_on(made.append)
    conduct.close()
    assert len(made) == pytest.approx(steps, abs=2)
    assert made == sorted(made) and made[0] >= host[0] - MOST_BEHIND  # the trace tells when agents saw them


def test_late_steps_are_told_of_all_the_run_and_of_the_mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As processes that start and end take the processor away from the world."""
    step, rest = Run._step, Run._stop_safely
    held_up: list[float] = []

    def slow_step(run: Run, at: float) -> None:
        if run.zero is not None and not held_up:
            held_up.append(at)
            time.sleep(0.1)
        step(run, at)

    def slow_rest(run: Run, ended: str) -> None:
        time.sleep(0.2)
        rest(run, ended)

    monkeypatch.setattr(Run, "_step", slow_step)
    monkeypatch.setattr(Run, "_stop_safely", slow_rest)
    enlist()
    root, out = bundle(tmp_path / "sim", ["good"]), tmp_path / "out"
    assert sim(root, out) == 0
    found = summary(out)
    assert found["late_in_mission"] >= 20 and found["late_steps"] >= found["late_in_mission"] + 40
    told = f"{found['late_steps']} late, {found['late_in_mission']} of them in the mission"
    assert told in (out / "summary.txt").read_text()
