"""Lockstep clock.

All agents live in this process, and simulated time passes as fast as the processor allows.

The world steps 240 times per simulated second. Between two steps, agents are polled at the times that they requested or
at which a datagram arrives, in order of time and then of their places in the scenario. Computation takes no simulated
time. So the same scenario and seed give the same run, and traces that are equal byte for byte."""

from __future__ import annotations

import hashlib
import math
import random
import time
from collections.abc import Mapping
from pathlib import Path

from koordgen.runtime.net.network import MemoryNetwork
from koordgen.runtime.program.runner import Interrupting
from targets.sim.base.fleets import fleets_of
from targets.sim.base.medium import Medium
from targets.sim.base.scenario import BadScenario, Robot, Scenario
from targets.sim.lockstep.agent import LockstepAgent
from targets.sim.lockstep.shared import LockstepFleet, Shared, SquadPlace
from targets.sim.lockstep.squads import LockstepSquad
from targets.sim.physics.world import STEP
from targets.sim.run.run_interface import AgentHandle, WorldStep
from targets.sim.run.scene import SimulationScene

LONGEST_EVENT = 10.0  # seconds of the host's clock after which an event is interrupted
ITERATIONS = 400  # iterations of a planner's search


class Lockstep:
    """Lockstep clock and agents of a run. Implements `run_interface.AgentsAndClock`.

    `root` is the sim bundle; `folder` receives a folder for each robot. The run's key is derived from its seed: nobody
    else receives these datagrams."""

    def __init__(self, scenario: Scenario, root: Path, folder: Path, seed: int) -> None:
        self.check(scenario)
        random.seed(f"{seed}/user")  # random numbers for the user's functions
        key = hashlib.sha256(f"lockstep {seed}".encode()).digest()
        self._scenario, self._shared = scenario, Shared(root, seed, key, ITERATIONS, _Longest())
        self._fleets = [LockstepFleet(fleet, self._shared) for fleet in fleets_of(scenario)]
        self._squads: dict[str, LockstepSquad] = {}
        by_place: dict[int, LockstepAgent] = {}
        for fleet in self._fleets:
            for robot, (place, *_) in zip(fleet.scenario.robots, fleet.fleet.bodies, strict=True):
                own = folder / "robots" / robot.name
                own.mkdir(parents=True)
                if fleet.fleet.is_squad(robot.pid):
                    self._squads[robot.name] = LockstepSquad(robot, own, fleet.scenario.delta, self._shared.shares)
                else:
                    by_place[place] = self.resident(robot, own, fleet)
        for fleet in self._fleets:
            if fleet.fleet.name in self._squads:
                handle = self._squads[fleet.fleet.name]
                fleet.squad = SquadPlace(self._fleets[0], handle)
                handle.consist_of([by_place[place] for place, *_ in fleet.fleet.bodies])
        self._agents = [by_place[place] for place in range(len(scenario.robots))]
        self._scene: SimulationScene | None = None
        self._steps = 0
        self._began = time.perf_counter()

    def check(self, scenario: Scenario) -> None:
        """Check that all robots can run in lockstep. Raises BadScenario."""
        _check(scenario)

    def resident(self, robot: Robot, folder: Path, fleet: LockstepFleet) -> LockstepAgent:
        """Return a robot's agent, not yet launched."""
        return LockstepAgent(robot, folder, fleet)

    @property
    def agents(self) -> list[LockstepAgent]:
        return self._agents

    @property
    def squads(self) -> Mapping[str, AgentHandle]:
        return self._squads

    @property
    def network(self) -> MemoryNetwork:
        """Network between the agents of the only or outer fleet."""
        return self._fleets[0].network

    def scene(self) -> SimulationScene:
        shared = self._shared
        self._scene = SimulationScene(
            self._scenario, shared.seed, shared.key, wiring=shared.hub, clock=shared.clock.now
        )
        return self._scene

    def launch(self, scene: SimulationScene) -> None:
        for agent, actor in zip(self._agents, scene.actors, strict=True):
            agent.launch(actor)
        self._began = time.perf_counter()

    def disturb(self, medium: Medium) -> None:
        """See AgentsAndClock."""
        for fleet in self._fleets:
            network = fleet.network
            network.conditions, network.links, network.cut = medium.all, dict(medium.by_link()), medium.cut

    def now(self) -> float:
        return self._shared.clock.time

    def go_on(self, step: WorldStep) -> None:
        """Step the world once, then poll the agents up to the next step."""
        at, shares = self._steps * STEP, self._shared.shares
        began = shares.begin()
        step(at)
        shares.end("stage", began)
        began = shares.begin()
        for agent in self._agents:
            agent.beside(at)
        self._steps += 1
        self._poll_until(self._steps * STEP)
        shares.end("agents", began)

    def _poll_until(self, end: float) -> None:
        clock, agents = self._shared.clock, self._agents
        while True:
            first, soonest = agents[0], math.inf
            for agent in agents:
                due = agent.due
                if due < soonest:
                    first, soonest = agent, due
            if soonest >= end:
                break
            clock.time = max(clock.time, soonest)
            first.poll(clock.time)
        clock.time = end

    @property
    def steps(self) -> int:
        return self._steps

    @property
    def late(self) -> int:
        """Number of late steps: always 0, for the clock waits."""
        return 0

    @property
    def factor(self) -> float:
        return self._steps * STEP / max(time.perf_counter() - self._began, 1e-9)

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the processor's time, by part."""
        return self._shared.shares.fractions(self._scene.spent if self._scene is not None else 0.0)

    def close(self) -> None:
        for agent in self._agents:
            agent.close()
        for squad in self._squads.values():
            squad.close()


class _Longest:
    """Limit on the host's time of an event: an event that never ends must not block the run."""

    def __init__(self) -> None:
        self._interrupting = Interrupting()

    def __call__(self, seconds: float) -> Interrupting:
        return self._interrupting(LONGEST_EVENT)


def _check(scenario: Scenario) -> None:
    for robot in scenario.robots:
        if robot.external:
            raise BadScenario(
                f"{robot.name}: its external autopilot has its own clock and cannot run in lockstep",
                "leave out --lockstep, or set `autopilot: simulated` in its `sim:`",
            )
        if not robot.inside:
            raise BadScenario(
                f"{robot.name}: its target {robot.target} cannot run in lockstep",
                "set `inside` in [simulation] of its manifest and build again, or leave out --lockstep",
            )
