"""Outer fleets whose robots are fleets themselves, in one process on a simulated clock."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from random import Random
from types import ModuleType
from typing import Any

from benchmarks.fixtures.fleet import KEY, NAMES, FakePlatform, settings
from koordgen.build.emit.program import program_text
from koordgen.lang.semantics.composition import Application, System
from koordgen.runtime.agent.machine import Agent
from koordgen.runtime.agent.records import MemoryStore
from koordgen.runtime.agent.squad import Squad
from koordgen.runtime.agent.squad_host import HostSurroundings, SquadHost
from koordgen.runtime.config.settings import Safety
from koordgen.runtime.net.network import Conditions, MemoryNetwork
from koordgen.runtime.program.fleet_program import FleetApplication, FleetProgram
from koordgen.runtime.program.program import Program
from koordgen.runtime.program.runner import NO_EVENT
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.trace.writer import RoundRecord, Trace
from koordgen.runtime.values.clock import SimulatedClock
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.drivers import with_drivers
from tests.build.squad_files import TRIANGLE
from tests.composed.agents import AppliedRounds, CountedEvents, observing
from tests.lang.semantics.compositions import compiled

INNER = 0.1  # seconds in a round of the inner fleets
OUTER = 0.5  # seconds in a round of the outer fleet
QUIET = Conditions(delay=0.001, jitter=0.004)
LOSSY = Conditions(loss=0.2, delay=0.001, jitter=0.01, duplication=0.05)

WAVE = """
using Motion:
  sensors:
    Point position
    bool reached
  actuators: Point target at position clears reached
allread: Point x[N_SYS]
local: int k
init:
  x[pid] = Motion.position
Go:
  pre: Motion.reached or k % 5 < 3
  eff:
    k += 1
    if k % 2 == 0:
      Motion.target = Point(k % 5, 2 * pid, 9)  # above the geofence
    x[pid] = Motion.position
Wait:
  pre: True
  eff: k += 1
