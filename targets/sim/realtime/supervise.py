"""Agent processes: one per robot, each running its bundle unchanged."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import TraceRecord
from targets.sim.base.scenario import Robot
from targets.sim.run.run_interface import AgentHandle
from targets.sim.trace.files import Tail

_SET_DEATH_SIGNAL = 1  # prctl: PR_SET_PDEATHSIG
_BEHIND = 5  # niceness of agents: the world has priority, for all agents wait for its steps
# Exit statuses that are normal after a request to end: done, or interrupted.
GOOD_ENDS = (0, 130, 128 + signal.SIGTERM)


def overrides(
    identity: tuple[str, int, int], peers: list[dict[str, Any]], key_file: Path, trace: Path
) -> dict[str, Any]:
    """Return the settings that override those of an agent: addresses and files of this run.

    `identity`: name, pid and application id of the robot. With these three, the commands for real robots work on the
    robots of the run."""
    name, pid, application = identity
    return {
        "robot": name,
        "pid": pid,
        "application_id": application,
        "peers": peers,
        "bind": "",
        "network": {"transport": "unicast"},  # the bundle's groups and endpoints are those of the real network
        "key_file": str(key_file.resolve()),
        "insecure": False,
        "trace": str(trace.resolve()),
        "trace_limit": None,  # the run reads the file as it grows, and merges all of it at the end
    }


class AgentProcess(AgentHandle):
    """Agent handle of a robot whose bundle runs as a process.

    Its persistent state is in `state` in its folder."""

    def __init__(self, robot: Robot, bundle: Path, folder: Path, delta: float) -> None:
        super().__init__(robot, folder, delta)
        self.state_folder = folder / "state"
        self._settings_file = folder / "settings.json"
        self._bundle = bundle
        self._tail = Tail(self.trace_file)
        self._process: subprocess.Popen[bytes] | None = None
        self._settings: dict[str, Any] = {}
        self._command: list[str] = []
        self._path = ""
        self._lives = [self.trace_file]  # trace files, one per start
        self._thaw: threading.Timer | None = None
        self._stopped: subprocess.Popen[bytes] | None = None  # the frozen process

    def application(self, file: str = "settings.json") -> int:
        """Return the application_id in a settings file of the bundle; 0 if the bundle has none."""
        try:
            settings = msgspec.json.decode((self._bundle / file).read_bytes())
        except FileNotFoundError:
            return 0
        return int(settings["application_id"])

    def launch(self, settings: dict[str, Any], command: list[str] | None = None, path: str = "") -> None:
        """Start the process: the bundle, or in its place `command` with `path` as PYTHONPATH. Raises OSError."""
        self._settings, self._command, self._path = settings, command or [str(self._bundle.resolve())], path
        self._settings_file.write_bytes(msgspec.json.format(msgspec.json.encode(settings), indent=2) + b"\n")
        # The numeric libraries of all agents share the cores of one host.
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        if path:
            environment["PYTHONPATH"] = path
        with self.log_file.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, *self._command, "--settings", str(self._settings_file.resolve())],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                cwd=self._settings_file.parent,
                start_new_session=True,  # the harness forwards Ctrl-C itself
                preexec_fn=_second_to_parent,
            )

    @property
    def status(self) -> int | None:
        return self._process.poll() if self._process else None

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def process_id(self) -> int | None:
        return self._process.pid if self._process is not None and self._process.poll() is None else None

    def request_end(self) -> None:
        self.asked_to_end = True
        if self._process and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            if self._thaw is None:  # end an unlimited freeze, or the agent could not stop safely
                self.thaw()

    def kill(self) -> None:
        if self._process and self._process.poll() is None:
            self.killed = True
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def crash(self) -> None:
        if self._process and self._process.poll() is None:
            self.crashed = True
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def restart(self) -> None:
        self.crash()
        if not self.crashed or self.asked_to_end:  # it ended by itself, or should end
            return
        while self.look():
            pass
        # An agent overwrites its trace, so each start has a file of its own until the run's end.
        self._lives.append(self.trace_file.with_name(f"trace-{len(self._lives) + 1}.jsonl"))
        self._tail = Tail(self._lives[-1])
        self.crashed = False
        self.launch({**self._settings, "trace": str(self._lives[-1].resolve())}, self._command, self._path)

    def freeze(self, seconds: float) -> None:
        process = self._process
        if process is None or process.poll() is not None:
            return
        self.thaw()  # a timer of an earlier start must not end this freeze
        process.send_signal(signal.SIGSTOP)
        self._stopped = process
        if seconds < math.inf:
            self._thaw = threading.Timer(seconds, self.thaw)
            self._thaw.daemon = True
            self._thaw.start()

    @property
    def frozen(self) -> bool:
        return self._stopped is not None and self._stopped.poll() is None

    def thaw(self) -> None:
        process, self._stopped = self._stopped, None
        if self._thaw is not None:
            self._thaw.cancel()
            self._thaw = None
        if process is not None:
            process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End the agent, and join the traces of all its starts. Idempotent."""
        if self._thaw is not None:
            self._thaw.cancel()
        self.kill()
        while len(self._lives) > 1:
            life = self._lives.pop(1)
            if life.exists():
                with self.trace_file.open("ab") as whole:
                    whole.write(b"\n" + life.read_bytes())  # a trace that was cut off ends within a line
                life.unlink()

    def look(self) -> list[TraceRecord]:
        records = self._tail.read()
        for record in records:
            self._record(record)
        return records

    def _failed(self, status: int) -> str | None:
        if status == 0 or (self.asked_to_end and (status in GOOD_ENDS or self.phase.phase == "launched")):
            return None
        if self.asked_to_end and status == -signal.SIGTERM and self.phase.phase == "stopped":
            return None  # it was already exiting when it was told to, and Python no longer handled signals
        if status < 0:
            return f"was killed by {signal.Signals(-status).name}"
        own = self.stopping.detail if self.stopping else self.last_error
        why = own.strip().splitlines()[-1:] or self.last_lines(1) or ["it said nothing"]
        return f"ended with status {status}: {why[0]}"


def _second_to_parent() -> None:
    """Tie the child to its parent, and lower its priority. Runs in the child, in a session of its own.

    If the harness is killed, the agent receives SIGTERM and stops safely. The harness has priority for the
    processor."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_DEATH_SIGNAL, signal.SIGTERM)
    with suppress(OSError):
        os.nice(_BEHIND)
    with suppress(OSError):  # if Linux shares the processor among sessions, niceness counts only within a session
        Path("/proc/self/autogroup").write_text(str(_BEHIND))
