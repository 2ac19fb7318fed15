"""Agent of a robot within the lockstep process.

It has its bundle's program, drivers and functions, its target's platform, and the same state machine as agents on
robots, polled on the run's clock."""

from __future__ import annotations

import importlib
import math
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from random import Random
from typing import IO, Any

import msgspec

from koordgen.runtime.agent.machine import INTERNAL, SURROUNDINGS, WRONG_PROGRAM
from koordgen.runtime.agent.machine import Agent as Machine
from koordgen.runtime.agent.records import KEPT, Acceptor, Kept, Loaded, Locals, Mission
from koordgen.runtime.config.settings import BadSettings, Settings, load
from koordgen.runtime.net.layout import TooLarge
from koordgen.runtime.net.network import EACH, MemoryNetwork, MemoryTransport, Queue
from koordgen.runtime.ops.set_up import programs_of
from koordgen.runtime.program.extern import BadExtern
from koordgen.runtime.program.fleet_program import FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.program.runner import Limit
from koordgen.runtime.trace.schema import HEADER, TraceRecord, decoded
from koordgen.runtime.trace.writer import Trace
from koordgen.runtime.values.clock import Clock, SimulatedClock
from koordgen.runtime.vehicle.drivers import Drivers, with_drivers
from koordgen.runtime.vehicle.platform import Platform, Unready
from targets.sim.base.bodies import DirectlyDriven
from targets.sim.base.fleets import SimulatedFleet
from targets.sim.base.programs import LoadedPrograms, load_programs
from targets.sim.base.scenario import Robot, Scenario
from targets.sim.lockstep.bundle_modules import BundleModules
from targets.sim.lockstep.time_shares import TimeShares
from targets.sim.lockstep.wires import EPOCH, LockstepServices, MemoryWiring
from targets.sim.run.run_interface import AgentHandle
from targets.sim.run.scene import Actor

# State that survives a crash in lockstep, as the file of a real robot does (runtime/agent/checkpoint.py).


class MemoryStore:
    """Persistent store in memory, which outlives its agent.

    Implements `koordgen.runtime.agent.checkpoint.CheckpointStore`."""

    def __init__(self) -> None:
        self._mission: Mission | None = None
        self._acceptor: Acceptor | None = None
        self._locals: deque[Locals] = deque(maxlen=KEPT + 1)

    def write(self, record: Kept) -> bool:
        match record:
            case Mission():
                self._mission = record
            case Acceptor():
                self._acceptor = record
            case Locals():
                self._locals.append(record)
        return True

    def load(self) -> Loaded:
        newest = {record.round: record for record in self._locals}
        return Loaded(self._mission, tuple(newest[r] for r in sorted(newest)[-KEPT:]), self._acceptor)

    def clear(self) -> None:
        self._mission = self._acceptor = None
        self._locals.clear()


KILLED = -9


class TraceFile:
    """Trace file that also keeps the lines written since they were last read."""

    def __init__(self, file: IO[bytes], shares: TimeShares) -> None:
        self._file, self._shares = file, shares
        self.lines: list[bytes] = []

    def write(self, line: bytes) -> None:
        """Raises OSError."""
        began = self._shares.begin()
        self._file.write(line)
        self.lines.append(line)
        self._shares.end("trace", began)

    def flush(self) -> None:
        """Do nothing: nobody reads the file before the run's end."""

    def close(self) -> None:
        self._file.close()


class TimedNetwork(MemoryNetwork):
    """Network in memory that measures its own processing time."""

    def __init__(self, clock: Clock, seed: int, shares: TimeShares) -> None:
        super().__init__(clock, seed)
        self._shares = shares

    def send(self, sender: int, receiver: int, datagram: bytes) -> None:
        began = self._shares.begin()
        super().send(sender, receiver, datagram)
        self._shares.end("network", began)

    def arrived(self, queue: Queue) -> list[bytes]:
        began = self._shares.begin()
        taken = super().arrived(queue)
        self._shares.end("network", began)
        return taken


class Shared:
    """Objects that all agents of a run share."""

    def __init__(self, root: Path, seed: int, key: bytes, iterations: int, limit: Limit) -> None:
        self.root, self.seed, self.key = root, seed, key
        self.iterations, self.limit = iterations, limit
        self.clock = SimulatedClock()
        self.shares = TimeShares()
        self.hub = MemoryWiring()


class LockstepFleet:
    """Objects that all agents of one fleet share.

    shared: those of the whole run. Places in `network` are those of physical robots in the whole scenario."""

    def __init__(self, fleet: SimulatedFleet, shared: Shared) -> None:
        self.fleet, self.scenario, self.shared = fleet, fleet.scenario, shared
        seed = Random("/".join(filter(None, (str(shared.seed), "network", fleet.name)))).getrandbits(32)
        self.network = TimedNetwork(shared.clock, seed, shared.shares)
        self._places = EACH if fleet.is_whole else dict(enumerate(fleet.bodies))

    def transport(self, place: int) -> MemoryTransport:
        """Return a new transport for the physical robot at a place."""
        return self.network.transport(place, self._places)


