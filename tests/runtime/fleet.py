"""A fleet in one process on a simulated clock: agents, an in-memory network, first-order robots, and what they did."""

from __future__ import annotations

import io
import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any

from koordgen.runtime.clock import SimulatedClock
from koordgen.runtime.machine import Agent
from koordgen.runtime.network import Conditions, MemoryNetwork
from koordgen.runtime.platform import Finding, Sensed
from koordgen.runtime.program import Program
from koordgen.runtime.settings import Box, Origin, Peer, Safety, Settings
from koordgen.runtime.store import KEPT, Acceptor, Loaded, Locals, Mission
from koordgen.runtime.trace import Record, Trace
from koordgen.runtime.values import Point, distance
from tests.runtime.lineform import PROGRAM

NAMES = (
    "alice",
    "bert",
    "cleo",
    "dora",
    "emil",
    "finn",
    "gina",
    "hugo",
    "ines",
    "jan",
    "kim",
    "lola",
    "mia",
    "nils",
    "olga",
    "paul",
)
STARTS = (Point(-4, -1.5), Point(-3, 2.5), Point(1.5, -2.5), Point(0.5, 3.2), Point(4, 1.5))
KEY = bytes(range(32))


def settings(pid: int, n: int, delta: float = 0.1, **changes: Any) -> Settings:
    return Settings(
        app="lineform",
        robot=NAMES[pid],
        pid=pid,
        delta=delta,
        peers=tuple(Peer(NAMES[i], "127.0.0.1", 47100 + i) for i in range(n)),
        origin=Origin(47.4, 8.5, 488.0),
        geofence=Box(Point(-6, -5, -0.5), Point(6, 5, 4)),
        **changes,
    )


class Kept:
    """What a robot keeps, for the next process that is the same robot; no more than the file does."""

    def __init__(self) -> None:
        self.mission: Mission | None = None
        self.locals: deque[Locals] = deque(maxlen=KEPT + 1)
        self.acceptor: Acceptor | None = None

    def write(self, record: Mission | Locals | Acceptor) -> bool:
        match record:
            case Mission():
                self.mission = record
            case Acceptor():
                self.acceptor = record
            case Locals():
                self.locals.append(record)
        return True

    def load(self) -> Loaded:
        newest = {record.round: record for record in self.locals}
        return Loaded(self.mission, tuple(newest[r] for r in sorted(newest)[-KEPT:]), self.acceptor)

    def clear(self) -> None:
        self.__init__()  # type: ignore[misc]


class FakePlatform:
    """Moves to its target at 1 m/s; ready, fresh and able to rest as the test says."""

    period = 0.02

    def __init__(self, position: Point, ready_after: float = 0.1) -> None:
        self.position = position
        self.target = position
        self.ready_after = ready_after
        self.started: float | None = None
        self.last = 0.0
        self.held = False
        self.fresh = True
        self.seen = 0.0
        self.resting: float | None = None
        self.commands: list[tuple[float, Mapping[str, Any]]] = []
        self.raises: Exception | None = None
        self.closed = False
        self.now = 0.0
        self.goal_reached = True
        self.seen_paths: list[dict[int, tuple[Point, ...]]] = []
        self.told: list[str] = []
        self.stall = ""

    def diagnose(self) -> list[Finding]:
        return [Finding("fake", "ok", "a fake body")]

    def start(self, now: float) -> None:
        self.started = self.last = now

    def poll(self, now: float) -> None:
        if self.raises is not None:
            raise self.raises
        step, self.last, self.now = now - self.last, now, now
        if self.fresh:
            self.seen = now
        away = distance(self.target, self.position)
        if not self.held and self.resting is None and away > 0:
            self.position = self.position + (self.target - self.position) * min(1.0, step / away)
        self.goal_reached = distance(self.target, self.position) < 0.05

    @property
    def ready(self) -> bool:
        return self.started is not None and self.now - self.started >= self.ready_after

    @property
    def progress(self) -> str:
        return "warming up"

    def sense(self, now: float) -> Sensed:
        values = {"Motion.position": self.position, "Motion.reached": self.goal_reached}
        return Sensed(values, self.seen)

    def command(self, actuators: Mapping[str, Any], now: float) -> None:
        self.commands.append((now, dict(actuators)))
        self.target = actuators.get("Motion.target", self.target)

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        return args[:1]

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None:
        self.seen_paths.append(dict(paths))

    def news(self) -> list[str]:
        told, self.told = self.told, []
        return told

    def hold(self, on: bool, now: float) -> None:
        self.held = on

    def rest(self, now: float) -> None:
        if self.resting is None:
            self.resting = now

    @property
    def rested(self) -> bool:
        return self.resting is not None and self.now - self.resting >= 0.2

    def close(self) -> None:
        self.closed = True


