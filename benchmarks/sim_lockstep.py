"""Cost of a run in lockstep, agents included; part of benchmarks/sim.py.

The program is LineForm (examples/lineform): in every round of 0.1 s each robot publishes its position and goes to the
middle of its neighbours. Only the mission is measured, from round 1 on: no loading, take-off, safe stop and report.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from koordgen.cli import main
from targets.sim.base import scenario
from targets.sim.base.bodies import BodyState
from targets.sim.lockstep.run import Lockstep
from targets.sim.run.scene import SimulationScene

PROGRAM = Path(__file__).parents[1] / "examples" / "lineform" / "lineform.koord"


@dataclass(frozen=True, slots=True)
class Mission:
    """Times of a mission (s): simulated, wall clock, CPU of this process, CPU of world and devices.

    It also has the share of each part in the time since the launch.
    """

    simulated: float
    host: float
    cpu: float
    scene: float
    shares: dict[str, float]

    @property
    def factor(self) -> float:
        """Simulated seconds per CPU second: on an idle computer, the factor to real time."""
        return self.simulated / self.cpu

    @property
    def harness(self) -> float:
        """Share of a core that world and devices would need in a run in real time."""
        return self.scene / self.simulated


def fleet(count: int, target: str) -> dict[str, Any]:
    """Return a fleet file with so many robots, 1.5 m apart."""
    places = [[1.5 * (k % 8) - 5.0, 1.5 * (k // 8) - 5.0, 0.0] for k in range(count)]
    robots = [
        {"name": f"r{k}", "target": target, "address": f"127.0.0.1:{47100 + k}", "start": {"position": place}}
        for k, place in enumerate(places)
    ]
    return {
        "delta": 0.1,
        "origin": {"latitude": 47.4, "longitude": 8.5, "altitude": 488.0},
        "geofence": {"lo": [-20.0, -20.0, -0.5], "hi": [20.0, 20.0, 6.0]},
        "robots": robots,
    }


def built(folder: Path, count: int, target: str) -> Path:
    """Return the sim bundle."""
    file = folder / "fleet.yaml"
    file.write_text(json.dumps(fleet(count, target)))
    arguments = ["build", str(PROGRAM), "--fleet", str(file), "--target", "sim", "-o", str(folder / "build")]
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(arguments) == 0
    return folder / "build" / "lineform" / "sim"


def mission(count: int, target: str, fidelity: str, seconds: float) -> Mission:
    """Run the bundle in this process."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        root = built(folder, count, target)
        laid_over = folder / "settings.json"
        laid_over.write_bytes(msgspec.json.encode({"fidelity": fidelity}))
        conduct = Lockstep(scenario.load(root, laid_over), root, folder / "run", 0)
        scene = conduct.scene()
        try:
            conduct.launch(scene)
            while not all(agent.round for agent in conduct.agents):
                _go_on(conduct, scene, 0.5)
                for agent in conduct.agents:
                    agent.look()
                assert conduct.now() < 60.0, [agent.waiting_for() for agent in conduct.agents]
            timer = _Timer(scene)
            host, cpu = time.perf_counter(), time.process_time()
            _go_on(conduct, timer, seconds)
            spent = time.perf_counter() - host, time.process_time() - cpu
            return Mission(seconds, *spent, timer.spent, conduct.shares)
        finally:
            conduct.close()
            scene.close()


class _Timer:
    """Runs the steps of a scene, and measures their CPU time."""

    def __init__(self, scene: SimulationScene) -> None:
        self._scene = scene
        self.spent = 0.0

    def step(self, at: float) -> list[BodyState]:
        began = time.process_time()
        states = self._scene.step(at)
        self.spent += time.process_time() - began
        return states


def _go_on(conduct: Lockstep, scene: SimulationScene | _Timer, seconds: float) -> None:
    def step(at: float) -> None:
        scene.step(at)

    end = conduct.now() + seconds
    while conduct.now() < end - 1e-9:
        conduct.go_on(step)
