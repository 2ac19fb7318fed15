"""How datagrams get from robot to robot: the interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:  # it is made of what this module has
    from koordgen.runtime.net.courier import CompiledInbox


class Transport(Protocol):
    """Unreliable datagrams between pids. No call blocks or raises, before and after `close`. Who sent a datagram is
    not looked at here: its MAC decides."""

    def send(self, to: Sequence[int], datagram: bytes) -> None:
        """To those named; what goes to several may be heard by all others too, but never by the sender."""
        ...

    def receive(self) -> Sequence[bytes]:
        """What has arrived since, as far as possible in order of arrival; a bounded number, each of at most LIMIT + 1
        bytes: more than LIMIT tells that it was too long."""
        ...

    def wait(self, seconds: float, expected: int = 1, gather: float = 0.0) -> None:
        """Let `expected` datagrams come for `gather` seconds, if it is several; then wait until there is at least one,
        but not longer than `seconds` in all. What the robot itself sent to a group does not count.

        Some of the time may go into looking for one without sleep. Ends early when the process gets a signal."""
        ...

    @property
    def troubles(self) -> dict[str, int]:
        """What went wrong so far, counted by its reason."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class Coupled(Protocol):
    """A transport of which compiled code may be part: it sends, and hears, without Python's seeing the datagram."""

    @property
    def courier(self) -> CompiledInbox | None:
        """What it sends and waits with, as long as it lives, also when it is closed; None: nothing compiled."""
        ...

    def place(self, to: Sequence[int]) -> int:
        """Where `send` would send one datagram; -1: nothing, or several."""
        ...

    def failed(self, error: int) -> None:
        """Count this errno, as `send` would."""
        ...


class CannotOpen(Exception):
    """A socket that cannot be opened or a peer that has no address; the message names the robot and the address."""
