"""Agent's side of the watchdog: starts and restarts its process, passes the device, and reports each command."""

from __future__ import annotations

import json
import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

STARTING = 2.0  # seconds within which a new process must answer; a slow board needs tenths of a second to load Python
SILENT = 0.5  # seconds without an answer after which the agent brakes the car
HUNG = 1.0  # seconds without an answer after which the watchdog's process is killed and restarted
PAUSE = 1.0  # minimum seconds between two starts of the watchdog's process
OFTEN = 5.0  # minimum seconds between two log lines on braking by the watchdog


class Watch(Protocol):
    """Interface of a watchdog to a drive. No method blocks or raises."""

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        """Let the watchdog write the bytes `brake` to this open, non-blocking device if commands cease.

        This device replaces the one that the watchdog held before. `address`: destination of the bytes if the device is
        an unconnected datagram socket."""
        ...

    def release(self) -> None:
        """Let the watchdog release the device, because the agent has closed the device."""
        ...

    def beat(self) -> None:
        """Report to the watchdog that a command has just been written."""
        ...

    def poll(self) -> None:
        """Process the watchdog's answers, and restart its process if it has ended. Call this at 20 Hz or more."""
        ...

    @property
    def trouble(self) -> str:
        """Reason why the car must not be driven: the watchdog does not answer. In words; "" while it answers."""
        ...

    def log_lines(self) -> list[str]:
        """Return messages about events since the last call, for the log."""
        ...

    def close(self, standing: bool) -> None:
        """End the watchdog. If the car is not `standing`, the process first brakes it for some seconds. Idempotent."""
        ...


class WatchdogProcess:
    """Watchdog in a process of its own (watchdog.py), which `hold` starts.

    `clock`: the system's monotonic clock, which both processes use."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._child: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._held: tuple[int, bytes, tuple[Any, ...] | None] | None = None
        self._begun = -math.inf
        self._asked: float | None = None  # time of the first command that the process has not acknowledged
        self._answering = False  # whether the process has answered since its start
        self._log_lines: list[str] = []
        self._logged_at = -math.inf  # time of the last log line on braking
        self._braked = 0  # number of times that the watchdog has braked since its last log line

    @property
    def pid(self) -> int:
        """Process id of the watchdog; 0 if it does not run."""
        return self._child.pid if self._child is not None else 0

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        self._held = (device, brake, address)
        if self._socket is None:
            self._begin()
        else:
            self._hand_over(self._socket)

    def release(self) -> None:
        self._held = None
        self._send(b"R")

    def beat(self) -> None:
        now = self._clock()
        if self._asked is None:
            self._asked = now
        self._send(b"B" + struct.pack("d", now))

    def poll(self) -> None:
        now = self._clock()
        self._listen(now)
        if self._asked is not None and now - self._asked > (HUNG if self._answering else STARTING):
            self._lose(f"has not answered for {now - self._asked:.1f} s")
        if self._socket is None and self._held is not None and now - self._begun > PAUSE:
            self._begin()

    @property
    def trouble(self) -> str:
        if not self._answering:
            return "waiting for the watchdog"
        silent = self._asked is not None and self._clock() - self._asked > SILENT
        return "braking: the watchdog does not answer" if silent else ""

    def log_lines(self) -> list[str]:
        told, self._log_lines = self._log_lines, []
        return told

    def close(self, standing: bool) -> None:
        self._held = None
        if standing:
            self._send(b"R")
            self._end(kill=False)
        elif self._socket is not None:
            self._socket.close()  # the watchdog treats the closed socket as the agent's death, and brakes
            self._socket = None

    def _begin(self) -> None:
        self._begun, self._asked, self._answering = self._clock(), None, False
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        command = [sys.executable, "-I", "-S", str(Path(__file__).with_name("watchdog.py")), str(theirs.fileno())]
        try:
            # A session of its own keeps the watchdog running after Ctrl-C in the agent's terminal, or after its end.
            self._child = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
            )
        except OSError as error:
            ours.close()
            self._log(f"the watchdog cannot be started: {error.strerror or error}; without it, the car does not drive")
            return
        finally:
            theirs.close()
        self._socket = ours
        self._hand_over(ours)

    def _hand_over(self, link: socket.socket) -> None:
        if self._held is None:
            return
        device, brake, address = self._held
        try:
            socket.send_fds(link, [b"H" + brake], [device])
        except OSError as error:
            self._lose(f"cannot be given the device: {error.strerror or error}")
            return
        if address is not None:
            self._send(b"A" + json.dumps(address).encode())

    def _send(self, data: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(data)
        except BlockingIOError:
            pass  # the watchdog does not read its messages: it will soon count as hung
        except OSError:
            self._lose("ended")

    def _listen(self, now: float) -> None:
        while self._socket is not None:
            try:
                data = self._socket.recv(64)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._lose("ended")
            elif data[:1] == b"L":
                self._log_braking(struct.unpack("d", data[1:])[0], now)
            else:
                self._answering, self._asked = True, None

    def _log_braking(self, late: float, now: float) -> None:
        """Log that the watchdog braked, at most every OFTEN seconds: an overloaded computer causes it repeatedly."""
        self._braked += 1
        if now - self._logged_at < OFTEN:
            return
        times = f"{self._braked} times, the last because" if self._braked > 1 else "because"
        self._log(f"the watchdog braked {times} no command had come for {late:.2f} s: the agent was stuck or starved")
        self._logged_at, self._braked = now, 0

    def _lose(self, why: str) -> None:
        self._end(kill=True)
        self._log(f"the watchdog {why}; it is begun anew, and the car is braked until it answers")

    def _end(self, kill: bool) -> None:
        child, self._child = self._child, None
        link, self._socket = self._socket, None
        self._answering, self._asked = False, None
        if link is not None:
            link.close()
        if child is None:
            return
        if not kill:
            with suppress(subprocess.TimeoutExpired):
                child.wait(timeout=0.1)  # the process ends within some milliseconds
        with suppress(OSError, subprocess.TimeoutExpired):
            child.kill()
            child.wait(timeout=0.1)

    def _log(self, line: str) -> None:
        if line not in self._log_lines:
            self._log_lines.append(line)


class Unwatched:
    """Watchdog that never brakes, for tests and for simulations that control the agent's clock."""

    trouble = ""

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        pass

    def release(self) -> None:
        pass

    def beat(self) -> None:
        pass

    def poll(self) -> None:
        pass

    def log_lines(self) -> list[str]:
        return []

    def close(self, standing: bool) -> None:
        pass
