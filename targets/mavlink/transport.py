"""Non-blocking transports to an autopilot: UDP, TCP, serial.

A transport reconnects after silence, a refused connection or an unplugged device.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import termios
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from koordgen.runtime.ops.host import pip_install
from koordgen.runtime.vehicle.platform import Unready

Address = tuple[Any, ...]
Chunk = tuple[bytes, Address | None]

# largest number of bytes read in one call: more than an autopilot sends; bounds the cost of a flood
BUDGET = 16384
# first pause before a broken connection is reopened, in seconds; doubled until data arrives
FIRST_WAIT, LONGEST_WAIT = 0.25, 2.0
SILENT = 3.0  # seconds without received data after which a TCP connection is closed and reopened
REPLUG = 0.5  # seconds between two attempts to reopen a device
_GONE = (OSError, ValueError, TypeError, termios.error)  # exceptions that pyserial raises when a device is unplugged
HINT = "use udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"


@dataclass(frozen=True, slots=True)
class Way:
    """Destination to which another process, the watchdog, can write frames.

    `descriptor`: open file descriptor. `address`: destination on an unconnected socket. `opening`: number of times that
    the connection was opened, because a descriptor may be reused for another connection."""

    opening: int
    descriptor: int
    address: Address | None = None


class Transport(Protocol):
    """Transport of bytes to and from an autopilot. Its methods do not raise; only the function `opened` does."""

    datagrams: bool  # True: data arrives as datagrams of whole frames; False: as a byte stream

    def receive(self, now: float) -> list[Chunk]:
        """Return received pieces of data with the senders' addresses, about BUDGET bytes at most."""
        ...

    def answer(self, source: Address | None) -> None:
        """Send to this address from now on: the vehicle sends from it."""
        ...

    def send(self, data: bytes) -> bool:
        """Send one frame. If it cannot be sent now, drop it and return False."""
        ...

    def close(self) -> None: ...


class Udp:
    """UDP transport: bound to a port, answering the vehicle's address (`udpin`), or with a fixed peer (`udpout`)."""

    datagrams = True

    def __init__(self, bind: Address | None, peer: Address | None, family: int) -> None:
        self._fixed = peer is not None
        self._peer = peer
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            if bind is not None:
                self._socket.bind(bind)
        except OSError:
            self._socket.close()
            raise

    def receive(self, now: float) -> list[Chunk]:
        chunks: list[Chunk] = []
        size = 0
        while size < BUDGET:
            try:
                data, source = self._socket.recvfrom(2048)
            except BlockingIOError:
                break
            except OSError:  # the error reports an ICMP refusal of a datagram that was sent earlier
                size += 1024
                continue
            size += len(data) + 64
            if not self._fixed or source == self._peer:
                chunks.append((data, source))
        return chunks

    def answer(self, source: Address | None) -> None:
        if not self._fixed:
            self._peer = source

    def way(self) -> Way | None:
        """Return the vehicle as destination; None while its address is unknown."""
        return None if self._peer is None else Way(0, self._socket.fileno(), self._peer)

    def send(self, data: bytes) -> bool:
        if self._peer is None:
            return False
        try:
            self._socket.sendto(data, self._peer)
        except OSError:
            return False
        return True

    def close(self) -> None:
        self._socket.close()


