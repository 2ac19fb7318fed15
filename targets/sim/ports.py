"""The UDP side of a simulated device: it sends to a port that its agent will bind, as real ones do."""

from __future__ import annotations

import socket
from typing import Protocol

_given: set[int] = set()  # ports of this process that agents will bind: free now, but not to be given twice


class Port(Protocol):
    """Datagrams to and from the agent; never blocks, never raises."""

    def receive(self) -> list[bytes]: ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


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
