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

from koordgen.runtime.trace.schema import Header, TraceRecord
from targets.sim.base.bodies import BodyState
from targets.sim.run.crew import Agent
from targets.sim.view.data.feed import Feed
from targets.sim.view.data.rows import Rows

if TYPE_CHECKING:
    from targets.sim.run.run import Run

SEND_EVERY = 0.1  # seconds of this host
MOST_PENDING = 4 << 20  # bytes that the process has not taken yet
START_WITHIN = 20.0  # seconds
ROOT = Path(__file__).parents[4]
PIPE_SIZE = 1 << 20
SERVE = (sys.executable, "-m", "targets.sim.view.web.serve")


@contextmanager
def watched(header: Header, port: int | None, offer: dict[str, Any] | None = None) -> Iterator[Live | None]:
    """The live view while a run goes on, None without a port; its address goes to standard error. Raises OSError."""
    if port is None:
        yield None
        return
    view = Live(header, port, offer)
    print(f"live: {view.url}", file=sys.stderr, flush=True)
    try:
        yield view
    finally:
        view.close("the run has failed")


class Live(Feed):
    """A run's companion. `url` is where the page is; `offer` is what its controls offer, None: there are none. Raises
    OSError when it is made, nothing later."""

    def __init__(self, header: Header, port: int, offer: dict[str, Any] | None = None) -> None:
        super().__init__(header)
        self._rows = Rows(header)
        self._pending = bytearray()
        self._next = 0.0
        self.gone = False  # the process, or its end of the pipe
        self._rest = b""
        # Its own group: Ctrl-C on the terminal ends the run, and that ends the view.
        self._process = subprocess.Popen(
            [*SERVE, str(port)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0,
            env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True,
        )  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._pipe = self._process.stdin.fileno()
        with suppress(OSError, AttributeError):
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_SIZE)
        self._commands = self._process.stdout.fileno()
        self._put({"header": msgspec.to_builtins(header), "control": offer})
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

    def _take(self, record: TraceRecord, t: float) -> None:
        self._rows.take(record, t)

    def _anew(self) -> None:
        self._rows = Rows(self._header)
        self._put({"begin": True})

    def commands(self, wait: float = 0.0) -> list[dict[str, Any]]:
        """Return the commands that came from the page, at the latest after `wait` seconds. `gone`: none will come."""
        if self.gone or not select.select([self._commands], [], [], wait)[0]:
            return []
        data = os.read(self._commands, 1 << 16)
        self.gone = not data
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def report(self, state: dict[str, Any]) -> None:
        """Tell the page the state of its controls, at once."""
        self._put({"control": state})
        self._write()

    def close(self, words: str) -> None:
        """The run is over; `words` say how, and where its report is. Returns within some seconds. Idempotent."""
        if self._process.poll() is None:
            self._put({"over": words})
            deadline = time.monotonic() + 2.0
            while self._pending and time.monotonic() < deadline:
                self._write()
                time.sleep(0.01)
        self._end()

    def _send(self) -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + SEND_EVERY
            self.flush()

    def flush(self) -> None:
        """See Feed."""
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
    watch; None: as fast as it goes. `waited` is whether it ever held the run up."""

    def __init__(self, factor: float | None) -> None:
        self.factor = factor
        self.waited = False

    def launched(self, run: Run) -> None:
        self._restart(run.conduct.now())

    def step(self, at: float, states: list[BodyState]) -> None:
        ahead = 0.0
        if self.factor is not None:
            ahead = (at - self._clock) / self.factor - (time.monotonic() - self._host)
        if ahead > 0:
            self.waited = True
            time.sleep(ahead)

    def go(self, factor: float | None, at: float) -> None:
        """From now on go as fast as that."""
        self.factor = factor
        self._restart(at)

    def _restart(self, at: float) -> None:
        self._host, self._clock = time.monotonic(), at

    def heard(self, agent: Agent, records: list[TraceRecord]) -> None:
        pass

    def end(self, at: float) -> None:
        pass
