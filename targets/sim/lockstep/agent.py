"""Agent of a robot within the lockstep process.

It has its bundle's program, drivers and functions, its target's platform, and the same state machine as agents on
robots, polled on the run's clock."""

from __future__ import annotations

import importlib
import math
import traceback
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from random import Random
from typing import Any

import msgspec

from koordgen.runtime.agent.machine import INTERNAL, SURROUNDINGS, WRONG_PROGRAM
from koordgen.runtime.agent.machine import Agent as Machine
from koordgen.runtime.agent.records import MemoryStore
from koordgen.runtime.agent.squad import MODULE, Squad
from koordgen.runtime.agent.squad_host import HostSurroundings, SquadHost
from koordgen.runtime.config.settings import BadSettings, Settings, load
from koordgen.runtime.net.layout import TooLarge
from koordgen.runtime.net.network import MemoryTransport
from koordgen.runtime.ops.set_up import programs_of
from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.trace.writer import Trace
from koordgen.runtime.vehicle.drivers import Drivers, with_drivers
from koordgen.runtime.vehicle.platform import Platform, Unready
from targets.sim.base.bodies import DirectlyDriven
from targets.sim.base.programs import LoadedPrograms, load_programs
from targets.sim.base.scenario import Robot, Scenario
from targets.sim.lockstep.bundle_modules import BundleModules
from targets.sim.lockstep.shared import LockstepFleet, SquadPlace
from targets.sim.lockstep.traced import TracedAgent, TraceFile
from targets.sim.lockstep.wires import EPOCH, LockstepServices
from targets.sim.run.scene import Actor

KILLED = -9
# Settings in lockstep that replace a robot's own.
NO_FILES: Mapping[str, Any] = {
    "network": {"transport": "unicast"}, "state": None, "key_file": None, "trace": None,
}  # fmt: skip