class LockstepAgent(AgentHandle):
    """Agent handle of a robot in lockstep. After construction it is not yet launched."""

    def __init__(self, robot: Robot, folder: Path, own: LockstepFleet) -> None:
        super().__init__(robot, folder, own.scenario.delta)
        shared = self._shared = own.shared
        self._fleet = own
        self._place = own.fleet.bodies[robot.pid][0]
        self._settings_file = folder / "settings.json"
        self._dice = Random(f"{shared.seed}/{self._place}/agent")
        self._store = MemoryStore()
        self._log: IO[str] = self.log_file.open("w", encoding="utf-8")
        self._out: TraceFile | None = None  # the trace's file
        self._seen: list[TraceRecord] = []  # since `look` was last called
        self._own = BundleModules(
            shared.root / robot.bundle, shared.clock.now, lambda: EPOCH + shared.clock.now(), self._log
        )
        self._inside: AbstractContextManager[None] = self._own
        self._surroundings: list[LockstepServices] = []  # one per start: devices beside a crashed agent run on
        self._machine: Machine | None = None
        self._platform: Platform | None = None
        self._transport: MemoryTransport | None = None
        self._actor: Actor | None = None
        self._status: int | None = None
        self._wake = self._polled = self._thawed = 0.0

    def launch(self, actor: Actor) -> None:
        """Launch the agent. Raises OSError."""
        self._actor = actor
        settings = {
            "network": {"transport": "unicast"}, "state": None, "key_file": None, "trace": None,
            **self._overrides(actor),
        }  # fmt: skip
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
                whole = program.of(robot.pid) if isinstance(program, FleetProgram) else program
                platform = self._embodied(actor, settings, whole)
                self._platform = with_drivers(platform, whole, drivers)
                self._transport = self._fleet.transport(self._place)
                self._machine = Machine(
                    program, settings, shared.key, self._platform, shared.clock, self._transport,
                    Trace(self._out, self._warn), self._emit, self._dice.randbytes(8), self._store,  # type: ignore[arg-type]
                    monitors=self.monitors, limit=shared.limit, properties=properties,
                )  # fmt: skip
                if all(p.library is None for p in programs) and not drivers and self._own.idle:
                    self._inside = nullcontext()
        except (BadSettings, TooLarge, BadExtern) as error:
            self._fail(str(error), WRONG_PROGRAM)
        except Unready as error:
            self._fail(error.message + (f"\n  help: {error.hint}" if error.hint else ""), SURROUNDINGS)
        except Exception:
            self._fail("internal error, please report it:\n" + traceback.format_exc(), INTERNAL)

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
        network, place = self._fleet.network, self._place
        arrival = network.next_arrival(place)
        due = self._wake
        if arrival < due:
            expected, gather = machine.expects
            complete = max(network.next_arrival(place, expected), self._polled)
            due = min(due, complete, max(arrival, self._polled + gather))
        return max(due, self._thawed)

    def poll(self, now: float) -> None:
        """Run the agent for all work that is due."""
        machine = self._machine
        if machine is None:
            return
        self._polled = now
        try:
            with self._inside:
                self._wake = max(machine.poll(now), now + 1e-6)
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
        if self._transport is not None:
            self._transport.close()
        for surroundings in self._surroundings:
            surroundings.cut()
        if self._out is not None:
            self._read()
            with suppress(OSError):
                self._out.close()
        self._machine = self._platform = self._transport = self._out = None
        self._status = status

    def _fail(self, message: str, status: int) -> None:
        self._emit("error", f"error: {message}")
        self._drop(status)

    def _emit(self, level: str, line: str) -> None:
        with suppress(OSError):  # a full disk
            self._log.write(line + "\n")

    def note(self, line: str) -> None:
        """Write a line between the agent's own lines. See AgentHandle."""
        self._emit("warning", line)

    def _warn(self, text: str) -> None:
        self._emit("warning", f"warning: {text}")

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

    def look(self) -> list[TraceRecord]:
        self._read()
        records, self._seen = self._seen, []
        return records

    def _read(self) -> None:
        """Read the records traced since the last call."""
        if self._out is None:
            return
        lines, self._out.lines = self._out.lines, []
        for line in lines:
            if not line.startswith(HEADER):  # an agent's own header differs from that of the merged trace
                record = decoded(line)
                if record is not None:
                    self._record(record)
                    self._seen.append(record)

    def _failed(self, status: int) -> str | None:
        if status == 0:
            return None
        own = self.stopping.detail if self.stopping else self.last_error
        why = own.strip().splitlines()[-1:] or self.last_lines(1) or ["it said nothing"]
        return f"ended with status {status}: {why[0]}"

    def last_lines(self, count: int) -> list[str]:
        with suppress(OSError):
            self._log.flush()
        return super().last_lines(count)

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
