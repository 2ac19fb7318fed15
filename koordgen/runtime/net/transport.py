"""Transport of datagrams between robots: the interface, and limits that hold for all transports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS

MOST_AT_ONCE = 1024  # largest number of datagrams that a call receives, so that a flood cannot stop the control loop
LARGEST = LIMIT + 1  # number of bytes read of a datagram; a length above LIMIT means that the datagram is too long
IN_TURN = 64  # largest number of datagrams received from one socket before the other sockets are served
MOST_ECHOES = 16  # number of own group datagrams to remember until their copies return; a round sends fewer
GROUP = MAX_ROBOTS  # index of the group's address; lower indices are pids of robots
FURTHER = GROUP + 1  # first index of further addresses: a squad has one address for each of its robots
PLACES = 4 * MAX_ROBOTS  # number of indices
Address = tuple[str, int] | tuple[str, int, int, int]  # IPv4 or IPv6 address, as Python's sockets represent it


class Transport(Protocol):
    """Interface of a transport: unreliable datagrams between pids.

    Only `wait` blocks. No call raises, before or after `close`. A transport does not check who sent a datagram; the
    datagram's MAC authenticates the sender."""

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        """Send a datagram to robots `to`. If they are several, all other robots may receive it as well."""
        ...

    def receive(self) -> Sequence[bytes]:
        """Return the datagrams received since the last call, roughly in the order of arrival.

        Returns at most MOST_AT_ONCE datagrams, each cut to at most LARGEST bytes."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Wait at most `seconds` for a datagram.

        If `expected` is greater than 1, first wait up to `gather` seconds for that many datagrams. Copies of the
        robot's own datagrams to a group do not count. Part of the time may be spent polling. The wait ends early when
        the process gets a signal."""
        ...

    @property
    def troubles(self) -> dict[str, int]:
        """Reason -> number of failures to send or receive."""
        ...

    def close(self) -> None: ...


class CannotOpen(Exception):
    """Raised if a socket cannot be opened or a peer has no address. The message names robot and address."""
