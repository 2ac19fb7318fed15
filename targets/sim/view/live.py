"""`--live`: what happens in a run goes to the live view's process (serve.py) while it happens.

The run never waits for it: what the process does not take in time is dropped, it alone meets browsers, and its end is
not the run's. Nothing of it gets into the trace.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from targets.sim.bodies import BodyState
from targets.sim.crew import Agent
from targets.sim.trace import Header, Init, Phase, Pose, Record, Round, Violation
from targets.sim.view.rows import Rows

if TYPE_CHECKING:
    from targets.sim.run import Run

POSE_EVERY = 12  # steps, as in the trace
SEND_EVERY = 0.1  # seconds of this host
MOST_PENDING = 4 << 20  # bytes that the process has not taken yet
START_WITHIN = 20.0  # seconds
ROOT = Path(__file__).parents[3]
PIPE_SIZE = 1 << 20
SERVE = (sys.executable, "-m", "targets.sim.view.serve")


@contextmanager
def watched(header: Header, port: int | None) -> Iterator[Live | None]:
    """The live view while a run goes on, None without a port; its address goes to standard error. Raises OSError."""
    if port is None:
        yield None
        return
    view = Live(header, port)
    print(f"live: {view.url}", file=sys.stderr, flush=True)
    try:
        yield view
    finally:
        view.close("the run has failed")


class Live:
    """A run's companion. `url` is where the page is. Raises OSError when it is made, nothing later."""

    def __init__(self, header: Header, port: int) -> None:
        self._header = header
        self._rows = Rows(header)
        self._pending = bytearray()
        self._next = 0.0
        self._steps = 0
        self._told = 0  # marks of the run
        self._seen: set[tuple[str, tuple[int, int]]] = set()  # what the stage's watch has found
        self._names = [robot.name for robot in header.robots]
        self._begun = False
        self._early: list[tuple[Agent, list[Record]]] = []  # heard before it was known when round 1 began
        # Its own group: Ctrl-C on the terminal ends the run, and that ends the view.
        self._process = subprocess.Popen(
            [*SERVE, str(port)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)},
            start_new_session=True,
        )  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._pipe = self._process.stdin.fileno()
        with suppress(OSError, AttributeError):
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_SIZE)
        self._put({"header": msgspec.to_builtins(header)})
        with suppress(OSError):
            os.write(self._pipe, self._pending)
        self._pending.clear()
        os.set_blocking(self._pipe, False)
        self.url = f"http://127.0.0.1:{self._port(port)}/"

    def _port(self, asked: int) -> int:
        output = self._process.stdout
        assert output is not None
        line = output.readline() if select.select([output], [], [], START_WITHIN)[0] else b""
        said: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"error": "it did not begin"}
        if "port" not in said:
            self._end()
            way = "name another port, or none for any that is free"
            raise OSError(f"the live view cannot use port {asked}: {said['error']}; {way}")
        return int(said["port"])

    def launched(self, run: Run) -> None:
        self._run = run
        self._launched = run.conduct.now()

    def step(self, at: float, states: list[BodyState]) -> None:
        """Poses at the rate of the trace's."""
        self._steps += 1
        if self._steps % POSE_EVERY != 1:
            return
        if not self._begun and self._run.zero is not None:
            self._begin()
        t = self._t(at)
        for pid, state in enumerate(states):
            self._rows.take(Pose(pid, state.position, state.yaw), t)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + SEND_EVERY
            self._marks()
            self._send()

    def heard(self, agent: Agent, records: list[Record]) -> None:
        if not self._begun:
            self._early.append((agent, [r for r in records if isinstance(r, (Init, Round))]))
        for record in records:
            if not isinstance(record, (Header, Violation)) and hasattr(record, "pid"):
                own = msgspec.structs.replace(record, pid=agent.robot.pid)
                self._rows.take(own, self._t(getattr(record, "time", 0.0)))

    def end(self, at: float) -> None:
        self._marks()
        self._send()

    def close(self, words: str) -> None:
        """The run is over; `words` say how, and where its report is. Returns within some seconds. Idempotent."""
        if self._process.poll() is None:
            self._put({"over": words})
            deadline = time.monotonic() + 2.0
            while self._pending and time.monotonic() < deadline:
                self._write()
                time.sleep(0.01)
        self._end()

    def _t(self, at: float) -> float:
        """Seconds since round 1, before that since the launch."""
        t = self._run.t(at) if self._begun else None
        return at - self._launched if t is None else t

    def _begin(self) -> None:
        """Round 1 has been heard of: from now on times count from it."""
        self._begun = True
        self._rows = Rows(self._header)
        self._put({"begin": True})
        for agent in self._run.conduct.agents:
            self._rows.take(Phase(agent.phase.phase, agent.phase.detail, pid=agent.robot.pid), 0.0)
        for agent, records in self._early:
            self.heard(agent, records)
        self._early.clear()

    def _marks(self) -> None:
        """What was found since the last time, by the stage's watch and by other companions."""
        watch = self._run.stage.watch
        for (i, j), close in watch.too_close.items():
            if self._new("separation", (i, j)):
                detail = f"{close.distance:.3f} m apart, less than {watch.min_separation:g} m"
                self._violation(close.time, "separation", (i, j), detail)
        for (i, j), at in watch.collisions.items():
            if self._new("collision", (i, j)):
                self._violation(at, "collision", (i, j), "their bodies touched")
        for (i, number), at in watch.bumps.items():
            if self._new("bump", (i, number)):
                self._violation(at, "collision", (i,), f"touched obstacle {number}")
        marks = self._run.marks
        for mark in marks[self._told :]:
            self._rows.take(mark, self._t(mark.t))
        self._told = len(marks)

    def _new(self, what: str, who: tuple[int, int]) -> bool:
        known = (what, who) in self._seen
        self._seen.add((what, who))
        return not known

    def _violation(self, at: float, what: str, pids: tuple[int, ...], detail: str) -> None:
        t = self._t(at)
        self._rows.take(Violation(t, what, tuple(self._names[pid] for pid in pids), detail), t)

    def _send(self) -> None:
        chunk = self._rows.taken()
        if chunk and len(self._pending) < MOST_PENDING:
            self._put({"rows": chunk})
        self._write()

    def _put(self, what: dict[str, Any]) -> None:
        self._pending += msgspec.json.encode(what) + b"\n"

    def _write(self) -> None:
        """As much as the process takes at once; nothing more when it is gone."""
        try:
            del self._pending[: os.write(self._pipe, self._pending)]
        except BlockingIOError:
            pass
        except OSError:
            self._pending.clear()

    def _end(self) -> None:
        process = self._process
        for end in (process.stdin, process.stdout):
            with suppress(OSError):
                assert end is not None
                end.close()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Paced:
    """A companion of a run in lockstep that lets it go no faster than `factor` times real time, so that one can
    watch."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def launched(self, run: Run) -> None:
        self._host, self._clock = time.monotonic(), run.conduct.now()

    def step(self, at: float, states: list[BodyState]) -> None:
        ahead = (at - self._clock) / self._factor - (time.monotonic() - self._host)
        if ahead > 0:
            time.sleep(ahead)

    def heard(self, agent: Agent, records: list[Record]) -> None:
        pass

    def end(self, at: float) -> None:
        pass
