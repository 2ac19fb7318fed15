"""Real-time clock: one process per agent, UDP between them, and a world that follows the host's clock."""

from __future__ import annotations

import math
import os
import secrets
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from targets.sim.base.fleets import SimulatedFleet, fleets_of
from targets.sim.base.medium import Medium
from targets.sim.base.ports import NUMBERS
from targets.sim.base.scenario import Robot, Scenario
from targets.sim.physics.world import STEP
from targets.sim.realtime.links import FleetLinks
from targets.sim.realtime.squads import SETTINGS, TRACE, RealTimeSquad
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
        self._scenario, self._root, self._seed = scenario, root, seed
        self._key_file = folder / "fleet.key"
        self._key = secrets.token_bytes(32)
        with open(os.open(self._key_file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(self._key)
        self._fleets = fleets_of(scenario)
        self._squads: dict[str, RealTimeSquad] = {}
        self._homes: dict[int, tuple[SimulatedFleet, int]] = {}  # place of a physical robot -> its fleet and pid there
        by_place: dict[int, AgentProcess] = {}
        for fleet in self._fleets:
            for robot, bodies in zip(fleet.scenario.robots, fleet.bodies, strict=True):
                own = folder / "robots" / robot.name
                own.mkdir(parents=True)
                if fleet.is_squad(robot.pid):
                    places = [folder / "robots" / scenario.robots[body].name for body in bodies]
                    self._squads[robot.name] = RealTimeSquad(robot, own, fleet.scenario.delta, places)
                else:
                    by_place[bodies[0]] = AgentProcess(robot, root / robot.bundle, own, fleet.scenario.delta)
                    self._homes[bodies[0]] = fleet, robot.pid
        self._agents = [by_place[place] for place in range(len(scenario.robots))]
        for squad, bodies in zip(self._fleets[0].names, self._fleets[0].bodies, strict=True):
            if squad in self._squads:
                self._squads[squad].consist_of([by_place[body] for body in bodies])
        # An external autopilot uses the world's clock. If that stopped, the autopilot would be late for good.
        external = any(robot.external for robot in scenario.robots)
        self._most_behind = math.inf if external else MOST_BEHIND
        self._pace = self._started()
        self._medium: Medium | None = None
        self._links: list[FleetLinks] = []
        self._numbers: list[int] = []  # ports of the control channels

    @property
    def agents(self) -> list[AgentProcess]:
        return self._agents

    @property
    def squads(self) -> Mapping[str, AgentHandle]:
        return self._squads

    def scene(self) -> SimulationScene:
        return SimulationScene(self._scenario, self._seed, self._key)

    def launch(self, scene: SimulationScene) -> None:
        self._links = [FleetLinks(fleet, self._seed, self._medium) for fleet in self._fleets]
        links = {fleet.name: own for fleet, own in zip(self._fleets, self._links, strict=True)}
        for place, (agent, actor) in enumerate(zip(self._agents, scene.actors, strict=True)):
            fleet, pid = self._homes[place]
            self._numbers.append(NUMBERS.allocate())
            identity = fleet.own_name(agent.robot.name), pid, agent.application()
            own = overrides(identity, links[fleet.name].peers(place), self._key_file, agent.trace_file)
            if fleet.name in self._squads:
                self._host(place, links[""].peers(place))
            state = str(agent.state_folder.resolve())
            settings = {**own, "control": self._numbers[-1], "state": state, "body": actor.overrides}
            agent.launch(settings, *self._simple(agent.robot, actor, fleet))
        self._pace = self._started()

    def _host(self, place: int, peers: list[dict[str, Any]]) -> None:
        """Write the settings with which a robot of a squad hosts the agent of the squad."""
        agent = self._agents[place]
        squad = self._squads[self._homes[place][0].name].robot
        identity = squad.name, squad.pid, agent.application(SETTINGS)
        folder = agent.trace_file.parent
        settings = overrides(identity, peers, self._key_file, folder / TRACE)
        (folder / SETTINGS).write_bytes(msgspec.json.format(msgspec.json.encode(settings), indent=2) + b"\n")

    def _started(self) -> Pace:
        return Pace(time.monotonic(), STEP, self._most_behind)

    def _simple(self, robot: Robot, actor: Actor, fleet: SimulatedFleet) -> tuple[list[str] | None, str]:
        """Return the command and PYTHONPATH that replace a bundle for a robot of fidelity `simple`.

        None for others."""
        found = getattr(actor.device, "agent", None)
        if found is None:
            return None, ""
        bundle, drivers = str((self._root / robot.bundle).resolve()), msgspec.json.encode(fleet.scenario.drivers)
        command = ["-m", "targets.sim.realtime.simple_agent", *found, bundle, drivers.decode()]
        return command, os.pathsep.join((str(self._root.resolve()), bundle))

    def disturb(self, medium: Medium) -> None:
        """Change the medium. A relay exists only if this was called before the launch. See AgentsAndClock."""
        self._medium = medium
        for links in self._links:
            links.change(medium)

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
        for squad in self._squads.values():
            squad.close()
        for links in self._links:
            links.close()
        while self._numbers:
            NUMBERS.give_back(self._numbers.pop())
        self._key_file.unlink(missing_ok=True)
