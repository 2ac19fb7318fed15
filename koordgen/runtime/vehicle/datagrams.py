"""UDP ports that receive feeds of base stations and sensors without blocking."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from koordgen.runtime.vehicle.platform import Unready

LARGEST_DATAGRAM = 2048
# Largest number of datagrams handled in one poll. It is at least what a socket buffers, so that no datagram waits and
# seems to be newer than it is; handling them takes a few milliseconds.
DATAGRAMS_A_POLL = 512


def raw_clock() -> float:
    """Return seconds of a clock with the computer's crystal rate.

    NTP slews the monotonic clock by far more."""
    return time.clock_gettime(time.CLOCK_MONOTONIC_RAW)


class DatagramLink(Protocol):
    """Source of datagrams. None: no datagram at present."""

    def receive(self) -> bytes | None: ...

    def close(self) -> None: ...


class UdpLink:
    """Bound UDP socket. Raises OSError or OverflowError if it cannot be bound."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((host, port))
        except BaseException:
            self._socket.close()
            raise

    def receive(self) -> bytes | None:
        try:
            return self._socket.recv(LARGEST_DATAGRAM)
        except OSError:  # no datagram, or a stray network error, which silence will show
            return None

    def close(self) -> None:
        self._socket.close()


def listen(key: str, setting: str, what: str, sender: str, example: str) -> UdpLink:
    """Bind the port "udp:HOST:PORT" of a robot's setting `key`, for `what` (plural) from `sender`.

    Raises Unready."""
    kind, _, address = setting.partition(":")
    host, _, port = address.rpartition(":")
    if kind != "udp" or not host or not port.isascii() or not port.isdigit():
        raise Unready(f"{key} {setting!r} is not a UDP address", f"write `{key}: udp:HOST:PORT`, as in {example}")
    try:
        return UdpLink(host, int(port))
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        hint = f"free the port, or give another in `{key}` of the robot's settings and to {sender}"
        raise Unready(f"cannot receive {what} on {host}:{port}: {reason}", hint) from None


def even_clock(link: DatagramLink) -> Callable[[], float] | None:
    """Return the clock that stamps arrivals on a link; None for a simulated link, which uses the caller's."""
    return raw_clock if isinstance(link, UdpLink) else None


def waiting(link: DatagramLink) -> Iterator[bytes]:
    """Yield the datagrams that have arrived, at most DATAGRAMS_A_POLL."""
    for _ in range(DATAGRAMS_A_POLL):
        datagram = link.receive()
        if datagram is None:
            return
        yield datagram
