"""Connections between a simulated device and its agent.

UDP ports and pseudo-terminals, as real devices have.

Connections in memory: lockstep/wires.py."""

from __future__ import annotations

import os
import pty
import random
import socket
import tty
from collections import deque
from contextlib import suppress
from typing import Protocol

# UDP port numbers that the operating system does not assign by itself (Linux assigns from 32768 on), in blocks.
FIRST, BLOCKS, BLOCK = 20_000, 199, 64


class Port(Protocol):
    """Datagrams to and from the agent. Never blocks, never raises."""

    def receive(self) -> list[bytes]: ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class NumberedPort(Port, Protocol):
    """Port with a UDP number on loopback, where the agent finds it."""

    number: int


class Terminal(Protocol):
    """Serial line to the agent, which opens `device`. Never blocks, never raises."""

    device: str

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> int:
        """Write what fits. Return the number of bytes written."""
        ...

    def close(self) -> None: ...


class Wiring(Protocol):
    """Factory of a device's ports and serial lines."""

    def port(self) -> NumberedPort: ...

    def terminal(self) -> Terminal: ...


class Loopback:
    """Wiring for agents that are processes of their own."""

    def port(self) -> NumberedPort:
        return UdpPort()

    def terminal(self) -> Terminal:
        return PseudoTerminal()


class PseudoTerminal:
    """Serial line over a pseudo-terminal.

    The slave stays open here: reading from a master whose last slave has closed fails, and agents come and go."""

    def __init__(self) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)

    def read(self) -> bytes:
        with suppress(OSError):  # nothing to read
            return os.read(self._master, 65536)
        return b""

    def write(self, data: bytes) -> int:
        with suppress(OSError):  # the agent's side is full
            return os.write(self._master, data)
        return 0

    def close(self) -> None:
        if self._master < 0:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1


class PortNumbers:
    """Pool of UDP ports on loopback that stay free until their agents bind them, seconds later.

    No other device gets the same number, here or in another run on this host: a process reserves a block of numbers by
    binding the first one as TCP."""

    def __init__(self) -> None:
        self._held: list[socket.socket] = []
        self._free: deque[int] = deque()
        self._blocks = random.SystemRandom().sample(range(BLOCKS), BLOCKS)

    def allocate(self) -> int:
        """Return a free port number. Raises OSError if there is none."""
        while True:
            while not self._free:
                self._hold()
            number = self._free.popleft()
            with suppress(OSError):
                _bound(socket.SOCK_DGRAM, number).close()
                return number

    def give_back(self, number: int) -> None:
        """Return a number to the pool, to be reused last: its agent may still be ending."""
        self._free.append(number)

    def _hold(self) -> None:
        if not self._blocks:
            raise OSError(f"no UDP port from {FIRST} to {FIRST + BLOCKS * BLOCK - 1} is free")
        first = FIRST + BLOCK * self._blocks.pop()
        with suppress(OSError):
            self._held.append(_bound(socket.SOCK_STREAM, first))
            self._free.extend(range(first, first + BLOCK))

    def close(self) -> None:
        for each in self._held:
            each.close()


NUMBERS = PortNumbers()


class UdpPort:
    """UDP socket on loopback. `number` is the port for the agent to bind."""

    def __init__(self) -> None:
        self._socket = _bound(socket.SOCK_DGRAM, 0)
        self._socket.setblocking(False)
        self.number = NUMBERS.allocate()
        self._open = True

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
        if self._open:
            NUMBERS.give_back(self.number)
        self._open = False


def _bound(kind: socket.SocketKind, number: int) -> socket.socket:
    found = socket.socket(socket.AF_INET, kind)
    try:
        found.bind(("127.0.0.1", number))
    except OSError:
        found.close()
        raise
    return found
