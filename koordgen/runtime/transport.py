"""How datagrams get from robot to robot: the interface, and UDP unicast to the peer table of the settings."""

from __future__ import annotations

import contextlib
import errno
import select
import socket
from collections.abc import Sequence
from typing import Protocol

from koordgen.runtime.settings import Peer
from koordgen.runtime.wire import LIMIT

RECEIVE_BUFFER = 1 << 20
MOST_AT_ONCE = 1024  # datagrams taken in one go: a flood must not keep the robot from its control loop


class Transport(Protocol):
    """Unreliable datagrams between pids. No call blocks or raises."""

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        """To those named; what goes to several may be heard by all others too, but never by the sender."""
        ...

    def receive(self) -> Sequence[bytes]:
        """What has arrived since, in order of arrival."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait until something has arrived, at most so long."""
        ...

    @property
    def troubles(self) -> dict[str, int]:
        """What went wrong so far, counted by its reason."""
        ...

    def close(self) -> None: ...


class CannotOpen(Exception):
    """A socket that cannot be opened or a peer that has no address; the message names the robot and the address."""


class UdpTransport:
    """Unicast over one socket. Raises CannotOpen."""

    def __init__(self, peers: Sequence[Peer], pid: int, bind: str = "") -> None:
        own = peers[pid]
        self._addresses = [_resolve(peer) for peer in peers]
        family, address = self._addresses[pid] if not bind else _resolve(Peer(own.name, bind, own.port))
        self.troubles: dict[str, int] = {}
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            place = f"{bind or own.host}:{own.port}"
            if error.errno == errno.EADDRINUSE:
                text = f"{place}, where robot {own.name} listens, is in use: does the robot's program run already?"
            elif error.errno == errno.EADDRNOTAVAIL:
                text = (
                    f"{place}, where robot {own.name} listens, is no address of this host: set `bind` in its settings"
                )
            else:
                text = f"{place}, where robot {own.name} listens: {error.strerror or error}"
            raise CannotOpen(text) from None

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        for pid in to:
            try:
                self._socket.sendto(datagram, self._addresses[pid][1])
            except OSError as error:
                self._count(f"send: {errno.errorcode.get(error.errno or 0, 'error')}")

    def receive(self) -> Sequence[bytes]:
        arrived: list[bytes] = []
        for _ in range(MOST_AT_ONCE):
            try:
                arrived.append(self._socket.recv(LIMIT + 1))  # one byte more tells what is too long
            except BlockingIOError:
                break
            except OSError as error:  # ECONNREFUSED and its like: an earlier send's echo, nothing about what waits
                self._count(f"receive: {errno.errorcode.get(error.errno or 0, 'error')}")
        return arrived

    def wait(self, seconds: float) -> None:
        if self._socket.fileno() >= 0:
            with contextlib.suppress(OSError):
                select.select([self._socket], [], [], max(0.0, seconds))

    def close(self) -> None:
        self._socket.close()

    def _count(self, reason: str) -> None:
        self.troubles[reason] = self.troubles.get(reason, 0) + 1


def _resolve(peer: Peer) -> tuple[socket.AddressFamily, tuple[str, int]]:
    try:
        found = socket.getaddrinfo(peer.host, peer.port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError, OverflowError) as error:
        raise CannotOpen(f"robot {peer.name}: no address for {peer.host}:{peer.port}: {error}") from None
    family, _, _, _, address = found[0]
    return family, (str(address[0]), int(address[1]))
