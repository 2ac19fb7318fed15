"""Transport of datagrams from robot to robot: the interface, and the limits that all transports have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS

MOST_AT_ONCE = 1024  # largest number of datagrams of one call, so that a flood does not stop the control loop
LARGEST = LIMIT + 1  # bytes read of a datagram; a length above LIMIT shows that it was too long
IN_TURN = 64  # largest number of datagrams received from one socket before the other sockets are served
MOST_ECHOES = 16  # own datagrams remembered until the group returns their copies; more than one round sends
GROUP = MAX_ROBOTS  # index of the group's address; lower indices are pids of robots
Address = tuple[str, int] | tuple[str, int, int, int]  # IPv4 or IPv6, in the form of Python's sockets


class Transport(Protocol):
    """Unreliable datagrams between pids. Only `wait` blocks; no call raises, before or after `close`.

    The transport does not check the sender of a datagram: its MAC authenticates it."""

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        """Send to the robots named. A datagram to several may reach all others too, but never the sender."""
        ...

    def receive(self) -> Sequence[bytes]:
        """Return the datagrams received since the last call, roughly in order of arrival.

        At most MOST_AT_ONCE datagrams of at most LARGEST bytes."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Wait at most `seconds` for a datagram.

        If `expected` is greater than 1, first wait up to `gather` seconds for that many datagrams. Copies of the
        robot's own datagrams to a group do not count. Part of the time may be spent polling. The wait ends early when
        the process gets a signal."""
        ...

    @property
    def troubles(self) -> dict[str, int]:
        """Numbers of failures by reason."""
        ...

    def close(self) -> None: ...


class CannotOpen(Exception):
    """A socket cannot be opened, or a peer has no address. The message names the robot and the address."""