class LockstepAgent(TracedAgent):
    """Agent handle of a robot in lockstep. After construction it is not yet launched."""

    def __init__(self, robot: Robot, folder: Path, own: LockstepFleet) -> None:
        super().__init__(robot, folder, own.scenario.delta)
        shared = self._shared = own.shared
        self._fleet = own
        self._place = own.fleet.bodies[robot.pid][0]
        self._settings_file = folder / "settings.json"
        self._dice = Random(f"{shared.seed}/{self._place}/agent")
        self._store = MemoryStore()
        self._own = BundleModules(
            shared.root / robot.bundle, shared.clock.now, lambda: EPOCH + shared.clock.now(), self._log
        )
        self._inside: AbstractContextManager[None] = self._own
        self._surroundings: list[LockstepServices] = []  # one per start: devices beside a crashed agent run on
        self._machine: Machine | None = None
        self._platform: Platform | None = None
        self._transport: MemoryTransport | None = None
        self._host: SquadHost | None = None  # of a squad's agent, if the robot is in a squad
        self._between: MemoryTransport | None = None  # transport of that agent
        self._actor: Actor | None = None
        self._status: int | None = None
        self._wake = self._polled = self._thawed = 0.0
        self._wake_outer = math.inf

    def launch(self, actor: Actor) -> None:
        """Launch the agent. Raises OSError."""
        self._actor = actor
        settings = {**NO_FILES, **self._overrides(actor)}
        self._settings_file.write_bytes(msgspec.json.format(msgspec.json.encode(settings), indent=2) + b"\n")
        self._boot(actor)

    def _boot(self, actor: Actor) -> None:
        shared, robot = self._shared, self.robot
        self._status, self._wake = None, shared.clock.now()
        self._out = self._opened()
        seed = self._dice.getrandbits(31)
        self._surroundings.append(LockstepServices(shared.hub, shared.clock.now, seed, shared.iterations))
        try:
            with self._own:
                settings = load(shared.root / robot.bundle / "settings.json", self._settings_file)
                (program, properties), drivers = self._loaded()
                programs = _programs(program, robot.pid)
                boot = self._dice.randbytes(8)
                if self._fleet.squad is not None:
                    assert isinstance(program, FleetProgram)
                    self._host = self._hosted(self._fleet.squad, program, boot)
                    programs, program = (*programs, self._host.squad.program), self._host.fleet
                    drivers = {**drivers, **self._host.drivers}
                whole = program.of(robot.pid) if isinstance(program, FleetProgram) else program
                platform = self._embodied(actor, settings, whole)
                self._platform = with_drivers(platform, whole, drivers)
                self._transport = self._fleet.transport(self._place)
                self._machine = Machine(
                    program, settings, shared.key, self._platform, shared.clock, self._transport,
                    Trace(self._out, self._warn), self._emit, boot, self._store,  # type: ignore[arg-type]
                    monitors=self.monitors, limit=shared.limit, properties=properties,
                )  # fmt: skip
                if self._host is not None:
                    self._host.attach(self._machine)
                users_own = set(drivers) - {MODULE}
                if all(p.library is None for p in programs) and not users_own and self._own.idle:
                    self._inside = nullcontext()
        except (BadSettings, TooLarge, BadExtern) as error:
            self._fail(str(error), WRONG_PROGRAM)
        except Unready as error:
            self._fail(error.message + (f"\n  help: {error.hint}" if error.hint else ""), SURROUNDINGS)
        except Exception:
            self._fail("internal error, please report it:\n" + traceback.format_exc(), INTERNAL)

    def _hosted(self, place: SquadPlace, inner: FleetProgram, boot: bytes) -> SquadHost:
        """Return the host of the squad's agent on this robot. `boot`: boot id of the robot's own agent."""
        squad: Squad = importlib.import_module("squad").SQUAD
        if squad.program.library is not None:
            squad.program.library.load()
        own_file = self._settings_file.with_name(squad.settings)
        own_file.write_bytes(msgspec.json.format(msgspec.json.encode(NO_FILES), indent=2) + b"\n")
        settings = load(self._shared.root / self.robot.bundle / squad.settings, own_file)
        self._between = place.outer.transport(self._place)
        around = HostSurroundings(
            settings, self._shared.key, self.robot.name, boot, self._shared.clock, self._between, place.handle.trace,
            place.handle.emit, self._shared.limit, tuple(place.handle.monitors),
        )  # fmt: skip
        return SquadHost(squad, inner, self.robot.pid, self._fleet.scenario.delta, around)

    def _overrides(self, actor: Actor) -> dict[str, Any]:
        """Return the settings that override the robot's own."""
        return {"body": actor.overrides}

    def _opened(self) -> TraceFile:
        """Open the trace's file. Raises OSError."""
        return TraceFile(self.trace_file.open("ab"), self._shared.shares)

    def _loaded(self) -> tuple[LoadedPrograms, Drivers]:
        """Return programs with their properties, and drivers, of the robot's bundle."""
        return _loaded(self._fleet.scenario, self._shared.root / self.robot.bundle, self.robot.pid)

    def _embodied(self, actor: Actor, settings: Settings, program: Program) -> Platform:
        """Return the platform of the device if it has one, otherwise that of the target."""
        if isinstance(actor.device, DirectlyDriven):
            return actor.device.platform(settings, self._shared.key, self._surroundings[-1])
        module, _, member = self.robot.inside.partition(":")
        made: Platform = getattr(importlib.import_module(module), member)(
            settings, self._shared.key, self._surroundings[-1]
        )
        return made

    @property
    def due(self) -> float:
        """Time of the next poll: as the agent requested, or when `Transport.wait` would return."""
        machine = self._machine
        if machine is None:
            return math.inf
        due = min(self._due(machine, self._fleet, self._wake), self._wake_outer)
        if self._host is not None and self._host.outer is not None and self._fleet.squad is not None:
            due = min(due, self._due(self._host.outer, self._fleet.squad.outer, self._wake_outer))
        return max(due, self._thawed)

    def _due(self, machine: Machine, fleet: LockstepFleet, wake: float) -> float:
        """Return the time at which a machine of this robot needs a poll. `wake`: the time that it requested."""
        arrival = fleet.network.next_arrival(self._place)
        if arrival >= wake:
            return wake
        expected, gather = machine.expects
        complete = max(fleet.network.next_arrival(self._place, expected), self._polled)
        return min(wake, complete, max(arrival, self._polled + gather))

    def poll(self, now: float) -> None:
        """Run the agent for all work that is due."""
        machine = self._machine
        if machine is None:
            return
        self._polled = now
        try:
            with self._inside:
                self._wake = max(machine.poll(now), now + 1e-6)
                if self._host is not None:
                    self._wake_outer = max(self._host.poll(now), now + 1e-6)
        except Exception:
            self._fail("internal error, please report it:\n" + traceback.format_exc(), INTERNAL)
            return
        if machine.done:
            self._leave(machine.status)

    def beside(self, now: float) -> None:
        """Run the devices beside the agent, at each step of the world."""
        for surroundings in self._surroundings:
            for step in surroundings.steps:
                step(now)

    def _leave(self, status: int) -> None:
        """Close the platform in order, after the agent has ended by itself."""
        if self._platform is not None:
            with self._own:
                self._platform.close()
        self._drop(status)

    def _drop(self, status: int) -> None:
        """Detach everything of the agent, without calling it."""
        for transport in (self._transport, self._between):
            if transport is not None:
                transport.close()
        for surroundings in self._surroundings:
            surroundings.cut()
        if self._out is not None:
            self._read()
            with suppress(OSError):
                self._out.close()
        self._machine = self._platform = self._transport = self._between = self._host = self._out = None
        self._wake_outer = math.inf
        self._status = status

    def _fail(self, message: str, status: int) -> None:
        self._emit("error", f"error: {message}")
        self._drop(status)

    @property
    def alive(self) -> bool:
        return self._machine is not None

    @property
    def status(self) -> int | None:
        return self._status

    def request_end(self) -> None:
        self.asked_to_end = True
        if self._thawed == math.inf:
            self.thaw()
        if self._machine is not None:
            with self._inside:
                self._machine.end("SIGTERM: stopping safely")
            self._wake = self._shared.clock.now()
            if self._machine.done:
                self._leave(self._machine.status)

    def kill(self) -> None:
        if self._machine is not None:
            self.killed = True
            self._drop(KILLED)

    def crash(self) -> None:
        if self._machine is not None:
            self.crashed = True
            self._drop(KILLED)

    def restart(self) -> None:
        self.crash()
        if self._actor is not None:
            self.crashed = False
            self._thawed = 0.0
            self._boot(self._actor)

    def freeze(self, seconds: float) -> None:
        self._thawed = self._shared.clock.now() + seconds

    @property
    def frozen(self) -> bool:
        return self.alive and self._thawed > self._shared.clock.now()

    def thaw(self) -> None:
        self._thawed = min(self._thawed, self._shared.clock.now())

    def _failed(self, status: int) -> str | None:
        if status == 0:
            return None
        own = self.stopping.detail if self.stopping else self.last_error
        why = own.strip().splitlines()[-1:] or self.last_lines(1) or ["it said nothing"]
        return f"ended with status {status}: {why[0]}"

    def close(self) -> None:
        """End the agent and close its files. Idempotent."""
        self._drop(KILLED if self._status is None else self._status)
        with suppress(OSError):
            self._log.close()


def _loaded(scenario: Scenario, bundle: Path, pid: int) -> tuple[LoadedPrograms, Drivers]:
    """Return what the bundle's `__main__.py` loads. Call within BundleModules.

    Raises BadExtern and whatever imports raise."""
    loaded = load_programs(bundle)
    for program in _programs(loaded[0], pid):
        if program.library is not None:
            program.library.load()
    modules = {port.name.partition(".")[0] for program in _programs(loaded[0], pid) for port in program.ports}
    drivers: dict[str, Callable[[], Any]] = {
        served: getattr(importlib.import_module(module), member)
        for served, module, member in scenario.drivers
        if served in modules or not scenario.applications
    }
    return loaded, drivers


def _programs(program: Program | FleetProgram, pid: int) -> tuple[Program, ...]:
    """Return the programs of a robot."""
    return (program,) if isinstance(program, Program) else programs_of(program, pid)
