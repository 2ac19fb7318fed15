"""Lockstep run that replays a counterexample: bodies and events are set by a plan."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, ClassVar

from koordgen.runtime.config.settings import Settings
from koordgen.runtime.program.program import Program
from koordgen.runtime.program.property import Properties
from koordgen.runtime.trace.schema import HEADER
from koordgen.runtime.vehicle.drivers import Drivers
from koordgen.runtime.vehicle.platform import Platform
from targets.sim.base.bodies import BodyState
from targets.sim.base.fault_state import FaultState
from targets.sim.base.programs import LoadedPrograms
from targets.sim.base.scenario import Robot, Scenario
from targets.sim.follow.guide import ReplayGuide, ReplayPlatform
from targets.sim.lockstep.agent import LockstepAgent
from targets.sim.lockstep.run import Lockstep
from targets.sim.lockstep.shared import LockstepFleet
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.lockstep.traced import TraceFile
from targets.sim.run.scene import Actor, SeparationMonitor, SimulationScene

EVERYWHERE = 1e9  # metres; a geofence of this size never acts


class ReplayLockstep(Lockstep):
    """Lockstep clock and agents of a run along a plan."""

    def __init__(self, scenario: Scenario, root: Path, folder: Path, seed: int, guide: ReplayGuide) -> None:
        self.guide = guide
        super().__init__(scenario, root, folder, seed)

    def check(self, scenario: Scenario) -> None:
        """Accept every scenario: no platform of a target runs here."""

    def resident(self, robot: Robot, folder: Path, fleet: LockstepFleet) -> LockstepAgent:
        return ReplayAgent(robot, folder, fleet, self.guide)

    def scene(self) -> SimulationScene:
        self._scene = PlacedScene(self._scenario, self.guide)
        return self._scene


class ReplayAgent(LockstepAgent):
    """Agent whose events, sensors and callable ports come from the plan; all other parts are its own."""

    def __init__(self, robot: Robot, folder: Path, fleet: LockstepFleet, guide: ReplayGuide) -> None:
        self._guide = guide
        super().__init__(robot, folder, fleet)

    def poll(self, now: float) -> None:
        """Poll the agent, as LockstepAgent does. It is polled at the very beginning of each of its rounds."""
        super().poll(now)
        self._guide.began(self._round(), now)

    def _round(self) -> int:
        return self._machine.round if self._machine is not None else 0

    def _loaded(self) -> tuple[LoadedPrograms, Drivers]:
        (programs, properties), _ = super()._loaded()
        if isinstance(programs, Program):
            assert isinstance(properties, Properties)
            return (self._guide.program(programs, self.robot.pid, self._round), properties), {}
        assert not isinstance(properties, Properties)
        applications = list(programs.applications)
        for instance in programs.of_robot(self.robot.pid):
            own = applications[instance.application]
            guided = self._guide.program(own.program, instance.number, self._round)
            applications[instance.application] = replace(own, program=guided)
        return (replace(programs, applications=tuple(applications)), properties), {}

    def _embodied(self, actor: Actor, settings: Settings, program: Program) -> Platform:
        return ReplayPlatform(self._guide, self.robot.pid, program, self._round)

    def _overrides(self, actor: Actor) -> dict[str, Any]:
        far = [EVERYWHERE] * 3
        fence = {"lo": [-x for x in far], "hi": far}
        named = json.loads((self._shared.root / self.robot.bundle / "settings.json").read_bytes()).get("monitors", {})
        monitors = dict.fromkeys([*named, "default"], "log")  # a violation found by its monitors must not end the run
        return {**super()._overrides(actor), "geofence": fence, "avoid": "", "monitors": monitors}

    def _opened(self) -> TraceFile:
        return ReplayTraceFile(self.trace_file.open("ab"), self._shared.shares, self._guide.plan.kind)


class ReplayTraceFile(TraceFile):
    """Trace file whose header names the kind of counterexample that is replayed."""

    def __init__(self, file: IO[bytes], shares: TimeShares, kind: str) -> None:
        super().__init__(file, shares)
        self._mark = HEADER + b',"followed":"' + kind.encode() + b'"'

    def write(self, line: bytes) -> None:
        """See TraceFile."""
        super().write(line.replace(HEADER, self._mark, 1) if line.startswith(HEADER) else line)


class PlacedDevice:
    """Device and body of a robot that the plan places."""

    overrides: ClassVar[Mapping[str, Any]] = {}

    def step(self, now: float) -> None:
        """See Device."""

    def close(self) -> None:
        """See Device."""


class PlacedScene(SimulationScene):
    """Simulation scene without physics: bodies are where the plan has them, and touch nothing."""

    def __init__(self, scenario: Scenario, guide: ReplayGuide) -> None:
        unmoved: Any = PlacedDevice()
        self.actors = [Actor(robot, unmoved, unmoved, (), FaultState()) for robot in scenario.robots]
        self.watch = SeparationMonitor(0.0)
        self.spent = 0.0
        self._guide = guide

    def step(self, at: float) -> list[BodyState]:
        """See SimulationScene."""
        states = [self._guide.body(robot, at) for robot in range(len(self.actors))]
        self.watch.look(at, [state.position for state in states])
        return states

    def standing(self, pid: int) -> bool:
        """See SimulationScene."""
        return True

    def close(self) -> None:
        """See SimulationScene."""
