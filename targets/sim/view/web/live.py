"""`--live`: sends records of a run to the live view's process (serve.py) during the run.

The run never waits for that process: data that it does not read in time is dropped, it alone talks to browsers, and its
end does not end the run. It adds nothing to the trace."""

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
from targets.sim.run.run_interface import AgentHandle
from targets.sim.view.data.feed import Feed
from targets.sim.view.data.rows import Rows

if TYPE_CHECKING:
    from targets.sim.run.run import Run

SEND_EVERY = 0.1  # seconds of this host
MOST_PENDING = 4 << 20  # bytes that the process has not read yet
START_WITHIN = 20.0  # seconds
ROOT = Path(__file__).parents[4]
PIPE_SIZE = 1 << 20
SERVE = (sys.executable, "-m", "targets.sim.view.web.serve")


@contextmanager
def watched(header: Header, port: int | None, offer: dict[str, Any] | None = None) -> Iterator[Live | None]:
    """Context manager of the live view during a run; yields None without a port.

    Prints its address to standard error. Raises OSError."""
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
    """Companion that feeds the live view.

    `url` is the page's address. `offer` is what its controls offer; None for no controls. Raises OSError in the
    constructor only."""

    def __init__(self, header: Header, port: int, offer: dict[str, Any] | None = None) -> None:
        super().__init__(header)
        self._rows = Rows(header)
        self._pending = bytearray()
        self._next = 0.0
        self.is_closed = False  # the process has ended or closed the pipe
        self._incomplete = b""
        # In a session of its own: Ctrl-C on the terminal ends the run, and the run ends the view.
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
        said: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"error": "it did not start"}
        if "port" not in said:
            self._end()
            way = "name another port, or none for any that is free"
            raise OSError(f"the live view cannot use port {asked}: {said['error']}; {way}")
        return int(said["port"])

    def _add(self, record: TraceRecord, t: float) -> None:
        self._rows.add(record, t)

    def _reset(self) -> None:
        self._rows = Rows(self._header)
        self._put({"begin": True})

    def commands(self, wait: float = 0.0) -> list[dict[str, Any]]:
        """Return the commands from the page, waiting at most `wait` seconds. `is_closed`: no more will come."""
        if self.is_closed or not select.select([self._commands], [], [], wait)[0]:
            return []
        data = os.read(self._commands, 1 << 16)
        self.is_closed = not data
        *lines, self._incomplete = (self._incomplete + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def report(self, state: dict[str, Any]) -> None:
        """Send the state of the controls to the page at once."""
        self._put({"control": state})
        self._write()

    def close(self, words: str) -> None:
        """End the view with a final text, such as the path of the report.

        Takes at most some seconds. Idempotent."""
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
        """Write as much as the process accepts at once; drop all if it is gone."""
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


class PaceLimit:
    """Companion that limits a lockstep run to `factor` times real time; None for no limit.

    `waited` is true if it has ever delayed the run."""

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
        """Change the limit."""
        self.factor = factor
        self._restart(at)

    def _restart(self, at: float) -> None:
        self._host, self._clock = time.monotonic(), at

    def heard(self, agent: AgentHandle, records: list[TraceRecord]) -> None:
        pass

    def end(self, at: float) -> None:
        pass
