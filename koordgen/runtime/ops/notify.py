"""Readiness and watchdog messages to systemd, by the protocol of sd_notify(3), without a library.

The service manager names a datagram socket in the environment variable NOTIFY_SOCKET. If it has a watchdog, the
variables WATCHDOG_USEC and WATCHDOG_PID give the timeout. Without NOTIFY_SOCKET nothing is sent. A message that cannot
be sent is dropped, because a robot in flight must not depend on its service manager.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Mapping
from contextlib import suppress


class Notifier:
    """Sender of one process's messages to its service manager. Times are seconds of any monotonic clock."""

    def __init__(self, environment: Mapping[str, str], pid: int) -> None:
        """Read the socket and the watchdog's timeout for the process `pid` from `environment` (as os.environ).

        A socket that is neither a path nor an abstract name is ignored, as is a timeout that is invalid or belongs to
        another process."""
        name = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + name[1:] if name.startswith("@") else name if name.startswith("/") else ""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if self._address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._period = _period(environment, pid) if self._address else math.inf
        self._next = -math.inf
        self._status = ""

    def ready(self) -> None:
        """Report that the process has started."""
        self._send("READY=1")

    def alive(self, now: float, status: str) -> None:
        """Send the watchdog's sign of life if it is due, and `status` if the text has changed.

        Call this in each turn of the loop that the watchdog supervises."""
        if self._socket is None:
            return
        if status != self._status:
            self._status = status
            self._send(f"STATUS={status}")
        if now >= self._next and self._period < math.inf:
            self._next = now + self._period
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the process is about to end."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def _send(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)


def _period(environment: Mapping[str, str], pid: int) -> float:
    """Return the seconds between two signs of life: a third of the watchdog's timeout, or inf without a watchdog."""
    try:
        wanted = int(environment.get("WATCHDOG_USEC", "0"))
        watched = int(environment.get("WATCHDOG_PID", str(pid)))
    except ValueError:
        return math.inf
    return wanted / 3e6 if wanted > 0 and watched == pid else math.inf
