"""Stand-ins for the agents of a fleet: real control ports, with reports made of the runtime's own parts."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from benchmarks.fixtures.fleet import KEY
from koordgen.runtime.config.settings import Box, Origin, Peer, Settings
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.ops.control import Control
from koordgen.runtime.ops.recent import Recent
from koordgen.runtime.program.program import Effects
from koordgen.runtime.trace.writer import RoundRecord
from koordgen.runtime.values.points import Point
from tests.runtime.net.transports import free_ports

DELTA = 0.1
FENCE = Box(Point(-6, -5, -0.5), Point(6, 5, 4))


class StandIn:
    """One robot: it flies in a circle. `changes` replaces entries of its report; `reports` counts those made, and the
    report's `round` is that number."""

    def __init__(self, pid: int, peers: tuple[Peer, ...], port: int) -> None:
        own = Settings("show", peers[pid].name, pid, DELTA, peers, Origin(47.4, 8.5, 488.0), FENCE, control=port)
        self.name, self.pid, self.port, self.peers = peers[pid].name, pid, port, peers
        self.control = Control.open(own, KEY)
        self.recent, self.metrics = Recent(), Metrics(pid, len(peers))
        self.changes: dict[str, Any] = {}
        self.reports = 0
        self.stopped = False
        self.deaf = False
        self.recent.line(time.monotonic(), 0, "info", "running: mission 0123")

    def place(self, now: float) -> Point:
        turn = now / 8 + self.pid * math.tau / len(self.peers)
        return Point(4 * math.cos(turn), 4 * math.sin(turn), 1.0 + 0.1 * self.pid)

    def report(self) -> dict[str, Any]:
        self.reports += 1
        now, number = time.monotonic(), self.reports
        place = self.place(now)
        event = "Move" if number % 5 else None
        effects = Effects({}, {"at": place}, {}, False) if event else None
        why = None if event else "no event enabled"
        self.recent.round(RoundRecord(number, now, 0.002, {}, None, event, effects, why))
        self.metrics.round(number, 0.002, event, why, True)
        self.metrics.heard([(peer, 1, 0.004) for peer in range(len(self.peers)) if peer != self.pid], now)
        fence = [[p.x, p.y, p.z] for p in (FENCE.lo, FENCE.hi)]
        return {
            "boot": f"{self.pid:016x}", "app": "show", "release": "a" * 32, "robot": self.name, "pid": self.pid,
            "names": [peer.name for peer in self.peers], "phase": "stopping" if self.stopped else "running",
            "round": number, "delta": DELTA, "geofence": fence, "monitors": {"counts": {"held": 2}, "violated": []},
            "host": {"clock_ms": 0.31, "disk_gb": 21.5, "temperature": 48.0},
            "pose": {"position": [place.x, place.y, place.z], "yaw": now / 8 % math.tau, "age": 0.02},
            "battery": 0.8, "goal": [[0.0, 0.0, 2.0]], **self.recent.report(now, {"at": "allread"}),
            **self.metrics.snapshot(now, {}), **self.changes,
        }  # fmt: skip

    def poll(self) -> None:
        if not self.deaf:
            self.stopped = self.control.poll(time.monotonic(), "stopping" if self.stopped else "running", self.report)


class StandIns:
    """A fleet of stand-ins that answer while the block lasts. `fleet` is its fleet file, the key beside it."""

    def __init__(self, folder: Path, count: int) -> None:
        ports = free_ports(2 * count)
        peers = tuple(Peer(f"robot{pid:02}", "127.0.0.1", port) for pid, port in enumerate(ports[:count]))
        self.robots = [StandIn(pid, peers, ports[count + pid]) for pid in range(count)]
        self.fleet = folder / "fleet.yaml"
        robots = [
            f"  - {{name: {r.name}, target: quad, address: '127.0.0.1:{peers[r.pid].port}', control: {r.port},\n"
            f"     start: {{position: [{r.pid - count / 2:.1f}, 0.0, 0.0]}}}}"
            for r in self.robots
        ]
        head = f"delta: {DELTA}\norigin: {{latitude: 47.4, longitude: 8.5, altitude: 488.0}}\n"
        fence = "geofence: {lo: [-6.0, -5.0, -0.5], hi: [6.0, 5.0, 4.0]}\n"
        walls = "obstacles:\n  - {lo: [1.0, 1.0, 0.0], hi: [2.0, 2.0, 2.0]}\n"
        self.fleet.write_text(f"{head}{fence}{walls}robots:\n" + "\n".join(robots) + "\n")
        key = folder / "fleet.key"
        key.write_bytes(KEY)
        key.chmod(0o600)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._over.wait(0.005):
            for robot in self.robots:
                robot.poll()

    def __enter__(self) -> StandIns:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        for robot in self.robots:
            robot.control.close()
