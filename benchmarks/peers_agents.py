"""Whole agents on real UDP sockets, each in its own process, as one side of the comparison with peers.

Only the class `Inside` accesses internals of an agent.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.peers_exchange import warm_up
from koordgen.runtime.agent.checkpoint import CheckpointFile
from koordgen.runtime.agent.machine import Agent
from koordgen.runtime.agent.rounds import PUBLISH
from koordgen.runtime.config.settings import Box, Network, Origin, Peer, Settings
from koordgen.runtime.net.codec import decode
from koordgen.runtime.net.transport import Transport
from koordgen.runtime.net.wire import RoundMessage
from koordgen.runtime.ops.set_up import open_transport
from koordgen.runtime.program.program import Cell, Event, Frame, Program, Slots, Transaction, Variable
from koordgen.runtime.trace.writer import RoundRecord, Trace
from koordgen.runtime.values.bounds import Fixed, Text
from koordgen.runtime.values.clock import SystemClock
from koordgen.runtime.values.points import Point
from koordgen.runtime.vehicle.platform import Finding, Sensed

KEY = bytes(range(32))


class Update(Transaction):
    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.report: Slots[str] = self.slots("report")
        self.count: Cell[int] = self.local("count")


def publish(state: Update) -> None:
    state.count.value += 1
    state.report.own = f"{state.count.value:0{len(state.report.own)}}"


def program(size: int) -> Program:
    """Return a program in which each robot writes `size` bytes in every round."""
    text = "0" * size
    return Program(
        name="update",
        source="update.koord",
        program_hash="00112233445566aa",
        interface_hash="aabbccddeeff0011",
        locals=(Variable("count", "local", int, Fixed(9), lambda: 0),),
        shared=(Variable("report", "allread", str, Text(size), lambda: text),),
        ports=(),
        init=None,
        events=(Event("Publish", 1, lambda s: True, publish),),
        begin=Update,
        file=__file__,
        lines={},
    )


def settings(pid: int, ports: Sequence[int], delta: float, transport: Any) -> Settings:
    """Return the settings of one robot; the last of `ports` is that of the group."""
    return Settings(
        app="update",
        robot=f"robot{pid}",
        pid=pid,
        delta=delta,
        peers=tuple(Peer(f"robot{i}", "127.0.0.1", port) for i, port in enumerate(ports[:-1])),
        origin=Origin(47.4, 8.5, 400.0),
        geofence=Box(Point(-5, -5, -1), Point(5, 5, 4)),
        network=Network(transport, "239.77.0.1", ports[-1]),
    )


class Still:
    """Body that is always ready and does not move."""

    period = 0.1
    ready = True
    stopped = True
    progress = "standing"
    stall = ""

    def diagnose(self) -> list[Finding]:
        return []

    def start(self, now: float) -> None: ...

    def poll(self, now: float) -> None: ...

    def sense(self, now: float) -> Sensed:
        return Sensed({}, now)

    def command(self, actuators: Mapping[str, Any], now: float) -> None: ...

    def call(self, port: str, args: tuple[Any, ...]) -> Any:
        raise LookupError(port)

    def others(self, paths: Mapping[int, tuple[Point, ...]]) -> None: ...

    def log_lines(self) -> list[str]:
        return []

    def hold(self, on: bool, now: float) -> None: ...

    def stop(self, now: float) -> None: ...

    def close(self) -> None: ...


class Tapped:
    """Transport that records the datagrams sent, with their times."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.sent: list[tuple[float, bytes]] = []
        self.receive, self.wait, self.close = transport.receive, transport.wait, transport.close

    @property
    def troubles(self) -> dict[str, int]:
        return self._transport.troubles

    def send(self, to: Any, datagram: bytes) -> None:
        self._transport.send(to, datagram)
        self.sent.append((time.monotonic(), datagram))


class Inside:
    """Internals of a running agent that the benchmark reads."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent

    @property
    def start(self) -> float | None:
        """Time of the tick of round 1. Fleet time is the clock of robot 0; on one host all clocks are equal."""
        rounds = self._agent._rounds
        return None if rounds is None else rounds._start

    @property
    def complete(self) -> int:
        """Last round of which the updates of all robots have arrived."""
        rounds = self._agent._rounds
        state = None if rounds is None else rounds._replica.state
        return 0 if state is None else min(state.held)


def run_agent(
    pid: int, ports: Sequence[int], transport: str, delta: float, count: int, size: int, patience: float, folder: Path
) -> dict[str, Any]:
    """Run one agent for `count` rounds. Raises TimeoutError if they do not begin within `patience` seconds.

    Return by round: seconds from the tick to consistency, and to the first sending of the own entry, infinite if that
    never happened; and the rounds without an event, with the reason. `cpu`: CPU seconds of a round.
    """
    clock, given = SystemClock(), settings(pid, ports, delta, transport)
    skipped: dict[int, str] = {}

    def note(record: RoundRecord) -> None:
        if record.event is None or record.skipped:
            skipped[record.round] = record.skipped or "no event"

    tapped = Tapped(open_transport(given))
    trace, program_ = Trace(None, print), program(size)
    store = CheckpointFile.open(folder / f"{pid}.state", program_, given.robot, pid, len(given.peers), print)
    agent = Agent(program_, given, KEY, Still(), clock, tapped, trace, _tell, os.urandom(8), store, [note])
    inside, warm = Inside(agent), warm_up(delta)
    last = warm + count
    complete, times = 0, dict[int, float]()
    limit, spent = time.monotonic() + patience, 0.0
    while agent.round < last + 10 and not agent.done:
        wake = agent.poll(clock.now())
        now, reached = time.monotonic(), inside.complete
        for round_ in range(complete + 1, reached + 1):
            times[round_] = now
        complete = reached
        if agent.round <= warm:
            spent = time.process_time()
        if agent.round == 0 and now > limit:
            raise TimeoutError(f"no round within {patience:.0f} s")
        tapped.wait(min(wake - clock.now(), 0.1), *agent.expects)
    spent = (time.process_time() - spent) / (agent.round - warm)
    tapped.close()
    store.close()
    start, never = inside.start, float("inf")
    assert start is not None
    left = entries(tapped.sent, pid)
    counted = range(warm + 1, last + 1)
    ticks = {r: start + (r - 1) * delta for r in counted}
    return {
        "consistent": [times.get(r, never) - ticks[r] for r in counted],
        "left": [left.get(r, never) - ticks[r] for r in counted],
        "deadline": PUBLISH * delta,
        "cpu": spent,
        "skipped": {r: skipped[r] for r in counted if r in skipped},
        "bytes": sum(len(d) for _, d in tapped.sent[-200:]) / max(1, len(tapped.sent[-200:])),
    }


def entries(sent: Sequence[tuple[float, bytes]], pid: int) -> dict[int, float]:
    """Return the time at which the own entry of each round was first sent."""
    left: dict[int, float] = {}
    for at, datagram in sent:
        message = decode(datagram, KEY)
        if isinstance(message, RoundMessage):
            for entry in message.entries:
                if entry.author == pid:
                    for round_ in range(entry.first, entry.round + 1):
                        left.setdefault(round_, at)
    return left


def _tell(level: str, line: str) -> None:
    """Ignore a message of the agent: errors show in the figures."""
