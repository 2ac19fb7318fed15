"""Real-time clock: one process per agent, UDP between them, and a world that follows the host's clock."""

from __future__ import annotations

import math
import os
import secrets
import time
from collections.abc import Mapping
from pathlib import Path

import msgspec

from targets.sim.base.medium import Medium
from targets.sim.base.ports import NUMBERS
from targets.sim.base.scenario import BadScenario, Robot, Scenario
from targets.sim.physics.world import STEP
from targets.sim.realtime.relay import Relay
from targets.sim.realtime.supervise import AgentProcess, overrides
from targets.sim.run.run_interface import AgentHandle, WorldStep
from targets.sim.run.scene import Actor, SimulationScene

# Pacing of the world: computes which physics steps are due at a host time, on absolute ticks.

BURST = 24  # steps in one go when behind, before other work is done
MOST_BEHIND = 0.25  # seconds; a world that is further behind stops its clock for the rest


class Pace:
    """Pace of a world: step k is due at start + k * step + `slip` (host seconds).

    `slip` is the time for which the world's clock was stopped. `late` counts steps that began more than one step too
    late. With `most_behind` infinite the clock never stops: the world makes up for all delays."""

    def __init__(self, start: float, step: float, most_behind: float = MOST_BEHIND) -> None:
        self._step = step
        self._start = start
        self._most_behind = most_behind
        self.done = 0
        self.late = 0
        self.slip = 0.0

    def due(self, now: float) -> int:
        """Return the number of steps to make at host time `now`, at most BURST. They count as done."""
        behind = now - self.tick(self.done)
        if behind > self._most_behind:
            self.slip += behind - self._most_behind
        number = int((now - self.tick(self.done)) // self._step) + 1
        number = max(0, min(BURST, number))
        self.late += sum(now - self.tick(k) > self._step for k in range(self.done, self.done + number))
        self.done += number
        return number

    def tick(self, step: int) -> float:
        """Return the host time at which a step is due."""
        return self._start + step * self._step + self.slip

    def factor(self, now: float) -> float:
        """Return the world seconds per host second since the start."""
        return self.done * self._step / (now - self._start) if now > self._start else 1.0


class RealTime:
    """Real-time clock and agents of a run. Implements `run_interface.AgentsAndClock`.

    `root` is the sim bundle; `folder` receives the key and a folder for each robot."""

    def __init__(self, scenario: Scenario, root: Path, folder: Path, seed: int) -> None:
        if scenario.fleets:
            raise BadScenario("fleets with squads cannot run in real time", "add --lockstep")
        self._scenario, self._root, self._seed = scenario, root, seed
        self._key_file = folder / "fleet.key"
        self._key = secrets.token_bytes(32)
        with open(os.open(self._key_file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(self._key)
        self._agents: list[AgentProcess] = []
        for robot in scenario.robots:
            own = folder / "robots" / robot.name
            own.mkdir(parents=True)
            self._agents.append(AgentProcess(robot, root / robot.bundle, own, scenario.delta))
        # An external autopilot uses the world's clock. If that stopped, the autopilot would be late for good.
        external = any(robot.external for robot in scenario.robots)
        self._most_behind = math.inf if external else MOST_BEHIND
        self._pace = self._started()
        self._medium: Medium | None = None
        self._relay: Relay | None = None
        self._numbers: list[int] = []

    @property
    def agents(self) -> list[AgentProcess]:
        return self._agents

    @property
    def squads(self) -> Mapping[str, AgentHandle]:
        return {}

    def scene(self) -> SimulationScene:
        return SimulationScene(self._scenario, self._seed, self._key)

    def launch(self, scene: SimulationScene) -> None:
        count = len(self._agents)
        taken = self._numbers = [NUMBERS.allocate() for _ in range(2 * count)]
        ports, controls = taken[:count], taken[count:]
        if self._medium is not None:
            self._relay = Relay(ports, self._seed, self._medium)
        others = self._relay.ports if self._relay else ports
        for pid, (agent, actor) in enumerate(zip(self._agents, scene.actors, strict=True)):
            seen = [*others[:pid], ports[pid], *others[pid + 1 :]]  # a robot listens on its own port
            laid_over = overrides(self._scenario.robots, seen, controls[pid], actor.overrides, self._key_file, agent)
            agent.launch(laid_over, *self._simple(agent.robot, actor))
        self._pace = self._started()

    def _started(self) -> Pace:
        return Pace(time.monotonic(), STEP, self._most_behind)

    def _simple(self, robot: Robot, actor: Actor) -> tuple[list[str] | None, str]:
        """Return the command and PYTHONPATH that replace a bundle for a robot of fidelity `simple`.

        None for others."""
        found = getattr(actor.device, "agent", None)
        if found is None:
            return None, ""
        bundle, drivers = str((self._root / robot.bundle).resolve()), msgspec.json.encode(self._scenario.drivers)
        command = ["-m", "targets.sim.realtime.simple_agent", *found, bundle, drivers.decode()]
        return command, os.pathsep.join((str(self._root.resolve()), bundle))

    def disturb(self, medium: Medium) -> None:
        """Change the medium. A relay exists only if this was called before the launch. See AgentsAndClock."""
        self._medium = medium
        if self._relay is not None:
            self._relay.change(medium)

    def now(self) -> float:
        return time.monotonic()

    def go_on(self, step: WorldStep) -> None:
        """Make all steps that are due, then sleep until the next.

        A step that is late by more than `MOST_BEHIND` is stamped with the present time less `MOST_BEHIND`, for agents
        receive its data only now."""
        first = self._pace.done
        for k in range(first, first + self._pace.due(time.monotonic())):
            step(max(self._pace.tick(k), time.monotonic() - MOST_BEHIND))
        time.sleep(max(0.0, self._pace.tick(self._pace.done) - time.monotonic()))

    @property
    def steps(self) -> int:
        return self._pace.done

    @property
    def late(self) -> int:
        return self._pace.late

    @property
    def factor(self) -> float:
        return self._pace.factor(time.monotonic())

    @property
    def shares(self) -> dict[str, float]:
        """Empty: the agents' time is that of other processes."""
        return {}

    def close(self) -> None:
        for agent in self._agents:
            agent.close()
        if self._relay is not None:
            self._relay.close()
        while self._numbers:
            NUMBERS.give_back(self._numbers.pop())
        self._key_file.unlink(missing_ok=True)
