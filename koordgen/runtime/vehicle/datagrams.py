"""UDP ports that receive datagrams of base stations and sensors without blocking."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from koordgen.runtime.vehicle.platform import Unready

LARGEST_DATAGRAM = 2048  # bytes
# Largest number of datagrams handled in one poll. A socket buffers no more than this number, so no datagram waits for
# the next poll and gets too late a time stamp. Handling all of them takes a few milliseconds.
DATAGRAMS_A_POLL = 512


def raw_clock() -> float:
    """Return the seconds of the raw monotonic clock, which runs at the rate of the computer's crystal.

    NTP changes the rate of the usual monotonic clock by much more than a crystal's error."""
    return time.clock_gettime(time.CLOCK_MONOTONIC_RAW)


class DatagramLink(Protocol):
    """Source of datagrams. `receive` returns the next datagram, or None if no datagram has arrived."""

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
        except OSError:  # no datagram has arrived, or a network error; a lasting error shows as a missing feed
            return None

    def close(self) -> None:
        self._socket.close()


def listen(key: str, setting: str, what: str, sender: str, example: str) -> UdpLink:
    """Bind the UDP port that `setting` names as "udp:HOST:PORT".

    `key`: name of the robot's setting. `what`: plural noun for the datagrams in messages. `sender`: noun for their
    sender in messages. `example`: a valid setting. Raises Unready if the port cannot be bound."""
    kind, _, address = setting.partition(":")
    host, _, port = address.rpartition(":")
    if kind != "udp" or not host or not port.isascii() or not port.isdigit():
        raise Unready(f"{key} {setting!r} is not a UDP address", f"write `{key}: udp:HOST:PORT`, as in {example}")
    try:
        return UdpLink(host, int(port))
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        hint = f"free the port, or set another port in `{key}` of the robot's settings and for {sender}"
        raise Unready(f"cannot receive {what} on {host}:{port}: {reason}", hint) from None


def even_clock(link: DatagramLink) -> Callable[[], float] | None:
    """Return the clock that stamps datagrams of a link; None for a simulated link, which uses the caller's clock."""
    return raw_clock if isinstance(link, UdpLink) else None


def waiting(link: DatagramLink) -> Iterator[bytes]:
    """Yield the datagrams that have arrived on a link, at most DATAGRAMS_A_POLL."""
    for _ in range(DATAGRAMS_A_POLL):
        datagram = link.receive()
        if datagram is None:
            return
        yield datagram
