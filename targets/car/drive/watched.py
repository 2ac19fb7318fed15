"""The agent's side of the watchdog: starts its process, hands it the device, tells it of every command, replaces it."""

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

STARTING = 2.0  # seconds that a new one may take to answer: a slow board loads Python for some tenths
SILENT = 0.5  # seconds without an answer after which the car is braked
HUNG = 1.0  # ... and after which the process is ended and begun anew
PAUSE = 1.0  # seconds between two starts, at least
OFTEN = 5.0  # seconds between two lines that tell of its braking, at least


class Watch(Protocol):
    """A watchdog as a drive sees it. Nothing here waits or raises."""

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        """Brake with these bytes on this open, non-blocking device when commands cease; `address` is where to send
        them on an unconnected datagram socket. Replaces what was held before."""
        ...

    def release(self) -> None:
        """The device is closed: nothing is held any more."""
        ...

    def beat(self) -> None:
        """A command has just been written."""
        ...

    def poll(self) -> None:
        """Take its answers, replace it when it is gone. At least 20 times a second."""
        ...

    @property
    def trouble(self) -> str:
        """Why nothing may be driven, in words; "" while it answers."""
        ...

    def news(self) -> list[str]:
        """Return events since the last call, for the log."""
        ...

    def close(self, standing: bool) -> None:
        """End it; if the car does not stand, by itself, when it has braked for a while. Idempotent."""
        ...


class WatchdogProcess:
    """The watchdog in a process of its own (watchdog.py). It is started by `hold`. `clock` is the system's monotonic
    clock, which the two processes share."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._child: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._held: tuple[int, bytes, tuple[Any, ...] | None] | None = None
        self._begun = -math.inf
        self._asked: float | None = None  # when it was told of the first command that it has not answered
        self._answering = False  # whether it has answered since it was begun
        self._news: list[str] = []
        self._told = -math.inf  # when its braking was told of last
        self._braked = 0  # how often it has braked since

    @property
    def pid(self) -> int:
        """Of the process; 0: there is none."""
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

    def news(self) -> list[str]:
        told, self._news = self._news, []
        return told

    def close(self, standing: bool) -> None:
        self._held = None
        if standing:
            self._send(b"R")
            self._end(kill=False)
        elif self._socket is not None:
            self._socket.close()  # which to the watchdog is our death
            self._socket = None

    def _begin(self) -> None:
        self._begun, self._asked, self._answering = self._clock(), None, False
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        command = [sys.executable, "-I", "-S", str(Path(__file__).with_name("watchdog.py")), str(theirs.fileno())]
        try:
            # A session of its own: Ctrl-C in the agent's terminal, or its end, must not end what brakes.
            self._child = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
            )
        except OSError as error:
            ours.close()
            self._tell(f"the watchdog cannot be started: {error.strerror or error}; the car does not drive without")
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
            pass  # it takes nothing: soon it counts as hung
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
                self._tell_braked(struct.unpack("d", data[1:])[0], now)
            else:
                self._answering, self._asked = True, None

    def _tell_braked(self, late: float, now: float) -> None:
        """Told every OFTEN seconds at most: on an overloaded computer it happens again and again."""
        self._braked += 1
        if now - self._told < OFTEN:
            return
        times = f"{self._braked} times, the last because" if self._braked > 1 else "because"
        self._tell(f"the watchdog braked {times} no command had come for {late:.2f} s: the agent was stuck or starved")
        self._told, self._braked = now, 0

    def _lose(self, why: str) -> None:
        self._end(kill=True)
        self._tell(f"the watchdog {why}; it is begun anew, and the car is braked until it answers")

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
                child.wait(timeout=0.1)  # it ends within some milliseconds
        with suppress(OSError, subprocess.TimeoutExpired):
            child.kill()
            child.wait(timeout=0.1)

    def _tell(self, line: str) -> None:
        if line not in self._news:
            self._news.append(line)


class Unwatched:
    """No watchdog, for what owns the agent's time: a simulation on a clock of its own, and tests."""

    trouble = ""

    def hold(self, device: int, brake: bytes, address: tuple[Any, ...] | None = None) -> None:
        pass

    def release(self) -> None:
        pass

    def beat(self) -> None:
        pass

    def poll(self) -> None:
        pass

    def news(self) -> list[str]:
        return []

    def close(self, standing: bool) -> None:
        pass
