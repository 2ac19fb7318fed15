"""Transport of datagrams from robot to robot: the interface, and the limits that all transports have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from koordgen.runtime.net.wire import LIMIT, MAX_ROBOTS

MOST_AT_ONCE = 1024  # datagrams received in one call: a flood must not keep the robot from its control loop
LARGEST = LIMIT + 1  # bytes kept of a datagram: more than LIMIT tells that it was too long
IN_TURN = 64  # datagrams received from one socket before another is looked at
MOST_ECHOES = 16  # own datagrams that are on their way back from the group; more than one round sends
GROUP = MAX_ROBOTS  # the place of the group; the places before it are the robots', by pid
Address = tuple[str, int] | tuple[str, int, int, int]  # of IPv4, of IPv6, as Python's sockets have it


class Transport(Protocol):
    """Unreliable datagrams between pids. No call but `wait` blocks, none raises, before and after `close`.

    A datagram's sender is not looked at here: its MAC decides.
    """

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        """Send to the robots named. What goes to several may reach all others too, but never the sender."""
        ...

    def receive(self) -> Sequence[bytes]:
        """Return what has arrived since the last call, as far as possible in order of arrival: at most MOST_AT_ONCE
        datagrams of at most LARGEST bytes."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Gather `expected` datagrams for `gather` seconds, if it is several; then wait until there is at least one,
        but not longer than `seconds` in all. The robot's own datagrams to a group do not count.

        Part of the time may be spent polling. Ends early when the process gets a signal.
        """
        ...

    @property
    def troubles(self) -> dict[str, int]:
        """Failures so far, counted by their reason."""
        ...

    def close(self) -> None: ...


class CannotOpen(Exception):
    """A socket that cannot be opened or a peer that has no address; the message names the robot and the address."""