class Tcp:
    """TCP client that connects and reconnects without blocking. `make`: socket.socket, replaced in tests."""

    datagrams = False

    def __init__(self, peer: Address, family: int, make: Callable[..., socket.socket] = socket.socket) -> None:
        self._peer, self._family, self._make = peer, family, make
        self._socket: socket.socket | None = None
        self._retry = float("-inf")  # earliest time of the next attempt to connect
        self._wait = FIRST_WAIT  # pause after the next failure to connect, in seconds
        self._heard = 0.0  # time of the last received data, or of the attempt to connect
        self._unsent = b""
        self._openings = 0

    def way(self) -> Way | None:
        """Return the connection as destination; None without a connection."""
        return None if self._socket is None else Way(self._openings, self._socket.fileno())

    def receive(self, now: float) -> list[Chunk]:
        if self._socket is None and now >= self._retry:
            self._connect(now)
        chunks: list[Chunk] = []
        size = 0
        while self._socket is not None and size < BUDGET:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                break
            except OSError as error:
                if error.errno != errno.ENOTCONN:  # the connection is not established yet
                    self._drop(now)
                break
            if not data:
                self._drop(now)
                break
            size += len(data)
            chunks.append((data, None))
        if chunks:
            self._heard, self._wait = now, FIRST_WAIT
        elif self._socket is not None and now - self._heard > SILENT:
            self._drop(now)
        return chunks

    def _connect(self, now: float) -> None:
        self._heard = now
        try:
            self._socket = self._make(self._family, socket.SOCK_STREAM)
            self._openings += 1
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            refused = self._socket.connect_ex(self._peer) not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK)
        except OSError:  # the process has no free file descriptor
            refused = True
        if refused:
            self._drop(now)

    def _drop(self, now: float) -> None:
        self.close()
        self._retry, self._wait = now + self._wait, min(2 * self._wait, LONGEST_WAIT)

    def answer(self, source: Address | None) -> None:
        pass

    def send(self, data: bytes) -> bool:
        if self._socket is None or len(self._unsent) > 4096:
            return False
        data = self._unsent + data  # first send the rest of a partly sent frame
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            return False
        self._unsent = data[sent:]
        return True

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._unsent = None, b""


class Serial:
    """Serial transport; the device is reopened after it was unplugged."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        self._device, self._baud = device, baud
        self._retry = float("-inf")
        self._unsent = b""
        self._openings = 0
        self._port: Any = self._opened()

    def way(self) -> Way | None:
        """Return the device as destination; None while it is unplugged."""
        return None if self._port is None else Way(self._openings, self._port.fileno())

    def _opened(self) -> Any:
        import serial  # import pyserial only for serial links

        self._openings += 1
        return serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)

    def receive(self, now: float) -> list[Chunk]:
        if self._port is None:
            if now < self._retry:
                return []
            self._retry = now + REPLUG
            try:
                self._port = self._opened()
            except _GONE:
                return []
        try:
            data = self._port.read(BUDGET)
        except _GONE:
            self._drop()
            return []
        return [(data, None)] if data else []

    def _drop(self) -> None:
        with contextlib.suppress(*_GONE):
            self._port.close()
        self._port, self._unsent = None, b""

    def answer(self, source: Address | None) -> None:
        pass

    def send(self, data: bytes) -> bool:
        if self._port is None:
            return False
        if self._unsent:
            self._unsent = self._unsent[self._write(self._unsent) :]
        written = 0 if self._unsent else self._write(data)
        if written:
            self._unsent = data[written:]  # rest of a partly sent frame; it must be sent before the next frame
        return written > 0

    def _write(self, data: bytes) -> int:
        # Use os.write: pyserial's own non-blocking write would loop for ever while the device accepts no bytes.
        try:
            return os.write(self._port.fileno(), data)
        except _GONE:
            return 0

    def close(self) -> None:
        if self._port is not None:
            self._drop()


def opened(url: str) -> Udp | Tcp | Serial:
    """Open the transport of a URL. Raises Unready if the URL is wrong, the port is in use, or there is no device."""
    scheme, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    if scheme not in ("udpin", "udpout", "tcp", "serial") or not place or not number.isdecimal():
        raise Unready(f"autopilot: {url!r} is no MAVLink link", HINT)
    if scheme != "serial" and not 0 < int(number) < 65536:  # getaddrinfo would reduce the port modulo 65536
        raise Unready(f"autopilot: {url!r} has no port within 1 to 65535", HINT)
    try:
        if scheme == "serial":
            return Serial(place, int(number))
        kind = socket.SOCK_STREAM if scheme == "tcp" else socket.SOCK_DGRAM
        family, _, _, _, address = socket.getaddrinfo(place.strip("[]"), int(number), type=kind)[0]
        if scheme == "tcp":
            return Tcp(address, family)
        return Udp(address, None, family) if scheme == "udpin" else Udp(None, address, family)
    except ImportError:
        raise Unready(f"autopilot: {url} needs pyserial", pip_install("pyserial")) from None
    except (*_GONE, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise Unready(f"autopilot: cannot open {url}: {reason}", _hint(scheme)) from None


def _hint(scheme: str) -> str:
    match scheme:
        case "serial":
            return "check that the device exists, that no other program uses it, and that you are in group dialout"
        case "udpin":
            return "another program may listen on this port: end that ground station or agent"
        case _:
            return "check the host's name"
