"""Supervisor of one agent, for hosts without systemd: restarts, watchdog, log.

It replaces the systemd unit of service.py. The agent reports to it by the protocol of sd_notify. The supervisor starts
the agent again after a failure, and kills it when its round loop sends no watchdog messages.
"""

from __future__ import annotations

import os
import secrets
import select
import signal
import socket
import subprocess
import time
from contextlib import closing, suppress
from pathlib import Path
from types import FrameType

from .agents import supervisor_lock, write_pid
from .deployment import Boot
from .entry import command
from .folder import Folder, ToolError, make_folder, read_json, write_json
from .lock import try_lock
from .logs import AgentLog
from .service import NO_RESTART, WATCHDOG

# first pause before a restart, in seconds, and longest pause; each pause is twice the pause before
_FIRST_PAUSE, _LONGEST_PAUSE = 1.0, 30.0
_LONG_RUN = 60.0  # after a run of more seconds, the pause before the next restart is _FIRST_PAUSE again
_TURN = 0.5  # longest time in seconds between two checks of the agent, its output and received signals


def state_file(folder: Folder, robot: str) -> Path:
    """Return the JSON file in which a supervisor records the state of its agent.

    pid: process id of the supervisor.
    state: "starting", "ready", "waiting" (for a restart) or "ended".
    status: exit status of the agent's last run; null while it runs.
    """
    return folder.running / f"{robot}.json"


def start(folder: Folder, boot: Boot, robot: str) -> subprocess.Popen[bytes]:
    """Start a supervisor as a process that outlives the session."""
    make_folder(folder.running)
    make_folder(folder.logs)
    return subprocess.Popen(
        command(folder, boot, "supervise", robot),
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=folder.root, start_new_session=True,
    )  # fmt: skip


def state_of(folder: Folder, robot: str, supervisor: subprocess.Popen[bytes]) -> str:
    """Return the state that the supervisor recorded.

    If there is no record yet: "starting", or "ended" if the supervisor died.
    """
    ended = supervisor.poll() is not None
    found = read_json(state_file(folder, robot))
    if isinstance(found, dict) and found.get("pid") == supervisor.pid:
        return str(found.get("state"))
    return "ended" if ended else "starting"


def supervise(folder: Folder, boot: Boot, robot: str) -> int:
    """Run the agent of `robot`, with restarts, until it is stopped or a restart would not help.

    Returns the last exit status of the agent.
    """
    lock = try_lock(supervisor_lock(folder, robot))
    if lock is None:
        raise ToolError("running", f"robot {robot}: a supervisor of its agent runs already")
    write_pid(lock)
    with closing(AgentLog(folder.log(robot))) as log:
        return _Supervisor(folder, boot, robot, log).run()


class _Supervisor:
    def __init__(self, folder: Folder, boot: Boot, robot: str, log: AgentLog) -> None:
        self._folder, self._robot, self._log = folder, robot, log
        self._command = command(folder, boot, "launch", robot)
        self._stops = 0  # number of signals received that request the end
        self._forwarded = 0
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, self._stop)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._stops += 1

    def _is_stopping(self) -> bool:
        return self._stops > 0

    def run(self) -> int:
        pause = _FIRST_PAUSE
        while True:
            began = time.monotonic()
            self._record("starting", None)
            status = self._run_once()
            if status in NO_RESTART or self._is_stopping():
                self._log.write(f"the agent has ended with status {status}")
                self._record("ended", status)
                return status
            if time.monotonic() - began > _LONG_RUN:
                pause = _FIRST_PAUSE
            self._log.write(f"the agent has failed with status {status}; it is started again in {pause:.0f} s")
            self._record("waiting", status)
            end = time.monotonic() + pause
            while not self._is_stopping() and time.monotonic() < end:
                time.sleep(0.1)
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _run_once(self) -> int:
        """Run the agent once; return its exit status, or minus the number of the signal that killed it."""
        name = f"koordgen-{secrets.token_hex(12)}"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as notices:
            # use an abstract socket name, because a folder's path may be too long for a socket name
            notices.bind("\0" + name)
            notices.setblocking(False)
            environment = os.environ | {"NOTIFY_SOCKET": f"@{name}", "WATCHDOG_USEC": str(WATCHDOG * 1_000_000)}
            environment.pop("WATCHDOG_PID", None)
            with subprocess.Popen(
                self._command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            ) as agent:  # fmt: skip
                self._attend(agent, notices)
                return agent.wait()

    def _attend(self, agent: subprocess.Popen[bytes], notices: socket.socket) -> None:
        """AgentLog the agent's output, watch the agent and forward signals.

        Return when the agent has ended and its output is logged.
        """
        assert agent.stdout is not None
        output, notified, rest = agent.stdout.fileno(), notices.fileno(), b""
        alive: float | None = None
        os.set_blocking(output, False)
        while True:
            ended = agent.poll() is not None
            ready, _, _ = select.select([output, notified], [], [], 0.0 if ended else _TURN)
            if notified in ready:
                alive = self._hear(notices, alive)
            piece = b""
            if output in ready:
                with suppress(BlockingIOError):
                    piece = os.read(output, 65536)
                *lines, rest = (rest + piece).split(b"\n")
                for line in lines:
                    self._log.write(line.decode("utf-8", "replace"))
            if ended and not piece:
                if rest:
                    self._log.write(rest.decode("utf-8", "replace"))
                return
            if output in ready and not piece:
                time.sleep(0.05)  # the agent closed its output, so `select` returns at once: avoid a busy loop
            if self._stops > self._forwarded and not ended:
                self._forwarded += 1
                agent.send_signal(signal.SIGTERM)
            if alive is not None and time.monotonic() - alive > WATCHDOG and not ended:
                self._log.write(f"the agent sent no watchdog message for {WATCHDOG} s and is killed")
                agent.kill()
                alive = None

    def _hear(self, notices: socket.socket, alive: float | None) -> float | None:
        """Read one message of the agent, and return the time of the agent's last watchdog message.

        Returns None while the watchdog is not active: the agent is not ready yet, or is stopping.
        """
        with suppress(OSError):
            words = notices.recv(4096).decode("utf-8", "replace").split("\n")
            if "READY=1" in words:
                self._record("ready", None)
                return time.monotonic()
            if "STOPPING=1" in words:
                return None  # switch the watchdog off during the stop, because a landing may take long
            if "WATCHDOG=1" in words and alive is not None:
                return time.monotonic()
        return alive

    def _record(self, state: str, status: int | None) -> None:
        with suppress(OSError):  # ignore the error: a full disk must not end the supervisor during a flight
            found = {"pid": os.getpid(), "state": state, "status": status}
            write_json(state_file(self._folder, self._robot), found)
