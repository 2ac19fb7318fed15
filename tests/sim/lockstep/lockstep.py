"""Sim bundles of the examples, run in lockstep, for tests."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from koordgen.cli import main
from koordgen.runtime.native.loader import cache_folder
from koordgen.runtime.trace.schema import TraceRecord
from targets.sim.base.bodies import BodyState
from targets.sim.base.scenario import load
from targets.sim.lockstep.run import Lockstep
from targets.sim.run.progress import Progress
from targets.sim.run.run import Run, RunResult
from targets.sim.run.run_interface import AgentHandle

EXAMPLES = Path(__file__).parents[3] / "examples"


def built(folder: Path, app: str, fleet: str | None = None) -> Path:
    """The sim bundle of an example, whose autopilots boot and take off at once; `fleet` is YAML instead of its own."""
    source = EXAMPLES / app / f"{app}.koord"
    file = EXAMPLES / app / "fleet.yaml"
    if fleet is not None:
        file = folder / "fleet.yaml"
        file.write_text(fleet)
    arguments = ["build", str(source), "--fleet", str(file), "--target", "sim", "-o", str(folder / "build")]
    assert main(arguments) == 0
    bundle = folder / "build" / app / "sim"
    scenario = json.loads((bundle / "scenario.json").read_text())
    scenario["harness"].update(boot=0.5, spool_up=0.5)
    (bundle / "scenario.json").write_text(json.dumps(scenario))
    return bundle


def ran(bundle: Path, out: Path, seconds: float, *more: str, hashing: str = "0") -> int:
    """Run a bundle in lockstep in a process of its own, with a PYTHONHASHSEED; its exit status. It draws no report, and
    compiles no C code that this user's cache holds."""
    command = [sys.executable, str(bundle), "--lockstep", "--duration", f"{seconds:g}", "--out", str(out), "--quiet"]
    command += ["--no-report"]
    environment = {"PYTHONHASHSEED": hashing, "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin", "HOME": str(out.parent)}
    if cache := cache_folder():
        environment["XDG_CACHE_HOME"] = str(cache.parent)
    done = subprocess.run([*command, *more], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode in (0, 3), done.stdout + done.stderr
    return done.returncode


def summary(out: Path) -> Any:
    return json.loads((out / "summary.json").read_text())


def digest(out: Path) -> str:
    return hashlib.sha256((out / "trace.jsonl").read_bytes()).hexdigest()


class Plan:
    """A crew.Companion that does what is planned for a time, with the agent of a robot, and remembers the truth."""

    def __init__(self, *plan: tuple[float, str, Callable[[AgentHandle], object]]) -> None:
        self._plan = sorted(plan, key=lambda each: each[0])
        self.states: list[tuple[float, list[BodyState]]] = []

    def launched(self, run: Run) -> None:
        self.run = run

    def step(self, at: float, states: list[BodyState]) -> None:
        t = self.run.t(at)
        if t is None:
            return
        self.states.append((t, states))
        while self._plan and t >= self._plan[0][0]:
            _, robot, act = self._plan.pop(0)
            act(self.agent(robot))

    def agent(self, robot: str) -> AgentHandle:
        return next(agent for agent in self.run.conduct.agents if agent.robot.name == robot)

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None: ...

    def end(self, at: float) -> None: ...

    def speed(self, pid: int, t: float) -> float:
        """Of a robot at a time, m/s."""
        states = next(states for time, states in self.states if time >= t)
        return math.hypot(*states[pid].velocity)


def played(bundle: Path, folder: Path, seconds: float, plan: Plan, seed: int = 0) -> RunResult:
    """A run in this process, with a plan."""
    folder.mkdir()
    scenario = load(bundle)
    run = Run(scenario, Lockstep(scenario, bundle, folder, seed), folder, seconds, Progress(sys.stderr, quiet=True))
    run.companions.append(plan)
    return run.execute()
