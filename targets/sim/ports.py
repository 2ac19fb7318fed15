"""How a simulated device and its agent are wired: by UDP ports and pseudo-terminals, as real ones are, or in memory
(lockstep/wires.py)."""

from __future__ import annotations

import os
import pty
import socket
import tty
from contextlib import suppress
from typing import Protocol

_given: set[int] = set()  # ports of this process that agents will bind: free now, but not to be given twice


class Port(Protocol):
    """Datagrams to and from the agent; never blocks, never raises."""

    def receive(self) -> list[bytes]: ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class Numbered(Port, Protocol):
    """A port that the agent finds under a number, on the loopback."""

    number: int


class Terminal(Protocol):
    """A serial line to the agent, whose end of it is `device`. Never blocks, never raises."""

    device: str

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int:
        """How many bytes it took."""
        ...

    def close(self) -> None: ...


class Wiring(Protocol):
    """Makes the devices' ends."""

    def port(self) -> Numbered: ...

    def terminal(self) -> Terminal: ...


class Loopback:
    """The wiring of agents that are processes."""

    def port(self) -> Numbered:
        return UdpPort()

    def terminal(self) -> Terminal:
        return PseudoTerminal()


class PseudoTerminal:
    """The slave stays open here: a master whose last slave closes reads errors, and agents come and go."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)

    def read(self) -> bytes:
        with suppress(OSError):  # nothing there
            return os.read(self._master, 65536)
        return b""

    def write(self, data: bytes) -> int:
        with suppress(OSError):  # its side is full
            return os.write(self._master, data)
        return 0

    def close(self) -> None:
        if self._master < 0:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1


class UdpPort:
    """A socket on loopback. `number` is the port for the agent to bind."""

    def __init__(self) -> None:
        self._socket, _ = _bound()
        self._socket.setblocking(False)
        probe, self.number = _bound()
        probe.close()
        _given.add(self.number)

    def receive(self) -> list[bytes]:
        datagrams: list[bytes] = []
        while len(datagrams) < 32:
            try:
                datagrams.append(self._socket.recv(2048))
            except OSError:
                break
        return datagrams

    def send(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, ("127.0.0.1", self.number))
        except OSError:
            return  # a full buffer loses the message, as a radio would

    def close(self) -> None:
        self._socket.close()
        _given.discard(self.number)


def _bound() -> tuple[socket.socket, int]:
    while True:
        candidate = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        candidate.bind(("127.0.0.1", 0))
        number: int = candidate.getsockname()[1]
        if number not in _given:
            return candidate, number
        candidate.close()