"""


def loaded(name: str, text: str) -> Any:
    """Return the generated module of a program."""
    module = ModuleType(name)
    sys.modules[name] = module
    vars(module)["__file__"] = f"{name}.py"
    exec(compile(program_text(compiled(name, text)), f"{name}.py", "exec"), vars(module))
    return module


_triangle = loaded("program_triangle", TRIANGLE)


def squad_of(outer: Program) -> Squad:
    """Return the squad of triangles that an outer program sees."""
    used = {port.name for port in outer.ports}
    sensors = {
        "Motion.position": _triangle.provided_motion_position,
        "Motion.reached": _triangle.provided_motion_reached,
    }
    return Squad(0, {n: f for n, f in sensors.items() if n in used}, {"Motion.target": "goal"}, outer)


class TraceFile(io.BytesIO):
    """Trace of one agent, which stays readable when the agent has closed it."""

    def close(self) -> None:
        pass


class Between(MemoryNetwork):
    """Network of the outer fleet. `note_send`: function that is called with the place of each sender."""

    note_send: Callable[[int], None]

    def send(self, sender: int, receiver: int, datagram: bytes) -> None:
        self.note_send(sender)
        super().send(sender, receiver, datagram)


@dataclass
class Node:
    """Process of one physical robot: its agent, and the host of the outer robot if it is in a squad.

    fleet: outer pid of its squad; -1 for an ordinary robot of the outer fleet. pid: its pid in that fleet.
    """

    place: int
    fleet: int
    pid: int
    agent: Agent
    platform: FakePlatform
    clock: SimulatedClock
    host: SquadHost | None = None
    wake: float = 0.0
    lines: list[str] = field(default_factory=list)

    @property
    def outer(self) -> Agent | None:
        return self.agent if self.host is None else self.host.outer


class Levels(CountedEvents):
    """Outer fleet of `sizes` robots: a number above 0 is the number of robots of a squad, 0 an ordinary robot.

    `records` and `applied` are those of the outer fleet. `files`: squad (-1: the outer fleet) and pid -> traces of the
    robot, one for each start of its agent, with the clock of its times.
    """

    def __init__(
        self, text: str, sizes: Sequence[int], seed: int = 1, conditions: Conditions = QUIET, timeout: int = 10
    ) -> None:
        self.time, self.random = SimulatedClock(), Random(seed)
        self.sizes = tuple(sizes)
        self.outer_program: Program = loaded("outer_program", text).PROGRAM
        super().__init__(System((Application("app", compiled("app", text), tuple(range(len(sizes)))),), len(sizes)))
        self.applied = AppliedRounds(self._counts)
        self.safety = Safety(position_stale=0.7, position_lost=10000.0, peer_timeout=timeout)
        self.between = Between(self.time, self.random.getrandbits(32), conditions)
        self.between.note_send = self._note_send
        self.inside = [MemoryNetwork(self.time, self.random.getrandbits(32), conditions) for _ in sizes]
        self.nodes: dict[int, Node] = {}
        self.limits: list[float] = []  # seconds that each outer event on a host might take
        self.down: set[int] = set()  # places of the robots that are killed
        self.frozen: dict[int, float] = {}  # place -> time at which a frozen process continues
        self.files: dict[tuple[int, int], list[tuple[SimulatedClock, io.BytesIO]]] = {}
        self.hosts: list[tuple[float, int, int]] = []  # (time, outer pid, inner pid): changes of a host
        self._began: dict[Agent, int] = {}  # outer agents on hosts, in the order in which they began
        self.sent_by_former_hosts: list[tuple[float, int]] = []  # (time, place): messages of hosts that were replaced
        self._sending: dict[int, int] = {}  # outer pid of a squad -> number of the newest host that has sent a message
        self._recorded: dict[tuple[int, int], int] = {}  # outer pid and round -> the same number of the record's agent
        self._where: list[tuple[int, int]] = []  # place -> (squad or -1, pid)
        self._of_squad: dict[int, list[int]] = {}  # outer pid of a squad -> places of its robots
        for pid, size in enumerate(sizes):
            self._of_squad[pid] = list(range(len(self._where), len(self._where) + max(1, size)))
            self._where += [(pid, inner) for inner in range(size)] or [(-1, pid)]
        self._kept = [MemoryStore() for _ in self._where]
        self._clocks = [SimulatedClock(self.time, 100.0 * (p + 1), 1 + 20e-6 * p) for p in range(len(self._where))]
        for place in range(len(self._where)):
            self.boot(place)

    def boot(self, place: int) -> Node:
        """Start or restart the process of a physical robot."""
        fleet, pid = self._where[place]
        clock, lines = self._clocks[place], list[str]()
        old = self.nodes.get(place)
        platform = FakePlatform(old.platform.position if old else Point(place, 0, 0))
        transport = self.between.transport(place, self._of_squad)

        def trace(of_outer: bool = True) -> Trace:
            file = TraceFile()
            self.files.setdefault((-1, fleet) if of_outer and fleet >= 0 else (fleet, pid), []).append((clock, file))
            return Trace(file, lines.append)

        if fleet < 0:
            agent = Agent(
                self.outer_program, settings(pid, len(self.sizes), OUTER, safety=self.safety), KEY, platform, clock,
                transport, trace(), lambda level, line: lines.append(line), self.random.randbytes(8),
                self._kept[place], monitors=[lambda record: self._keep(pid, place, record)],
            )  # fmt: skip
            host = None
        else:
            around = HostSurroundings(
                settings(fleet, len(self.sizes), OUTER, safety=self.safety), KEY, NAMES[pid], self.random.randbytes(8),
                clock, transport, trace, lambda level, line: lines.append(line), self._limit,
                monitors=(lambda record: self._keep(fleet, place, record),),
            )  # fmt: skip
            size = self.sizes[fleet]
            inner = FleetProgram(
                (FleetApplication("triangle", _triangle.PROGRAM, tuple(range(size))),), size,
                _triangle.PROGRAM.program_hash, _triangle.PROGRAM.interface_hash,
            )  # fmt: skip
            host = SquadHost(squad_of(self.outer_program), inner, pid, INNER, around)
            body = with_drivers(platform, host.fleet.of(pid), host.drivers)
            agent = Agent(
                host.fleet, settings(pid, size, INNER, application_id=fleet + 1), KEY, body, clock,
                self.inside[fleet].transport(pid), trace(False), lambda level, line: lines.append(line),
                self.random.randbytes(8), self._kept[place],
            )  # fmt: skip
            host.attach(agent)
        self.down.discard(place)
        node = self.nodes[place] = Node(place, fleet, pid, agent, platform, clock, host, self.time.time, lines)
        return node

    def kill(self, place: int) -> None:
        """End the process of a physical robot at once."""
        fleet, pid = self._where[place]
        self.down.add(place)
        self.between._queues.pop(place, None)
        if fleet >= 0:
            self.inside[fleet]._queues.pop(pid, None)

    def freeze(self, place: int, seconds: float) -> None:
        """Stop the process of a robot for some time. What arrives meanwhile waits for it."""
        self.frozen[place] = self.time.time + seconds

    def cut(self, place: int, outside: bool) -> None:
        """Cut the links of a robot to the others of its squad; with `outside`, also to the outer fleet."""
        squad, pid = self._where[place]
        self.inside[squad].cut = lambda sender, receiver: pid in (sender, receiver)
        if outside:
            self.between.cut = lambda sender, receiver: place in (sender, receiver)

    def restore(self) -> None:
        """Restore all links."""
        for network in (self.between, *self.inside):
            network.cut = lambda sender, receiver: False

    def _limit(self, seconds: float) -> AbstractContextManager[None]:
        self.limits.append(seconds)
        return nullcontext()

    def _note_send(self, place: int) -> None:
        """Record a message of a host whose successor has already sent a message."""
        node = self.nodes[place]
        if node.fleet >= 0 and node.outer is not None:
            number = self._began.get(node.outer, len(self._began))
            newest = self._sending.setdefault(node.fleet, number)
            if number < newest:
                self.sent_by_former_hosts.append((self.time.time, place))
            self._sending[node.fleet] = max(number, newest)

    def _counts(self, state: StateMachine) -> bool:
        """Return whether a store is that of an outer robot, and on its newest host."""
        newest: dict[int, Agent] = {}
        for node in self.nodes.values():
            if node.outer is not None:
                pid = node.fleet if node.fleet >= 0 else node.pid
                newest[pid] = max(newest.get(pid, node.outer), node.outer, key=lambda agent: self._began.get(agent, 0))
        return any(agent.state is state for agent in newest.values())

    def _keep(self, outer: int, place: int, record: RoundRecord) -> None:
        """Keep a record. A host that has been replaced may still record rounds, which no longer count."""
        agent = self.nodes[place].outer
        assert agent is not None
        number = self._began.get(agent, 0)
        if number >= self._recorded.get((outer, record.round), number):
            self.records[outer, record.round] = record
            self._recorded[outer, record.round] = number

    def places(self, squad: int) -> list[int]:
        """Return the places of the robots of a squad."""
        return self._of_squad[squad]

    def host(self, squad: int) -> Node | None:
        """Return the node that hosts an outer robot now."""
        running = [self.nodes[p] for p in self._of_squad[squad] if p not in self.down and self.nodes[p].outer]
        return running[-1] if running else None

    def outer(self, pid: int) -> Agent | None:
        """Return the agent of an outer robot."""
        node = self.host(pid)
        return None if node is None else node.outer

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run for some time, or until a condition holds. Return whether it held."""
        end = self.time.time + seconds
        with observing(self.applied):
            while not until():
                first, node = math.inf, None
                for other in self.nodes.values():
                    if other.place not in self.down and not other.agent.done and (due := self._due(other)) < first:
                        first, node = due, other
                if node is None or first > end:
                    self.time.time = end
                    return until()
                self.time.time = max(self.time.time, first)
                self._poll(node)
        return True

    def _due(self, node: Node) -> float:
        arrival = self.between.next_arrival(node.place)
        if node.fleet >= 0:
            arrival = min(arrival, self.inside[node.fleet].next_arrival(node.pid))
        return max(min(node.wake, arrival), self.frozen.get(node.place, 0.0))

    def _poll(self, node: Node) -> None:
        before = node.outer
        wake = node.agent.poll(node.clock.now())
        if node.host is not None:
            wake = min(wake, node.host.poll(node.clock.now()))
            if node.outer is not before and node.outer is not None:
                self.hosts.append((self.time.time, node.fleet, node.pid))
                self._began[node.outer] = len(self._began)
        node.wake = max(node.clock.true(wake), self.time.time + 1e-6)

    def run_rounds(self, rounds: int, seconds: float = 60.0) -> None:
        """Run until each outer robot has taken part in an outer round from `rounds` on."""
        robots = range(len(self.sizes))
        done = self.run(seconds + rounds * OUTER, lambda: min(map(self.last_part, robots)) >= rounds)
        assert done, {p: (n.agent.phase, n.agent.round, n.lines[-4:]) for p, n in self.nodes.items()}

    def last_part(self, robot: int) -> int:
        """Return the last outer round in which an outer robot ran an event, or had none to run."""
        return max(
            [r for p, r in self.records if p == robot and self.records[p, r].skipped in (None, NO_EVENT)], default=0
        )

    @property
    def complete(self) -> int:
        """Last outer round of which each outer robot has recorded the result."""
        return min(max(r for p, r in self.records if p == robot) for robot in range(len(self.sizes)))
