"""The processes of one fleet in a Lab: started, killed, started anew, and what their traces say."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from tests.chaos.bundle import KEY, NAMES
from tests.chaos.checks import is_current, rounds
from tests.chaos.lab import HUB, HUB_ADDRESS, Lab, address

MAIN = str(Path(__file__).with_name("robot_main.py"))
RELAY = str(Path(__file__).with_name("relay.py"))
FLOODER = str(Path(__file__).with_name("flooder.py"))
PORT = 47100
Line = dict[str, Any]


class Robot:
    """One robot's processes, one after the other; `lines` is all that their traces said, in order."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.lines: list[Line] = []
        self.boots = 0
        self.killed = False
        self._trace: Path | None = None
        self._at = 0
        self._first = 0  # of the lines, which the present process told

    def began(self, process: subprocess.Popen[bytes], trace: Path) -> None:
        self.process, self._trace, self._at, self.killed = process, trace, 0, False
        self._first = len(self.lines)
        self.boots += 1

    @property
    def back(self) -> bool:
        """Whether its present process has shared state."""
        lines = rounds(self.lines[self._first :])
        return any(is_current(t) for t in lines)

    @property
    def status(self) -> int | None:
        return self.process.poll() if self.process is not None else None

    def read(self) -> list[Line]:
        """Take in what the trace says by now."""
        if self._trace is not None and self._trace.exists():
            with self._trace.open("rb") as file:
                file.seek(self._at)
                whole = file.read().rpartition(b"\n")[0]
            if whole:
                self._at += len(whole) + 1
                self.lines += map(json.loads, whole.splitlines())
        return self.lines


class Swarm:
    """A context: all that was started ends with it. `folder` gets traces, logs and stores; `changes` are laid over the
    settings; `delay` (s) sends everything through a relay that holds each datagram for a random time up to it."""

    def __init__(
        self, lab: Lab, bundle: Path, folder: Path, delta: float = 0.05, delay: float = 0.0, **changes: Any
    ) -> None:
        self.lab, self.delta = lab, delta
        self.robots = {pid: Robot() for pid in range(lab.n)}
        self._bundle, self._folder, self._delay = bundle, folder, delay
        self._changes = changes
        self._helpers: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Swarm:
        self._folder.mkdir(parents=True)
        key = self._folder / "fleet.key"
        key.write_bytes(KEY)
        key.chmod(0o600)
        if self._delay:
            places = [f"{PORT + pid}={address(pid)}:{PORT + pid}" for pid in self.robots]
            command = [*self.lab.inside(HUB), sys.executable, RELAY, HUB_ADDRESS, str(self._delay), *places]
            self._helpers.append(subprocess.Popen(command))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for process in (*(r.process for r in self.robots.values()), *self._helpers):
            if process is not None:
                process.kill()
                process.wait()

    def start_all(self) -> Swarm:
        for pid in self.robots:
            self.start(pid)
        return self

    def start(self, pid: int) -> None:
        """A robot's process, also after its predecessor was killed: its store is what that left behind."""
        robot = self.robots[pid]
        robot.read()
        name = f"{NAMES[pid]}.{robot.boots}"
        trace, over = self._folder / f"{name}.jsonl", self._folder / f"{name}.json"
        over.write_text(json.dumps(self._settings(pid, trace)))
        command = [*self.lab.inside(pid), sys.executable, MAIN, str(self._bundle), "--settings", str(over)]
        with (self._folder / f"{name}.log").open("wb") as log:
            robot.began(subprocess.Popen(command, stdout=log, stderr=log), trace)

    def kill(self, pid: int) -> None:
        """As if its battery fell out."""
        robot = self.robots[pid]
        assert robot.process is not None
        robot.process.kill()
        robot.process.wait()
        robot.killed = True
        robot.read()

    def end(self) -> None:
        """Ask all to come to rest, and wait until they are."""
        running = [r.process for r in self.robots.values() if r.process is not None and r.status is None]
        for process in running:
            process.send_signal(signal.SIGTERM)
        for process in running:
            process.wait(timeout=10)
        for robot in self.robots.values():
            robot.read()

    def flood(self, seconds: float, rate: float) -> subprocess.Popen[bytes]:
        """So many bad datagrams a second to each robot, from the middle of the network."""
        places = [f"{address(pid)}:{PORT + pid}" for pid in self.robots]
        command = [*self.lab.inside(HUB), sys.executable, FLOODER, str(seconds), str(rate), *places]
        process = subprocess.Popen(command)
        self._helpers.append(process)
        return process

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Wait so long; True as soon as `until`, or when all processes that were not killed have ended."""
        limit = time.monotonic() + seconds
        while time.monotonic() < limit:
            ended = all(r.status is not None for r in self.robots.values() if not r.killed)
            for robot in self.robots.values():
                robot.read()
            if until() or ended:
                return True
            time.sleep(0.1)
        return False

    def round(self) -> int:
        """The newest round that any robot told of."""
        return max((t["round"] for r in self.robots.values() for t in r.read()[-8:] if t["kind"] == "round"), default=0)

    @property
    def lines(self) -> dict[int, list[Line]]:
        return {pid: robot.read() for pid, robot in self.robots.items()}

    def said(self) -> str:
        """The end of every log, for whoever has to find out what went wrong."""
        texts = (p.read_text(errors="replace")[-1500:] for p in sorted(self._folder.glob("*.log")))
        return "\n".join(f"{self._folder}: {text}" for text in texts)

    def _settings(self, pid: int, trace: Path) -> dict[str, Any]:
        def place(other: int) -> str:
            return HUB_ADDRESS if self._delay and other != pid else address(other)

        return {
            "robot": NAMES[pid],
            "pid": pid,
            "delta": self.delta,
            "peers": [{"name": NAMES[p], "host": place(p), "port": PORT + p} for p in self.robots],
            "key_file": "fleet.key",
            "trace": str(trace),
            "state": str(self._folder / f"{NAMES[pid]}.state"),
            **self._changes,
        }