@dataclass
class Robot:
    agent: Agent
    platform: FakePlatform
    clock: SimulatedClock
    file: io.BytesIO
    lines: list[str] = field(default_factory=list)
    records: list[Record] = field(default_factory=list)
    wake: float = 0.0

    def held(self) -> bool:
        return self.platform.held

    def done(self) -> bool:
        return self.agent.done

    def trace(self, kind: str) -> list[dict[str, Any]]:
        return self.lines_of(kind)

    def lines_of(self, *kinds: str, with_: str = "kind") -> list[dict[str, Any]]:
        """The trace's lines of these kinds that have a field."""
        return [t for t in map(json.loads, self.file.getvalue().splitlines()) if t["kind"] in kinds and with_ in t]


class Fleet:
    """`run` moves simulated time from event to event: an agent's wish or a datagram's arrival."""

    def __init__(
        self,
        n: int = 5,
        seed: int = 1,
        conditions: Conditions | None = None,
        program: Program = PROGRAM,
        delta: float = 0.1,
        clocks: Callable[[int, SimulatedClock], SimulatedClock] | None = None,
        key: bytes | None = KEY,
        safety: Safety | None = None,
    ) -> None:
        self.time = SimulatedClock()
        self.network = MemoryNetwork(self.time, seed, conditions or Conditions(delay=0.001, jitter=0.004))
        self.random = Random(seed)
        self.n, self.program, self.delta, self.key = n, program, delta, key
        self.safety = safety or Safety()
        skewed = clocks or (lambda pid, base: SimulatedClock(base, offset=100.0 * (pid + 1), rate=1 + 20e-6 * pid))
        self._clocks = [skewed(pid, self.time) for pid in range(n)]
        self.robots: dict[int, Robot] = {}
        self.kept = [Kept() for _ in range(n)]

    def boot(self, pid: int, platform: FakePlatform | None = None, **changes: Any) -> Robot:
        """Start (or start anew) one robot's process. `output`: where its trace goes in place of memory."""
        body = platform or FakePlatform(STARTS[pid % len(STARTS)])
        file, lines, records = io.BytesIO(), list[str](), list[Record]()
        program, key = changes.pop("program", self.program), changes.pop("key", self.key)
        output = changes.pop("output", file)
        properties, cpu = changes.pop("properties", None), changes.pop("cpu", None)
        agent = Agent(
            program,
            settings(pid, self.n, self.delta, safety=self.safety, **changes),
            key,
            body,
            self._clocks[pid],
            self.network.transport(pid),
            Trace(output, lines.append),
            lambda level, line: lines.append(line),
            self.random.randbytes(8),
            self.kept[pid],
            monitors=[records.append],
            properties=properties,
            cpu=cpu,
        )
        robot = self.robots[pid] = Robot(agent, body, self._clocks[pid], file, lines, records, self.time.time)
        return robot

    def boot_all(self) -> Fleet:
        for pid in range(self.n):
            self.boot(pid)
        return self

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = self.time.time + seconds
        while not until():
            first, robot = math.inf, None
            for pid, other in self.robots.items():
                if not other.agent.done and (due := min(other.wake, self.network.next_arrival(pid))) < first:
                    first, robot = due, other
            if robot is None or first > end:
                self.time.time = end
                return
            self.time.time = max(self.time.time, first)
            wake = robot.clock.true(robot.agent.poll(robot.clock.now()))
            robot.wake = max(wake, self.time.time + 1e-6)

    def run_rounds(self, rounds: int) -> None:
        self.run(
            60 + rounds * self.delta,
            until=lambda: all(r.agent.round >= rounds or r.agent.done for r in self.robots.values()),
        )
        assert all(r.agent.round >= rounds or r.agent.done for r in self.robots.values())

    def run_told(self, rounds: int) -> None:
        """Until every robot's records go so far: what a round came to is told once it is certain."""

        def told() -> bool:
            return all(r.agent.done or (r.records and r.records[-1].round >= rounds) for r in self.robots.values())

        self.run(60 + rounds * self.delta, until=told)
        assert told()
