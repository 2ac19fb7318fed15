"""Readiness and watchdog messages to systemd, by the protocol of sd_notify(3), without a library.

A service manager names a datagram socket in the environment (NOTIFY_SOCKET) and, where it watches, how often it wants
to hear from the process (WATCHDOG_USEC, WATCHDOG_PID). Elsewhere nothing is sent. A message that cannot be sent is
dropped: a robot in flight does not depend on its service manager.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Mapping
from contextlib import suppress


class Notifier:
    """The messages of one process. Times are seconds of any one clock that never goes back."""

    def __init__(self, environment: Mapping[str, str], pid: int) -> None:
        """`environment` as os.environ, `pid` this process's. A socket that is no path, and a period that is no positive
        number or is another process's, count as absent."""
        name = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + name[1:] if name.startswith("@") else name if name.startswith("/") else ""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if self._address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._period = _period(environment, pid) if self._address else math.inf
        self._next = -math.inf
        self._status = ""

    def ready(self) -> None:
        """Say that the process has started."""
        self._send("READY=1")

    def alive(self, now: float, status: str) -> None:
        """Call in each turn of the loop that must not hang: feeds the watchdog, and sends `status` when it changed."""
        if self._socket is None:
            return
        if status != self._status:
            self._status = status
            self._send(f"STATUS={status}")
        if now >= self._next and self._period < math.inf:
            self._next = now + self._period
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the process is about to end."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def _send(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)


def _period(environment: Mapping[str, str], pid: int) -> float:
    """A third of the time, in seconds, within which the manager must hear from us; infinite when it does not watch."""
    try:
        wanted = int(environment.get("WATCHDOG_USEC", "0"))
        watched = int(environment.get("WATCHDOG_PID", str(pid)))
    except ValueError:
        return math.inf
    return wanted / 3e6 if wanted > 0 and watched == pid else math.inf
